"""Our FMUs in other importers, and others' in our master: tables of docs/reference/importers.md.

Usage: [FOREIGN_FMUS=FOLDER] python .ci/importers.py

The first table needs the extra `importers`. Each row runs in a process of its own. A row that
cannot be made ends the script, and the table stays as it was. The plant is driven by the
reference experiment that it holds; whole systems are compared with our master in Jacobi
coupling. The C host is that of the test that compares each value: it must pass. The second
table is that of foreign.py; it stays as it was where no folder is named.
"""

from __future__ import annotations

import csv
import io
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import foreign
import numpy as np

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reference" / "importers.md"
TESTS = ROOT / "tests"
HEAD = ("importer", "version", "how", "agreement")
EXTRA = "extra/org.fmi-standard.fmi-ls-ref"
STEP = 0.001  # [s]


def _table(path: Path, name: str) -> tuple[list[str], np.ndarray]:
    """Names and rows of a CSV of the experiment in an FMU."""
    with zipfile.ZipFile(path) as archive:
        head, *rows = csv.reader(io.StringIO(archive.read(f"{EXTRA}/{name}").decode()))
    return head, np.array(rows, float)


def _difference(path: Path, drive: Callable[[list[str], np.ndarray, list[str]], np.ndarray]) -> str:
    """Largest relative difference from the plant's references, when an importer drives it."""
    (_, *inputs), stimuli = _table(path, "stimuli.csv")
    (_, *outputs), references = _table(path, "references.csv")
    answers = drive(inputs, stimuli, outputs)[np.rint(references[:, 0] / STEP).astype(int)]
    expected = references[:, 1:]
    largest = np.max(np.abs(answers - expected) / np.maximum(np.abs(expected), 1.0))
    return f"{len(stimuli):,} rows, {len(outputs)} outputs: difference {largest:.1g}"


def fmpy_(folders: dict[str, Path]) -> tuple[str, ...]:
    """FMPy's validator, and its own simulation of the plant."""
    import fmpy  # noqa: PLC0415 - each row in a process of its own
    from fmpy.validation import validate_fmu  # noqa: PLC0415

    problems = sum(len(validate_fmu(str(p))) for f in folders.values() for p in f.glob("*.fmu"))
    plant = folders["2"] / "PandaPlant.fmu"

    def drive(inputs: list[str], stimuli: np.ndarray, outputs: list[str]) -> np.ndarray:
        kinds = [("time", float), *((name, float) for name in inputs)]
        result = fmpy.simulate_fmu(
            str(plant), stop_time=stimuli[-1, 0], step_size=STEP, output_interval=STEP,
            input=np.array(list(map(tuple, stimuli)), dtype=kinds), output=outputs,
        )  # fmt: skip
        return np.stack([result[name] for name in outputs], axis=1)

    text = f"{problems} problems; {_difference(plant, drive)}"
    return "FMPy", version("fmpy"), "`fmpy validate`, FMI 2.0 and 3.0; `simulate_fmu`", text


def _stepped(slave: Any, get: Any, put: Any, path: Path) -> str:
    """Drive the plant through calls of FMI's functions by scalar."""
    from fmpy import read_model_description  # noqa: PLC0415 - see above

    references = {
        v.name: v.valueReference for v in read_model_description(str(path)).modelVariables
    }

    def drive(inputs: list[str], stimuli: np.ndarray, outputs: list[str]) -> np.ndarray:
        reads = [references[name] for name in outputs]
        rows = [get(reads)]
        for time, *values in stimuli[:-1].tolist():
            put([references[name] for name in inputs], values)
            slave.do_step(time, STEP)
            rows.append(get(reads))
        return np.array(rows)

    return _difference(path, drive)


def fmuloader(folders: dict[str, Path]) -> tuple[str, ...]:
    """An importer that binds all functions, and reads scalars."""
    from fmpy import read_model_description  # noqa: PLC0415 - see above
    from fmuloader.fmi2 import Fmi2Slave, Fmi2Type  # noqa: PLC0415
    from fmuloader.fmi3 import Fmi3Slave  # noqa: PLC0415

    two, three = (folders[key] / "PandaPlant.fmu" for key in ("2", "scalars"))
    it = Fmi2Slave(two, model_identifier="PandaPlant")
    it.instantiate("it", Fmi2Type.CO_SIMULATION, guid=read_model_description(str(two)).guid)
    it.setup_experiment()
    it.enter_initialization_mode()
    it.exit_initialization_mode()
    first = _stepped(it, it.get_real, it.set_real, two)
    token = read_model_description(str(three)).instantiationToken
    other = Fmi3Slave(three, model_identifier="PandaPlant")
    other.instantiate_co_simulation("it", instantiation_token=token)
    other.enter_initialization_mode()
    other.exit_initialization_mode()
    second = _stepped(other, other.get_float64, other.set_float64, three)
    how = "`Fmi2Slave`; `Fmi3Slave` with `build --scalars`"
    return (
        "fmuloader",
        version("fmuloader"),
        how,
        first if first == second else f"{first}; {second}",
    )


def pathsim(folders: dict[str, Path]) -> tuple[str, ...]:
    """A block of a Python simulation tool."""
    from pathsim_fmi.wrapper import FMUWrapper  # noqa: PLC0415 - see above

    path = folders["2"] / "PandaPlant.fmu"
    block = FMUWrapper(str(path), "it", mode="cosimulation")
    block.initialize({}, start_time=0.0)
    ports = {
        v.name: i
        for i, v in enumerate(
            v for v in block.model_description.modelVariables if v.causality == "input"
        )
    }
    reads = [v.name for v in block.model_description.modelVariables if v.causality == "output"]

    def drive(inputs: list[str], stimuli: np.ndarray, outputs: list[str]) -> np.ndarray:
        values = np.array(
            [
                float(v.start)
                for v in block.model_description.modelVariables
                if v.causality == "input"
            ]
        )
        columns = [reads.index(name) for name in outputs]
        rows = [np.array(block.get_outputs_as_array())[columns]]
        for time, *given in stimuli[:-1].tolist():
            values[[ports[name] for name in inputs]] = given
            block.set_inputs_from_array(values)
            block.do_step(current_time=time, step_size=STEP)
            rows.append(np.array(block.get_outputs_as_array())[columns])
        return np.array(rows)

    return (
        "PathSim",
        f"pathsim-fmi {version('pathsim-fmi')}",
        "`CoSimulationFMU`",
        _difference(path, drive),
    )


def _tested(*tests: str) -> None:
    """Run tests, which must pass, none of them skipped."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    last = done.stdout.strip().splitlines()[-1]
    if done.returncode or "skipped" in last or "passed" not in last:
        raise SystemExit(f"{' '.join(tests)}: {last}")


def libcosim(_: dict[str, Path]) -> tuple[str, ...]:
    """The whole system, as the test compares it."""
    _tested("tests/fmus/test_fmu_importers.py::test_libcosim_agrees")
    how = "`CosimExecution.from_ssp_file(ssp_path=FOLDER)` on the unpacked Panda.ssp"
    return "libcosim", f"libcosimpy {version('libcosimpy')}", how, "Jacobi, 300 steps: within 1e-12"


def ecos(_: dict[str, Path]) -> tuple[str, ...]:
    """The whole system, as the test compares it."""
    _tested("tests/fmus/test_fmu_importers.py::test_ecos_agrees")
    versions = ", ".join(f"{name} {version(name)}" for name in ("ecospy", "tbb"))
    how = '`EcosSimulation(ssp_path="Panda.ssp", step_size=0.001)`'
    return "Ecos", versions, how, "Jacobi, 300 steps: within 1e-12"


def pythonfmu(_: dict[str, Path]) -> tuple[str, ...]:
    """FMUs that PythonFMU packs, coupled in FMPy alone."""
    _tested("tests/fmus/test_pythonfmu.py::test_plain_fmpy_gives_the_bits_of_native_fmus")
    how = "`build --kind pythonfmu`; `FMU2Slave`, plant and controller"
    agreement = "Gauss-Seidel, pick_and_place, tutorial and push: qpos and ctrl bit for bit"
    versions = f"{version('fmpy')}, {version('pythonfmu')}"
    return "FMPy, PythonFMU", versions, how, agreement


def c_host(_: dict[str, Path]) -> tuple[str, ...]:
    """A program that is not Python, in a folder with only the FMUs and the C library."""
    _tested("tests/fmus/test_c_hosts.py::test_a_host_without_python_records_what_the_master_does")
    gcc = re.search(r"[\d.]+$", subprocess.check_output(["cc", "-dumpversion"], text=True).strip())
    place = "in a chroot with only the host, the FMUs and the C library"
    how = f"`tests/c_host/host.c` {place}; FMI 2.0 and 3.0"
    agreement = "Gauss-Seidel, the whole task, 6,501 rows: bit for bit"
    return "a plain C host", f"gcc {gcc[0] if gcc else ''}", how, agreement


ROWS = (fmpy_, libcosim, ecos, fmuloader, pathsim, pythonfmu, c_host)


def _row(name: str, folders: dict[str, Path]) -> tuple[str, ...]:
    row: tuple[str, ...] = globals()[name](folders)
    return row


def _build(folder: Path) -> dict[str, Path]:
    """Native FMUs in FMI 2.0, 3.0 and 3.0 without arrays, by key."""
    kinds: dict[str, Sequence[str]] = {
        "2": (),
        "3": ("--fmi", "3"),
        "scalars": ("--fmi", "3", "--scalars"),
    }
    for key, options in kinds.items():
        command = [
            sys.executable,
            "-m",
            "panda_cosim",
            "build",
            "--out",
            str(folder / key),
            *options,
        ]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return {key: folder / key for key in kinds}


def main() -> None:
    """Make all rows, and write the table."""
    with tempfile.TemporaryDirectory() as temporary:
        folders = _build(Path(temporary))
        with get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
            rows = [pool.apply(_row, (each.__name__, folders)) for each in ROWS]
    lines = [HEAD, ["---"] * len(HEAD), *rows]
    _write("importers", "\n".join(f"| {' | '.join(line)} |" for line in lines))
    if folder := os.environ.get("FOREIGN_FMUS"):
        _write("foreign", foreign.table(Path(folder)))


def _write(name: str, table: str) -> None:
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(begin)
    _, _, after = rest.partition(end)
    PAGE.write_text(f"{before}{begin}\n{table}\n{end}{after}", encoding="utf-8")
    print(table)


if __name__ == "__main__":
    main()
