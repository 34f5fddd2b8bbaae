"""Runs without FMUs and in memory, and many random pick-and-place tasks.

Plant, controller and trajectory in a plain loop give the same numbers as the co-simulation, bit for
bit, and need no FMUs, but ten times as long. `panda-cosim sweep random_box` draws such tasks, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmu_support import in_fork
from panda_cosim.assets import STEP_SIZE
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import Gains
from panda_cosim.fmus.interface.controller import CONTROLLER
from panda_cosim.fmus.interface.parameters import grouped
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.plant.plant import Plant, PlantParameters
from panda_cosim.result.judging.summary import Summary
from panda_cosim.run.execution import Execution
from panda_cosim.run.prepare import Prepared, prepare
from panda_cosim.run.start import instants, resolve, start_values
from panda_cosim.run.stopping import StopRequest
from panda_cosim.task.scenario import Scenario
from panda_cosim.task.trajectory import COMMANDS

Array = NDArray[np.float64]

Task = dict[str, float]  # the plant's parameters by key

DRAWN = tuple(f"plant.block_{name}" for name in ("pos[1]", "pos[2]", "yaw", "mass", "friction"))
# Ranges of a random task: offset from the nominal place, yaw, mass, friction.
OFFSET = 0.10  # [m]
YAW = np.pi / 4  # [rad]
MASS = (0.05, 0.5)  # [kg]
FRICTION = (0.5, 1.2)  # [1]
SEED = 4


@dataclass(frozen=True, eq=False)
class Course:
    """What happened at each tick from t = 0 to the end; read by name as a `Recording` is."""

    time: Array  # instants (n,) [s]
    commands: Array  # (n, 14), columns as in `COMMANDS`
    plant: NDArray[Any]  # its outputs, a structured array (n,)
    controller: NDArray[Any]  # its outputs, a structured array (n,)
    metadata: Mapping[str, Any]  # as a recording's; here the parameters alone
    complete: bool = True
    reason: None = None

    @property
    def rows(self) -> int:
        """Number of instants."""
        return len(self.time)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each element, by its name."""
        scalars = [(part, s) for part, i in INTERFACES.items() for s in i.scalars()]
        named = {f"{part}.{s.name}": s.unit for part, s in scalars}
        return {name: unit for name, unit in named.items() if name in self}

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the elements."""
        return tuple(self.units)

    def __contains__(self, name: str) -> bool:
        instance, _, signal = name.partition("[")[0].partition(".")
        is_command = instance == "controller" and bool(_columns(signal))
        return is_command or signal in (getattr(self, instance).dtype.names or ())

    def in_blocks(self, *names: str, before: int = 0) -> Iterator[list[Array]]:
        """Yield signals in one block."""
        del before  # none are
        yield [self.time if name == "time" else self[name] for name in names]

    def __getitem__(self, name: str) -> Array:
        """Return a signal, as "plant.qpos" (n, ...), or an element, as "plant.qpos[12]" (n,)."""
        whole, _, index = name.partition("[")
        instance, _, signal = whole.partition(".")
        columns = _columns(signal) if instance == "controller" else []
        values: Array = self.commands[:, columns] if columns else getattr(self, instance)[signal]
        values = values[:, 0] if len(columns) == 1 else values
        element = tuple(int(i) - 1 for i in index[:-1].split(",")) if index else ()
        return values[(slice(None), *element)]


def _columns(signal: str) -> list[int]:
    """Places of a signal among the commands."""
    return [i for i, command in enumerate(COMMANDS) if command.split("[")[0] == signal]


def run_plain(scenario: Scenario) -> Course:
    """Run a scenario with plain objects in place of FMUs; its pushes are left out."""
    values = start_values(scenario)
    plant = Plant(PlantParameters(**grouped(PLANT, values["plant"])))
    gains = grouped(CONTROLLER, values["controller"])
    period = gains.pop("period")
    controller = Controller(Gains(**gains), period)
    period_ticks = round(controller.period / STEP_SIZE)
    commands = resolve(scenario, values).sample(instants(scenario))
    log = {part: np.empty((len(commands), part.output_values.size)) for part in (plant, controller)}
    delayed = scenario.coupling == "jacobi"
    ctrl = plant.inputs["ctrl"]
    for tick, command in enumerate(commands):
        if tick:
            plant.step()
        if delayed:
            ctrl[:] = controller.outputs["ctrl"]
        if tick % period_ticks == 0:
            controller.input_values[: len(COMMANDS)] = command
            connect(plant, controller)
            controller.update()
        if not delayed:
            ctrl[:] = controller.outputs["ctrl"]
        for part, rows in log.items():
            rows[tick] = part.output_values
    outputs = [rows.view(part.outputs.dtype)[:, 0] for part, rows in log.items()]
    metadata = {"coupling": scenario.coupling, "parameters": values}
    return Course(instants(scenario), commands, *outputs, metadata)


def connect(plant: Plant, controller: Controller) -> None:
    """Copy the plant's outputs to the controller's inputs."""
    for name in ("hand_xpos", "hand_xquat", "jac", "qfrc_bias", "actuator_force"):
        controller.inputs[name] = plant.outputs[name]
    for name in ("qpos", "qvel"):
        controller.inputs[name] = plant.outputs[name][:7]


def random_tasks(count: int, seed: int = SEED) -> list[Task]:
    """Draw blocks to pick up, as parameters; the first are the same however many are drawn."""
    nominal = PlantParameters()
    low = (*(p - OFFSET for p in nominal.block_pos), -YAW, MASS[0], FRICTION[0])
    high = (*(p + OFFSET for p in nominal.block_pos), YAW, MASS[1], FRICTION[1])
    drawn = np.random.default_rng(seed).uniform(low, high, (count, len(low)))
    return [dict(zip(DRAWN, row, strict=True)) for row in drawn.tolist()]


class Done(NamedTuple):
    """A finished run."""

    summary: Summary
    signals: dict[str, Array]  # by name, as "plant.qpos", one row an instant


def run_in_memory(scenario: Scenario) -> Done:
    """Run a scenario with its FMUs, in a forked process: a tenth of what a plain loop takes."""
    return Done(*in_fork(_in_memory, prepare(scenario)))


def _in_memory(prepared: Prepared) -> tuple[Summary, dict[str, Array]]:
    with Execution(prepared, writes=False) as execution:
        execution.advance(execution.ticks, StopRequest())
        run = execution.close()
    names = {name.partition("[")[0] for name in run.recording.columns}
    return run.summary, {name: run.recording[name] for name in names}
