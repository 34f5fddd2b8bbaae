"""Costs that grow with rows, variables and length: the figures of `bench --all`."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time as clock
from pathlib import Path
from shutil import copytree
from typing import Final

from ..assets import STEP_SIZE
from ..fmus.build.native import NativeFmu
from ..fmus.errors import CosimError
from ..fmus.interface.variables import Interface, input_, output
from ..fmus.sources.targets import build_fmu
from .run.prepare import prepare
from .run.run import Execution
from .scenario.scenario import SCENARIO_FILE, load_scenario, shipped_scenarios
from .sweep.definition import shipped_sweeps

OURS: Final = (sys.executable, "-m", "panda_cosim")
SWEEP: Final = "random_box"
JOBS: Final = 2
SAMPLES: Final = (8, 40)  # of two sweeps, whose difference is without start and end
VARIABLES: Final = (2_000, 4_000)  # of each of two FMUs
HOUR: Final = 3600.0  # [s]
FIGURES: Final = {
    "sweep_rows_per_s": (f"rows of {SWEEP} a second, {JOBS} processes", "at least 13"),
    "sweep_row_by_ticks": ("processor time of a row by its ticks' mj_step", "less is better"),
    "set_up_2000_s": ("two FMUs of 2,000 variables: set-up", "at most 1.5 s"),
    "set_up_4000_by_2000": ("of 4,000, by that", "at most 2.2"),
    "peak_run_MB": ("run of an hour: peak", "at most 500 MB"),
    "peak_regress_MB": ("regress of an hour: peak", "at most 600 MB"),
    "peak_compare_MB": ("compare of two runs of an hour: peak", "at most 600 MB"),
    "long_run_growth_MB": ("run: peak of an hour less that of ten minutes", "no more than 4 MB"),
}


def figures(step: float, length: float = HOUR) -> dict[str, float]:
    """Measure all figures; `step`: cost of an `mj_step` [s]; `length`: of the long runs [s]."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        seconds = sweep_row(place)
        small, large = (set_up(place / str(count), count) for count in VARIABLES)
        peaks = long_runs(place, length)
    ticks = load_scenario("pick_and_place").duration / STEP_SIZE
    return {
        "sweep_rows_per_s": 1.0 / seconds,
        "sweep_row_by_ticks": JOBS * seconds / (ticks * step),
        "set_up_2000_s": small,
        "set_up_4000_by_2000": large / small,
        **peaks,
    }


def sweep_row(place: Path) -> float:
    """Wall time of a row of a sweep [s]."""
    definition = shipped_sweeps()[SWEEP].read_text(encoding="utf-8")
    taken = []
    for samples in SAMPLES:
        file = place / f"{samples}.toml"
        lines = definition.splitlines(keepends=True)
        shorter = (f"samples = {samples}\n" if "samples" in line else line for line in lines)
        file.write_text("".join(shorter), encoding="utf-8")
        began = clock.perf_counter()
        _peak("sweep", file, "--jobs", JOBS, "--out", place / f"sweep-{samples}")
        taken.append(clock.perf_counter() - began)
    return (taken[1] - taken[0]) / (SAMPLES[1] - SAMPLES[0])


def set_up(folder: Path, variables: int) -> float:
    """Processor time from the files of two FMUs, connected by half of their variables, to t = 0."""
    folder.mkdir()
    numbers = range(1, variables // 2 + 1)
    inputs = (input_(f"u{i}", (), "", "An input", 0.0) for i in numbers)
    outputs = (output(f"y{i}", (), "", "An output", start=0.0) for i in numbers)
    table = (*inputs, *outputs)
    for name in "ab":
        interface = Interface(f"Big{name.upper()}", "Many variables", table)
        build_fmu(NativeFmu(interface, "player", "Holds 0."), folder / f"{name}.fmu")
    connections = "".join(f'"b.u{i}" = "a.y{i}"\n' for i in numbers)
    system = 'duration = 0.01\n[fmus]\na = "a.fmu"\nb = "b.fmu"\n[connect]\n'
    (folder / SCENARIO_FILE).write_text(system + connections, encoding="utf-8")
    began = clock.process_time()
    with Execution(prepare(load_scenario(folder)), writes=False):
        return clock.process_time() - began


def long_runs(place: Path, length: float) -> dict[str, float]:
    """Peaks of memory with runs of a length [MB]."""
    folder = place / "long"
    copytree(shipped_scenarios()["pick_and_place"], folder, ignore=lambda *_: ["reference.parquet"])
    path = folder / SCENARIO_FILE
    text = path.read_text(encoding="utf-8").replace("duration = 6.5", f"duration = {length}")
    path.write_text(text, encoding="utf-8")
    plain = ("--no-video", "--no-view")
    shorter = _peak("run", folder, *plain, "--duration", length / 6, "--out", place / "shorter")
    longer = _peak("run", folder, *plain, "--out", place / "longer")
    _peak("regress", folder, "--update", "--yes")
    return {
        "peak_run_MB": longer,
        "peak_regress_MB": _peak("regress", folder),
        "peak_compare_MB": _peak("compare", place / "longer", place / "longer"),
        "long_run_growth_MB": longer - shorter,
    }


def _peak(*words: object) -> float:
    """Run a command of ours; return the largest memory of one of its processes [MB]."""
    command = [*OURS, *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        message = process.stderr.read() if process.stderr else b""
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 3):
        why = f"ended with {process.returncode}:\n{message.decode()}"
        raise CosimError(f"{' '.join(command)} {why}")
    return usage.ru_maxrss / 1024
