"""Compares the twins in C with the Python code, and renews the stamp, `fmus/twins.json`.

    python .ci/stamp.py [TWIN ...]

Without names, those are compared whose Python files have changed. A twin's digests are written
only if both have the same bits; if all that changed is comments, at once. Exit
code 1: a comparison has failed, and that twin's stamp is as it was.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from panda_cosim.fmus import twins
from panda_cosim.fmus.sources.python_fmu import code_of
from panda_cosim.fmus.sources.targets import own_code

ROOT = Path(__file__).parents[1]
MASTER = ROOT / "fmus" / "master"
COMPARED = {  # by these tests, in `tests`
    "plant": (
        "fmus/test_native_mujoco.py::test_all_outputs_have_the_bits_of_the_plant_in_python",
        "fmus/test_twins.py::test_fmus_of_either_kind_have_the_same_bits[plant]",
    ),
    "controller": (
        "robot/test_controller_in_c.py",
        "fmus/test_twins.py::test_fmus_of_either_kind_have_the_same_bits[controller]",
        "fmus/test_twins.py::test_fmus_of_either_kind_have_the_same_bits[slow controller]",
    ),
    "trajectory": (
        "fmus/test_fmu_trajectory.py",
        "fmus/test_twins.py::test_fmus_of_either_kind_have_the_same_bits[trajectory]",
    ),
    "kernel": (
        "fmus/test_kernel.py::test_both_give_the_same_bits",
        "fmus/test_kernel.py::test_both_end_alike",
        "fmus/test_kernel.py::test_both_end_at_a_value_that_is_not_finite",
        "fmus/test_kernel.py::test_both_allow_the_same_values_that_are_not_finite",
        # An eighth of the scenarios; the suite has the others.
        "fmus/test_kernel.py::test_both_give_the_same_bits_over_all_shipped_scenarios[0]",
    ),
}


def files_of(twin: str) -> list[str]:
    """Files of a twin's Python code: what its FMU carries, or the step and its list of calls."""
    if twin == "kernel":
        code = [*code_of(MASTER / "kernel.py", MASTER), *code_of(MASTER / "fmi.py", MASTER)]
        return sorted(f"fmus/master/{name}" for name in {*code})
    # MJCF files are read by either.
    return sorted(name for name in own_code(twin) if not name.endswith(".xml"))


def digests(twin: str) -> dict[str, list[str]]:
    """What the stamp of a twin would be now: digests of bytes and meaning by file."""
    return {name: [twins.raw_digest(name), twins.meaning_digest(name)] for name in files_of(twin)}


def compare(twin: str) -> bool:
    """Compare a twin with the Python code, bit for bit."""
    print(f"{twin}: comparing C with Python ...", flush=True)
    command = [sys.executable, "-m", "pytest", "-q", "-x", *(f"tests/{t}" for t in COMPARED[twin])]
    return subprocess.run(command, cwd=ROOT, check=False).returncode == 0


def write(stamp: Mapping[str, Any]) -> None:
    """Write the stamp."""
    text = json.dumps(stamp, indent=1).replace("[\n   ", "[").replace(",\n   ", ", ")
    twins.PROVEN.write_text(text.replace("\n  ]", "]") + "\n", encoding="utf-8")


def main(names: Sequence[str]) -> int:
    """Compare and renew; return the exit code."""
    stamp, different = dict(twins.proven()), []
    for twin in COMPARED:
        now, before = digests(twin), stamp.get(twin, {})
        says = [{file: pair[1] for file, pair in each.items()} for each in (now, before)]
        stamp[twin] = now
        if twin in names or says[0] != says[1]:
            write(stamp)  # or Python would run where the tests mean C
            is_equal = False
            try:
                is_equal = compare(twin)
            finally:
                if not is_equal:
                    different.append(twin)
                    stamp[twin] = before
                    write(stamp)
    write(stamp)
    for twin in different:
        print(f"{twin}: C and Python differ, see above; its stamp stays as it was")
    return bool(different)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
