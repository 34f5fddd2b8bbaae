"""Measures the cost of a co-simulation step, compared with the physics alone and another loop.

All ways take turns in chunks of some milliseconds over the same scenario, again and again, so
that their ratios are also valid on a machine with other load.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import tempfile
import time as clock
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from fmpy.simulation import apply_start_values, instantiate_fmu

from ..assets import STEP_SIZE
from ..fmus import processes
from ..fmus.errors import CosimError
from ..fmus.interface.controller import COMMANDS
from ..fmus.interface.plant import PLANT
from ..fmus.interface.sensors import MEASURED
from ..fmus.interface.tables import INTERFACES
from ..fmus.master.fmu_file import Fmu
from ..fmus.master.system import OpenSystem
from ..fmus.master.wiring import Array
from ..fmus.sources.targets import Kind
from ..plant.parameters import PlantParameters
from ..plant.plant import Plant
from ..plant.scene import load_scene
from ..run.execution import Execution
from ..run.options import Options
from ..run.output import versions
from ..run.prepare import Prepared, prepare
from ..task.scenario import load_scenario
from .work import processor

FORMAT: Final = 4  # of the JSON file
MICRO: Final = 1e6  # [us/s]
CHUNK: Final = 650  # [tick] that a way takes before the next one's turn: a tenth of the workload
_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
LABELS: Final[Mapping[str, str]] = _TABLES["labels"]
RATIOS: Final[Mapping[str, tuple[str, str, str]]] = _TABLES["ratios"]
SHELL: Final = {name: value for name, value in os.environ.items()
                if name not in _TABLES["environment"]["of_program"]}  # fmt: skip
OURS: Final = (sys.executable, "-m", "panda_cosim")
IMPORTS: Final = "import numpy, mujoco, fmpy, pyarrow"  # what a cold run is compared with
IMPORTING: Final = f'python -c "{IMPORTS}"'

# Takes a number of steps from a tick on, and returns positions of arm, fingers and block (16,).
Way = tuple[Callable[[int, int], object], Callable[[], Array]]


def _physics(prepared: Prepared, targets: Array, *, drawn: bool) -> Way:
    """(a) Bare `mj_step` with the servo targets of the whole loop (steps, 8)."""
    scene = PlantParameters(scene=prepared.scenario.scene)
    model, step = load_scene(scene, drawn=drawn), mujoco.mj_step
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = Plant(scene).data.qpos, targets[0]
    mujoco.mj_forward(model, data)
    ctrl = data.ctrl

    def advance(first: int, count: int) -> None:
        for k in range(first, first + count):
            ctrl[:] = targets[k]
            step(model, data)

    return advance, lambda: np.array(data.qpos)


def _own_master(prepared: Prepared, system: OpenSystem) -> Way:
    """(c) This project's master over the FMUs."""
    master, commands = system.master, prepared.inputs()
    where = [1 + master.columns.index(("plant", name)) for name in PLANT.variable("qpos").names()]
    master.begin(lambda _rows: None)

    def state() -> Array:
        return np.asarray(master.latest()[where], float)

    return lambda _, count: master.step(count, commands), state


@contextmanager
def _plain_loop(prepared: Prepared) -> Iterator[Way]:
    """(b) A plain loop over FMPy's `FMU2Slave` as its documentation shows it, with lists."""
    slaves, fmus = {}, dict[str, Fmu]()
    with ExitStack() as stack:
        for name, path in prepared.assembly.system.fmus.items():
            fmus[name] = fmu = Fmu(path)
            slaves[name] = slave = instantiate_fmu(str(fmu.folder), fmu.description)
            stack.callback(slave.freeInstance)
            stack.callback(slave.terminate)
            slave.setupExperiment(startTime=0.0)
            given = prepared.start_values()[name].items()
            values = {n: fmu.variable(n).converted(v) for n, v in given}
            apply_start_values(slave, fmu.description, values)
            slave.enterInitializationMode()
            slave.exitInitializationMode()
        yield _with_lists(slaves, fmus, prepared.inputs()[:].tolist())


def _with_lists(slaves: Mapping[str, Any], fmus: Mapping[str, Fmu], commands: list[Any]) -> Way:
    def of(instance: str, *names: str) -> list[int]:
        interface = INTERFACES[instance]
        variables = [interface.variable(name) for name in names] or interface.of("output")
        return [fmus[instance].variable(n).value_reference for v in variables for n in v.names()]

    plant, controller = slaves["plant"], slaves["controller"]
    targets, answers = of("controller", *COMMANDS), of("controller")
    servos, outputs, position = of("plant", "ctrl"), of("plant"), of("plant", "qpos")
    measured = of("controller", *MEASURED)
    seen = [n for name in MEASURED for n in INTERFACES["controller"].variable(name).names()]
    where = [outputs.index(fmus["plant"].variable(n).value_reference) for n in seen]
    rows = []

    def advance(first: int, count: int) -> None:
        state = plant.getReal(outputs)
        for k in range(first, first + count):
            controller.setReal(targets, commands[k])
            controller.setReal(measured, [state[i] for i in where])
            controller.doStep(k * STEP_SIZE, STEP_SIZE)
            answer = controller.getReal(answers)
            rows.append([k * STEP_SIZE, *commands[k], *state, *answer])
            plant.setReal(servos, answer[:8])
            plant.doStep(k * STEP_SIZE, STEP_SIZE)
            state = plant.getReal(outputs)

    return advance, lambda: np.array(plant.getReal(position))


@dataclass(frozen=True)
class Spread:
    """A median with the quartiles about it."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Array) -> Spread:
        """Return that of some values."""
        return cls(*np.percentile(values, (50, 25, 75)).tolist())

    def texts(self, digits: int) -> tuple[str, str]:
        """Return the median and the quartiles with some digits after the point."""
        return f"{self.median:.{digits}f}", f"{self.low:.{digits}f} to {self.high:.{digits}f}"


@dataclass(frozen=True)
class BenchResult:
    """Results of `bench`."""

    scenario: str
    steps: dict[str, Spread]  # cost of a step by way, see `LABELS` [us]
    ratios: dict[str, Spread]  # of two ways' costs in the same pass, see `RATIOS`
    real_time_factor: float  # simulated by wall time of stepping with our master
    start_up: dict[str, float]  # best times of whole commands, in new processes [s]
    machine: dict[str, str]  # where it was measured, and with what

    def to_json(self) -> str:
        """All numbers as JSON text."""
        return json.dumps({"format": FORMAT, **asdict(self)}, indent=2)


def bench(
    scenario: str = "pick_and_place", repeats: int = 7, chunk: int = CHUNK, kind: Kind = "native"
) -> BenchResult:
    """Measure steps and whole commands."""
    prepared = prepare(load_scenario(scenario), Options(kind=kind))
    with Execution(prepared, writes=False) as execution:
        execution.advance()
        targets = execution.close().recording["controller.ctrl"]
    passes = [_one_pass(prepared, targets, chunk) for _ in range(repeats)]
    costs = {way: np.array([taken[way] for taken in passes]) for way in LABELS}
    steps = {way: Spread.of(values) for way, values in costs.items()}
    run = f"panda-cosim run {scenario} --no-video"
    times = start_up(run, kind)
    costs |= {"run": np.array(times[run]), "imports": np.array(times[IMPORTING])}
    ratios = {name: Spread.of(costs[over] / costs[by]) for name, (over, by, _) in RATIOS.items()}
    best = {command: min(taken) for command, taken in times.items()}
    machine = {"processor": processor(), "cores": str(os.cpu_count())}
    machine |= {"system": f"{platform.system()} {platform.machine()}"} | versions()
    factor = STEP_SIZE * MICRO / steps["master"].median
    return BenchResult(scenario, steps, ratios, factor, best, machine)


def _one_pass(prepared: Prepared, targets: Array, chunk: int) -> dict[str, float]:
    """Cost of a step by way over a whole pass, as contacts make some steps dearer [us]."""
    by_fmpy = replace(prepared, options=Options(master="fmpy"))
    with _plain_loop(prepared) as plain, prepared.open([]) as ours, by_fmpy.open([]) as other:
        ways: dict[str, Way] = {
            "physics": _physics(prepared, targets, drawn=True),
            "bare": _physics(prepared, targets, drawn=False),
            "lists": plain,
            "master": _own_master(prepared, ours),
            "fmpy": _own_master(prepared, other),
        }
        taken = dict.fromkeys(ways, 0.0)
        done = range(0, prepared.scenario.ticks - chunk + 1, chunk)
        for first in done:
            for name, (advance, _) in ways.items():
                # The processor's time, as all that is measured computes and never waits: what
                # others do on the machine counts little then.
                start = clock.thread_time()
                advance(first, chunk)
                taken[name] += clock.thread_time() - start
        ends = {name: state() for name, (_, state) in ways.items()}
    for name, end in ends.items():  # all have done the same
        if not np.array_equal(end, ends["physics"]):
            raise CosimError(f"{LABELS[name]} ends elsewhere than {LABELS['physics']}")
    return {name: seconds / (len(done) * chunk) * MICRO for name, seconds in taken.items()}


def start_up(run: str, kind: Kind, times: int = 7) -> dict[str, list[float]]:
    """Times of whole commands, such as `run`, a run, which take turns [s]."""
    program, *arguments = run.split()
    taken: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for i in range(times):
            commands = {
                "python -c pass": [sys.executable, "-c", "pass"],
                IMPORTING: [sys.executable, "-c", IMPORTS],
                f"{program} --help": [*OURS, "--help"],
                run: [*OURS, *arguments, "--kind", kind, "--out", f"{folder}/{i}"],
            }
            for name, command in commands.items():
                start = clock.perf_counter()
                done = processes.run(command, environment=SHELL)
                taken.setdefault(name, []).append(clock.perf_counter() - start)
                if done.returncode not in (0, 3):
                    raise CosimError(f"{name} ended with {done.returncode}:\n{done.stderr}")
    return taken
