"""Costs that grow with rows, variables and length: `bench_history.py --all` calls `figures`.

`python .ci/growth.py HOURS` prints the memory of a process that steps the task for so many
simulated hours, without recording: a scenario lasts an hour at most.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time as clock
from collections.abc import Sequence
from pathlib import Path
from resource import getpagesize
from shutil import copytree
from typing import Final

import numpy as np
from numpy.typing import NDArray

from panda_cosim.assets import STEP_SIZE
from panda_cosim.fmus.build.native import NativeFmu
from panda_cosim.fmus.interface.variables import Interface, Variable
from panda_cosim.fmus.master.wiring import BLOCK_ROWS
from panda_cosim.fmus.sources.targets import Target
from panda_cosim.run.execution import Execution
from panda_cosim.run.prepare import prepare
from panda_cosim.run.stopping import StopRequest
from panda_cosim.study.benchmark import OURS, SHELL
from panda_cosim.study.sweep.definition import shipped_sweeps
from panda_cosim.task.scenario import SCENARIO_FILE, load_scenario, shipped_scenarios

FEW, MANY = 8, 40  # rows of two sweeps, whose difference is without start and end
HOUR: Final = 3600.0  # [s]


def figures(step: float, length: float = HOUR) -> dict[str, float]:
    """Measure all figures; `step`: cost of an `mj_step` [s]; `length`: of the long runs [s]."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        task, out = place / "task", place / "out"
        copytree(shipped_scenarios()["pick_and_place"], task)
        (task / "reference.parquet").unlink()
        _change(task / SCENARIO_FILE, "duration = 6.5", f"duration = {length}")
        for rows in (FEW, MANY):
            file = place / f"{rows}.toml"
            file.write_text(shipped_sweeps()["random_box"].read_text(encoding="utf-8"))
            _change(file, "samples = .*", f"samples = {rows}")
        commands = {
            "few": f"sweep {place}/{FEW}.toml --jobs 2 --out {out}/few",
            "many": f"sweep {place}/{MANY}.toml --jobs 2 --out {out}/many",
            "run": f"run {task} --no-video --no-view --out {out}/b",
            "reference": f"regress {task} --update --yes",
            "regress": f"regress {task}",
            "compare": f"compare {out}/b {out}/b",
        }
        costs = {name: cost_of((*OURS, *words.split())) for name, words in commands.items()}
        added = memory_added(task, out / "a")
        small, large = (set_up(place / str(count), count) for count in (2_000, 4_000))
    row = (costs["many"][0] - costs["few"][0]) / (MANY - FEW)  # [s]
    ticks = load_scenario("pick_and_place").duration / STEP_SIZE
    return {
        "sweep_rows_per_s": 1.0 / row,
        "sweep_row_by_ticks": 2 * row / (ticks * step),
        "set_up_2000_s": small,
        "set_up_4000_by_2000": large / small,
        "peak_run_MB": costs["run"][1],
        "peak_regress_MB": max(costs[each][1] for each in ("reference", "regress")),
        "peak_compare_MB": costs["compare"][1],
        "long_run_growth_MB": added,
    }


def cost_of(command: Sequence[str]) -> tuple[float, float]:
    """Run a command; return its wall time [s], and the most memory of one of its processes [MB]."""
    start = clock.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, env=SHELL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 3):
        raise RuntimeError(f"{' '.join(command)} ended with {process.returncode}")
    return clock.perf_counter() - start, usage.ru_maxrss / 1024


def _change(file: Path, pattern: str, text: str) -> None:
    file.write_text(re.sub(pattern, text, file.read_text(encoding="utf-8")), encoding="utf-8")


def memory_added(task: Path, out: Path) -> float:
    """Memory of its own that a run's steps add after its first sixth [MB].

    Pages of files do not count: the system takes them away and brings them back.
    """
    with Execution(prepare(load_scenario(task)), out) as execution:
        resident = []
        for last in (execution.ticks // 6, execution.ticks):
            execution.advance(last, StopRequest())
            resident.append(own_memory())
    return resident[1] - resident[0]


def own_memory() -> float:
    """Memory of this process without pages of files [MB]."""
    words = Path("/proc/self/statm").read_text(encoding="utf-8").split()
    return (int(words[1]) - int(words[2])) * getpagesize() / 1e6


def step_for(hours: int) -> None:
    """Step the task, and print the memory after each hour; its last command is held."""
    prepared = prepare(load_scenario("pick_and_place"))
    inputs = prepared.inputs()
    held = np.repeat(inputs[-1:], BLOCK_ROWS, axis=0)
    ticks = round(HOUR / STEP_SIZE)
    with prepared.open([], longer=hours * HOUR) as system:
        master = system.master
        master.begin(lambda _rows: None)
        master.step(prepared.scenario.ticks, inputs)
        for hour in range(1, hours + 1):
            master.step(hour * ticks - master.steps, _Held(held))
            print(f"{hour} h: {own_memory():.1f} MB", flush=True)


class _Held:
    """The same inputs at all ticks."""

    def __init__(self, rows: NDArray[np.float64]) -> None:
        self._rows, self.shape = rows, rows.shape

    def __getitem__(self, ticks: slice) -> NDArray[np.float64]:
        return self._rows[: ticks.stop - ticks.start]


def set_up(folder: Path, variables: int) -> float:
    """Processor time from the files of two FMUs, connected by half of their variables, to t = 0."""
    folder.mkdir()
    numbers = range(1, variables // 2 + 1)
    inputs = [Variable(f"u{i}", (), "", "input", "continuous", "An input", 0.0) for i in numbers]
    outputs = [
        Variable(f"y{i}", (), "", "output", "continuous", "An output", start=0.0) for i in numbers
    ]
    for name in "ab":
        interface = Interface(f"Big{name.upper()}", "Many variables", (*inputs, *outputs))
        fmu = Target().make(NativeFmu(interface, "player", "Holds 0."))
        (folder / f"{name}.fmu").write_bytes(fmu)
    connections = "".join(f'"b.u{i}" = "a.y{i}"\n' for i in numbers)
    system = 'duration = 0.01\n[fmus]\na = "a.fmu"\nb = "b.fmu"\n[connect]\n'
    (folder / SCENARIO_FILE).write_text(system + connections, encoding="utf-8")
    began = clock.process_time()
    with Execution(prepare(load_scenario(folder)), writes=False):
        return clock.process_time() - began


if __name__ == "__main__":
    step_for(int(sys.argv[1]))
