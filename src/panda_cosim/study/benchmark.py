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
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from subprocess import DEVNULL, PIPE
from typing import Final

import mujoco
import numpy as np
from fmpy.simulation import apply_start_values, instantiate_fmu

from ..assets import STEP_SIZE
from ..fmus.errors import CosimError
from ..fmus.interface.controller import COMMANDS
from ..fmus.interface.tables import CONNECTIONS, INTERFACES
from ..fmus.master.fmu_file import Fmu
from ..fmus.master.system import OpenSystem
from ..fmus.master.wiring import Array, Name
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
LABELS: Final = {
    "physics": "(a) mj_step of the scene with the shapes that are only drawn",
    "bare": "(a') mj_step of the model that the FMU steps",
    "lists": "(b) a plain loop over the FMUs with FMPy's FMU2Slave",
    "master": "(c) our master over the FMUs, in C",
    "fmpy": "(d) our master with FMPy's methods, run --master fmpy",
}
RATIOS: Final = {
    "c/a": ("master", "physics", "at most 1.1; Python 6.3"),
    "c/a'": ("master", "bare", "at most 1.25"),
    "d/a": ("fmpy", "physics", "at most 2"),
    "b/c": ("lists", "master", "at least 2"),
    "cold run": ("run", "imports", "at most 2.2"),
}
OURS: Final = (sys.executable, "-m", "panda_cosim")
IMPORTS: Final = "import numpy, mujoco, fmpy, pyarrow"  # what a cold run is compared with
IMPORTING: Final = f'python -c "{IMPORTS}"'


# Commands are measured as in a shell, without what our command line sets for its own process, and
# with byte code, which modules of an editable install keep, too, as those that it imports do.
OF_PROGRAM: Final = (
    "MUJOCO_GL", "OPENBLAS_NUM_THREADS", "PANDA_COSIM_GL", "PYDANTIC_DISABLE_PLUGINS",
    "PYTHONDONTWRITEBYTECODE", "PYTHONSAFEPATH",
)  # fmt: skip

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
    where = [1 + master.columns.index(("plant", name)) for name in _names("plant", "qpos")]
    master.begin(lambda _rows: None)

    def state() -> Array:
        return np.asarray(master.latest()[where], float)

    return lambda _, count: master.step(count, commands), state


@contextmanager
def _plain_loop(prepared: Prepared) -> Iterator[Way]:
    """(b) A plain loop over FMPy's `FMU2Slave` as its documentation shows it, with lists."""
    slaves, references = {}, dict[Name, int]()
    for name, path in prepared.assembly.system.fmus.items():
        fmu = Fmu(path)
        slaves[name] = slave = instantiate_fmu(str(fmu.folder), fmu.description)
        slave.setupExperiment(startTime=0.0)
        given = prepared.start_values()[name].items()
        values = {n: fmu.variable(n).converted(v) for n, v in given}
        apply_start_values(slave, fmu.description, values)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        references |= {(name, n): v.value_reference for n, v in fmu.variables.items()}

    def of(instance: str, *variables: str) -> list[int]:
        return [references[instance, n] for v in variables for n in _names(instance, v)]

    plant, controller = slaves["plant"], slaves["controller"]
    targets, servos = of("controller", *COMMANDS), of("plant", "ctrl")
    outputs, answers = (
        of(name, *(v.name for v in INTERFACES[name].of("output")))
        for name in ("plant", "controller")
    )
    wires = [c for c in CONNECTIONS if c.source[0] == "plant"]
    measured = [references[c.target] for c in wires]
    where = [outputs.index(references[c.source]) for c in wires]
    commands, rows = prepared.inputs()[:].tolist(), []

    def advance(first: int, count: int) -> None:
        state = plant.getReal(outputs)
        for k in range(first, first + count):
            now = {"currentCommunicationPoint": k * STEP_SIZE, "communicationStepSize": STEP_SIZE}
            controller.setReal(targets, commands[k])
            controller.setReal(measured, [state[i] for i in where])
            controller.doStep(**now)
            answer = controller.getReal(answers)
            rows.append([k * STEP_SIZE, *commands[k], *state, *answer])
            plant.setReal(servos, answer[:8])
            plant.doStep(**now)
            state = plant.getReal(outputs)

    try:
        yield advance, lambda: np.array(plant.getReal(of("plant", "qpos")))
    finally:
        for slave in slaves.values():
            slave.terminate()
            slave.freeInstance()


def _names(instance: str, variable: str) -> list[str]:
    return INTERFACES[instance].variable(variable).names()


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
    scenario: str = "pick_and_place",
    repeats: int = 7,
    chunk: int = CHUNK,
    kind: Kind = "native",
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
    return BenchResult(
        scenario,
        steps,
        {name: Spread.of(costs[over] / costs[by]) for name, (over, by, _) in RATIOS.items()},
        STEP_SIZE * MICRO / steps["master"].median,
        {command: min(taken) for command, taken in times.items()},
        {
            "processor": processor(),
            "cores": str(os.cpu_count()),
            "system": f"{platform.system()} {platform.machine()}",
            **versions(),
        },
    )


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
                taken.setdefault(name, []).append(cost_of(command)[0])
    return taken


def cost_of(command: Sequence[str]) -> tuple[float, float]:
    """Run a command; return its wall time [s], and the most memory of one of its processes [MB]."""
    env = {name: value for name, value in os.environ.items() if name not in OF_PROGRAM}
    start = clock.perf_counter()
    with subprocess.Popen(command, stdout=DEVNULL, stderr=PIPE, env=env, text=True) as process:
        message = process.stderr.read() if process.stderr else ""
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 3):
        raise CosimError(f"{' '.join(command)} ended with {process.returncode}:\n{message}")
    return clock.perf_counter() - start, usage.ru_maxrss / 1024
