"""Runs one scenario in a separate process: `python -m panda_cosim...worker JOB`.

JOB is JSON: the scenario's folder, the run's folder, the parameters, a file for the reason of a
failure, and the parent process. With a separate process, a crash inside an FMU does not end the
suite.
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from ...fmus.errors import CosimError
from ...fmus.processes import end_with

STOPPED: Final = 128  # exit code of a run that signal n stopped, less n


def main(job: dict[str, Any]) -> int:
    """Run the job; return the exit code."""
    end_with(job["parent"])
    from ..running.options import Options  # noqa: PLC0415 - so that errors are caught
    from ..running.run import run_scenario  # noqa: PLC0415 - so that errors are caught

    try:
        run = run_scenario(Path(job["scenario"]), job["out"], Options(job["overrides"]))
    except CosimError as error:
        print(error, file=sys.stderr)  # if the disk is full, this is all that is left
        with suppress(OSError):
            Path(job["error_file"]).write_text(str(error), encoding="utf-8")
        return error.exit_code
    return STOPPED + run.signal if run.signal else 0


if __name__ == "__main__":
    sys.exit(main(json.loads(sys.argv[1])))
