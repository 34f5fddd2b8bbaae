"""Measures the cost of a co-simulation step, compared with the physics alone and another loop.

All ways take turns in chunks of some milliseconds over the same scenario, again and again, so
that their ratios are also valid on a machine with other load.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time as clock
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich import box
from rich.console import Group
from rich.table import Table

from ...assets import STEP_SIZE
from ...assets.franka import HOME_Q
from ...controller.sensors import SensorErrors, Sensors
from ...fmus.errors import CosimError
from ...fmus.packaging.build import Kind
from ..definition.mismatch import Mismatch
from ..definition.scenario import load_scenario
from ..running.options import Options
from ..running.prepare import prepare
from .ways import OwnMaster, PlainLoop, Way, Workload

FORMAT: Final = 2  # of the JSON file
MICRO: Final = 1e6  # [us/s]
CHUNK: Final = 650  # [tick] that a way takes before the next one's turn: a tenth of the workload
PACKAGES: Final = ("fmpy", "mujoco", "numpy", "panda-cosim", "pythonfmu")
LABELS: Final = {
    "physics": "(a) mj_step of the scene with the shapes that are only drawn",
    "bare": "(a') mj_step of the model that the FMU steps",
    "lists": "(b) a plain loop over the FMUs with FMPy's FMU2Slave",
    "master": "(c) our master over the FMUs",
}
RATIOS: Final = {
    "c/a": ("master", "physics", "at most 1.5; Python 2.6"),
    "c/a'": ("master", "bare", "at most 1.7"),
    "b/c": ("lists", "master", "at least 2"),
}
SENSORS: Final = {
    "exact": Mismatch(dropout=0.0),
    "hand pose by the model": Mismatch(hand_pose_source="model"),
    "calibrated": Mismatch(preset="calibrated"),
}
"""Errors for which the sensors are measured, by what the table calls them."""


@dataclass(frozen=True)
class Spread:
    """A median with the quartiles about it."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Any) -> Spread:
        """Return that of some values."""
        low, median, high = np.percentile(values, (25, 50, 75))
        return cls(float(median), float(low), float(high))


@dataclass(frozen=True)
class BenchResult:
    """Results of `bench`.

    Attributes:
        scenario: Name of the scenario that was stepped.
        steps: Cost of a step by way, see `LABELS` [us].
        ratios: Ratios of two ways' costs in the same pass, see `RATIOS`.
        real_time_factor: Simulated by wall time of stepping with our master.
        objects: Medians of what a reading of the sensors costs, which few scenarios have [us].
        start_up: Best times of whole commands, in new processes [s].
        machine: Where it was measured, and with what.
    """

    scenario: str
    steps: dict[str, Spread]
    ratios: dict[str, Spread]
    real_time_factor: float
    objects: dict[str, float]
    start_up: dict[str, float]
    machine: dict[str, str]

    def to_json(self) -> str:
        """All numbers as JSON text."""
        return json.dumps({"format": FORMAT, **asdict(self)}, indent=2)


def bench(
    scenario: str = "pick_and_place", repeats: int = 7, chunk: int = CHUNK, kind: Kind = "native"
) -> BenchResult:
    """Measure what a step costs in several ways, and what whole commands take.

    Args:
        scenario: What is stepped.
        repeats: Passes over the scenario.
        chunk: Steps that a way takes before the next one's turn.
        kind: Kind of the FMUs.

    Returns:
        The result.

    Raises:
        InputError: No such scenario.
        CosimError: The ways disagree: then one of them does something else.
    """
    prepared = prepare(load_scenario(scenario), Options(kind=kind))
    workload = Workload(prepared.scenario, prepared.assembly.system)
    passes = [_one_pass(workload, chunk) for _ in range(repeats)]
    costs = {way: np.array([taken[way] for taken in passes]) for way in LABELS}
    steps = {way: Spread.of(values) for way, values in costs.items()}
    return BenchResult(
        scenario,
        steps,
        {name: Spread.of(costs[over] / costs[by]) for name, (over, by, _) in RATIOS.items()},
        STEP_SIZE * MICRO / steps["master"].median,
        {f"Sensors.update, {name}": _reading(errors) for name, errors in SENSORS.items()},
        start_up(scenario, kind),
        _machine(),
    )


def _one_pass(workload: Workload, chunk: int) -> dict[str, float]:
    """Cost of a step by way over a whole pass, as contacts make some steps dearer [us]."""
    with closing(PlainLoop(workload)) as plain, workload.opened() as session:
        ways: dict[str, Way] = {
            "physics": workload.physics(drawn=True),
            "bare": workload.physics(drawn=False),
            "lists": plain,
            "master": OwnMaster(workload, session),
        }
        taken = dict.fromkeys(ways, 0.0)
        done = range(0, workload.steps - chunk + 1, chunk)
        for first in done:
            for name, way in ways.items():
                # The processor's time, as all that is measured computes and never waits: what
                # others do on the machine counts little then.
                start = clock.thread_time()
                way.advance(first, chunk)
                taken[name] += clock.thread_time() - start
        _compare(ways)
    return {name: seconds / (len(done) * chunk) * MICRO for name, seconds in taken.items()}


def _compare(ways: Mapping[str, Way]) -> None:
    """Make sure that all have done the same."""
    expected = ways["physics"].state()
    for name, way in ways.items():
        if not np.array_equal(way.state(), expected):
            raise CosimError(f"{LABELS[name]} ends elsewhere than {LABELS['physics']}")


def _reading(mismatch: Mismatch, ticks: int = 2000) -> float:
    """Median cost of a reading of the sensors [us]."""
    errors = mismatch.start_values()["sensors"]
    delay = round(errors.get("delay", 0.0) / STEP_SIZE)
    sensors = Sensors(SensorErrors(**errors | {"delay": delay}))
    sensors.truth["qpos"] = HOME_Q
    taken = np.zeros(ticks)
    for tick in range(ticks):
        start = clock.perf_counter()
        sensors.update()
        taken[tick] = clock.perf_counter() - start
    return float(np.median(taken)) * MICRO


def start_up(scenario: str, kind: Kind, times: int = 3) -> dict[str, float]:
    """Best time of whole commands [s]."""
    ours = [sys.executable, "-m", "panda_cosim"]
    run = [*ours, "run", scenario, "--no-video", "--kind", kind]
    with tempfile.TemporaryDirectory() as folder:
        return {
            "python -c pass": min(_run([sys.executable, "-c", "pass"]) for _ in range(times)),
            "panda-cosim --help": min(_run([*ours, "--help"]) for _ in range(times)),
            f"panda-cosim run {scenario} --no-video": min(
                _run([*run, "--out", f"{folder}/{i}"]) for i in range(times)
            ),
        }


def _run(command: list[str]) -> float:
    start = clock.perf_counter()
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode not in (0, 3):
        raise CosimError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
    return clock.perf_counter() - start


def _machine() -> dict[str, str]:
    return {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{package: version(package) for package in PACKAGES},
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((n.partition(": ")[2] for n in lines if n.startswith("model name")), "")


def tables(result: BenchResult) -> Group:
    """Return all tables of a result for a terminal, one below the other."""
    steps = _table(f"Cost of a step of {result.scenario} \\[us]", "way", "median", "quartiles")
    for way, spread in result.steps.items():
        quartiles = f"{spread.low:.1f} to {spread.high:.1f}"
        steps.add_row(LABELS[way], f"{spread.median:.1f}", quartiles)
    for part, cost in result.objects.items():
        steps.add_row(part, f"{cost:.1f}", "")
    steps.caption = f"(c) runs at {result.real_time_factor:.1f} times real time"
    ratios = _table("Ratios in the same pass", "ratio", "median", "quartiles", "goal")
    for name, spread in result.ratios.items():
        quartiles = f"{spread.low:.2f} to {spread.high:.2f}"
        ratios.add_row(name, f"{spread.median:.2f}", quartiles, RATIOS[name][2])
    commands = _table("Whole commands", "command", "best of 3")
    for what, seconds in result.start_up.items():
        commands.add_row(what, f"{seconds:.2f} s")
    machine = ", ".join(f"{key} {value}" for key, value in result.machine.items())
    return Group(steps, ratios, commands, machine)


def _table(title: str, first: str, *others: str) -> Table:
    """Return an empty table without a frame, which a narrow terminal would break up."""
    made = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False
    )
    made.add_column(first)
    for name in others:
        made.add_column(name, justify="right")
    return made
