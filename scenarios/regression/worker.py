"""Runs one scenario in a process of its own: `python -m scenarios.regression.worker JOB.json`.

The job says which folder to run, where to, and with which parameters. What went wrong is written
beside it as `error.json`. A process of its own keeps a crash inside an FMU from ending a suite.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from ...fmus.errors import CosimError

ERROR_FILE = "error.json"
STOPPED = 128  # exit code of a run that signal n stopped, less n


def main(job_file: Path) -> int:
    """Run the job; return the exit code."""
    from ..running.run import Options, run_scenario  # noqa: PLC0415 - so that errors are caught

    job = json.loads(job_file.read_text(encoding="utf-8"))
    os.environ.setdefault("PANDA_COSIM_STDERR", "0")  # errors are told once, by who asked for it
    try:
        run = run_scenario(Path(job["folder"]), job["out"], Options(overrides=job["overrides"]))
    except CosimError as error:
        said = json.dumps({"message": str(error)})
        job_file.with_name(ERROR_FILE).write_text(said, encoding="utf-8")
        return error.exit_code
    return STOPPED + run.signal if run.signal else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
