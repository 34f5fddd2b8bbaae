"""Measures the cost of a co-simulation step, compared with the physics alone and other loops.

All loops take turns in chunks of some milliseconds over the same scenario, again and again, so
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
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from ...assets import STEP_SIZE
from ...fmus.errors import CosimError
from ...fmus.master.fmu_file import Fmu
from ...fmus.master.system import System, open_system, panda_system
from ...fmus.packaging.build import Kind
from ...plant.scene import load_scene
from ..definition.scenario import load_scenario
from ..pictures.gl import RenderError
from ..pictures.offscreen import OffscreenRenderer
from ..running.start import start_values
from .bench_loops import (
    ListLoop,
    OwnMaster,
    Physics,
    PlainLoop,
    Way,
    Workload,
    own_master,
)
from .bench_parts import MICRO, master_parts, menagerie_model, object_parts, sensor_parts

FORMAT: Final = 1  # of the JSON file
CHUNK: Final = 650  # [tick] that a way takes before the next one's turn: a tenth of the workload
PACKAGES: Final = ("fmpy", "mujoco", "numpy", "panda-cosim", "pythonfmu")
LABELS: Final = {
    "physics": "(a) bare mj_step of the scene",
    "bare": "(a') without what is only drawn",
    "plain": "(b) plant and controller in a plain loop",
    "master": "(c) our master over the FMUs",
    "lists": "(d) FMPy's FMU2Slave with lists",
    "menagerie": "(a) with Menagerie's own arm",
}
RATIOS: Final = {
    "c/a": ("master", "physics", "at most 1.5; Python 2.6"),
    "c/a'": ("master", "bare", ""),
    "c/b": ("master", "plain", "at most 1.8"),
    "d/c": ("lists", "master", "at least 2"),
    "b/a": ("plain", "physics", ""),
    "a/Menagerie": ("physics", "menagerie", "at most 1"),
}


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
        parts: Medians of what a step of our master is made of [us].
        objects: Medians of the objects' own share, in a plain loop, and of the sensors [us].
        start_up: Best times of what comes before and around the steps [s].
        frame: Drawing a frame of 640 x 480 [ms]; None where no OpenGL works.
        machine: Where it was measured, and with what.
    """

    scenario: str
    steps: dict[str, Spread]
    ratios: dict[str, Spread]
    real_time_factor: float
    parts: dict[str, float]
    objects: dict[str, float]
    start_up: dict[str, float]
    frame: float | None
    machine: dict[str, str]

    def to_json(self) -> str:
        """All numbers as JSON text."""
        return json.dumps({"format": FORMAT, **asdict(self)}, indent=2)


def bench(
    scenario: str = "pick_and_place",
    repeats: int = 7,
    chunk: int = CHUNK,
    kind: Kind = "native",
) -> BenchResult:
    """Measure what a step costs in several ways, and what comes around the steps.

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
    loaded = load_scenario(scenario)
    workload = Workload(loaded, start_values(loaded))
    system = panda_system(kind=kind)
    costs = _take_turns(workload, system, repeats, chunk)
    parts = [master_parts(workload, system) for _ in range(repeats)]
    objects = [object_parts(workload) | sensor_parts() for _ in range(repeats)]
    steps = {way: Spread.of(values) for way, values in costs.items()}
    return BenchResult(
        loaded.name,
        steps,
        {
            name: Spread.of(costs[upper] / costs[lower])
            for name, (upper, lower, _) in RATIOS.items()
            if upper in costs and lower in costs
        },
        STEP_SIZE * MICRO / steps["master"].median,
        _medians(parts),
        _medians(objects),
        _start_up(system, workload, scenario, kind),
        _frame(workload),
        _machine(),
    )


def _medians(passes: list[dict[str, float]]) -> dict[str, float]:
    return {part: float(np.median([p[part] for p in passes])) for part in passes[0]}


def _take_turns(workload: Workload, system: System, repeats: int, chunk: int) -> dict[str, Any]:
    """Costs of a step by way, one value for each pass [us]."""
    fmus = {name: Fmu(path) for name, path in system.fmus.items()}
    folders = {name: (fmu.folder, fmu.description) for name, fmu in fmus.items()}
    plant = workload.plant()
    scene = load_scene(plant.parameters, drawn=True)
    other = menagerie_model(plant.model)
    costs: dict[str, list[float]] = {}
    for _ in range(repeats):
        with ExitStack() as stack:
            lists = ListLoop(workload, folders)
            stack.callback(lists.close)
            own: OwnMaster = stack.enter_context(own_master(workload, system))
            ways: dict[str, Way] = {
                "physics": Physics(workload, scene),
                "bare": Physics(workload, plant.model),
                "plain": PlainLoop(workload),
                "master": own,
                "lists": lists,
            }
            if other is not None:
                ways["menagerie"] = Physics(workload, other)
            _pass(workload.steps, chunk, ways, costs)
            _compare(ways)
    return {way: np.array(values) for way, values in costs.items()}


def _pass(steps: int, chunk: int, ways: Mapping[str, Way], costs: dict[str, list[float]]) -> None:
    """Add what a step costs each way, over a whole pass: contacts make some steps dearer."""
    taken = dict.fromkeys(ways, 0.0)
    done = range(0, steps - chunk + 1, chunk)
    for first in done:
        for name, way in ways.items():
            # The processor's time, as all that is measured computes and never waits: what
            # others do on the machine counts little then.
            start = clock.thread_time()
            way.advance(first, chunk)
            taken[name] += clock.thread_time() - start
    for name, seconds in taken.items():
        costs.setdefault(name, []).append(seconds / (len(done) * chunk) * MICRO)


def _compare(ways: Mapping[str, Way]) -> None:
    """Make sure that all have done the same."""
    expected = ways["plain"].state()
    for name in ("physics", "bare", "master", "lists"):
        if not np.array_equal(ways[name].state(), expected):
            raise CosimError(f"{LABELS[name]} ends elsewhere than {LABELS['plain']}")


def _start_up(system: System, workload: Workload, scenario: str, kind: Kind) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        out = iter(range(1000))
        command = [sys.executable, "-m", "panda_cosim"]
        run = [*command, "run", scenario, "--no-video", "--kind", kind]
        return {
            "python -c pass": _best(lambda: _run([sys.executable, "-c", "pass"])),
            "panda-cosim --help": _best(lambda: _run([*command, "--help"])),
            "FMUs opened, instantiated, initialized": _best(lambda: _open(system, workload)),
            f"panda-cosim run {scenario} --no-video": _best(
                lambda: _run([*run, "--out", f"{folder}/{next(out)}"])
            ),
        }


def _best(call: Callable[[], None], times: int = 3) -> float:
    taken = []
    for _ in range(times):
        start = clock.perf_counter()
        call()
        taken.append(clock.perf_counter() - start)
    return min(taken)


def _run(command: list[str]) -> None:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode not in (0, 3):
        raise CosimError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")


def _open(system: System, workload: Workload) -> None:
    with open_system(system, workload.values, stop=workload.steps * STEP_SIZE):
        pass


def _frame(workload: Workload, frames: int = 8) -> float | None:
    """Time to draw a frame [ms], after the first one."""
    qpos = np.tile(workload.plant().outputs["qpos"], (frames, 1))
    try:
        with closing(OffscreenRenderer(workload.scenario.scene, 640, 480)) as renderer:
            start = clock.perf_counter()
            for _ in renderer.frames(qpos):
                pass
            return (clock.perf_counter() - start) / frames * 1e3
    except RenderError:
        return None


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
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
