"""Runs without FMUs, and many random pick-and-place tasks.

Plant, controller and trajectory in a plain loop give the same numbers as the co-simulation, bit for
bit, and need no FMUs. `panda-cosim sweep random_box` draws such tasks for the co-simulation itself.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from panda_cosim.assets import STEP_SIZE
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import Gains
from panda_cosim.fmus.interface.controller import CONTROLLER
from panda_cosim.fmus.interface.parameters import grouped
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.plant.plant import Plant, PlantParameters
from panda_cosim.scenarios.judging.limits import largest_share
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.run.start import Overrides, instants, resolve, start_values
from panda_cosim.scenarios.run.summary import Summary, summarize
from panda_cosim.scenarios.scenario.scenario import Scenario
from panda_cosim.scenarios.scenario.trajectory import COMMANDS

Array = NDArray[np.float64]

# Ranges of a random task: offset from the nominal place, yaw, mass, friction.
OFFSET = 0.10  # [m]
YAW = np.pi / 4  # [rad]
MASS = (0.05, 0.5)  # [kg]
FRICTION = (0.5, 1.2)  # [1]
SEED = 4


@dataclass(frozen=True, eq=False)
class Course:
    """What happened at each tick from t = 0 to the end; read by name as a `Recording` is.

    Attributes:
        time: Instants (n,) [s].
        commands: Shape (n, 14), columns as in `scenarios.scenario.trajectory.COMMANDS`.
        plant: The plant's outputs, a structured array (n,), see `plant.OUTPUTS`.
        controller: The controller's outputs, a structured array (n,), see `controller.OUTPUTS`.
        metadata: As a recording's; here the parameters alone.
    """

    time: Array
    commands: Array
    plant: NDArray[Any]
    controller: NDArray[Any]
    metadata: Mapping[str, Any]
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
        """Tell whether there is a signal of that name, or an element of one."""
        instance, _, signal = name.partition("[")[0].partition(".")
        is_command = instance == "controller" and bool(_columns(signal))
        return is_command or signal in (getattr(self, instance).dtype.names or ())

    def __getitem__(self, name: str) -> Array:
        """Return a signal by its name in a recording, as "plant.qpos"; shape (n, ...).

        An element, as "plant.qpos[12]", has shape (n,).
        """
        whole, _, index = name.partition("[")
        instance, _, signal = whole.partition(".")
        columns = _columns(signal) if instance == "controller" else []
        values: Array = self.commands[:, columns] if columns else getattr(self, instance)[signal]
        values = values[:, 0] if len(columns) == 1 else values
        return values.reshape(self.rows, -1)[:, int(index[:-1]) - 1] if index else values


def _columns(signal: str) -> list[int]:
    """Places of a signal among the commands."""
    return [i for i, command in enumerate(COMMANDS) if command.split("[")[0] == signal]


def run_plain(scenario: Scenario, overrides: Overrides | None = None) -> Course:
    """Run a scenario with plain objects in place of FMUs; its pushes are left out.

    Args:
        scenario: What shall happen.
        overrides: Parameters by instance and name.

    Raises:
        InputError: A name is unknown, or a value out of its bounds.
    """
    values = start_values(scenario, overrides)
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
    made = [rows.view(part.outputs.dtype)[:, 0] for part, rows in log.items()]
    return Course(
        instants(scenario),
        commands,
        made[0],
        made[1],
        {"coupling": scenario.coupling, "parameters": values},
    )


def connect(plant: Plant, controller: Controller) -> None:
    """Copy the plant's outputs to the controller's inputs."""
    for name in ("hand_xpos", "hand_xquat", "jac", "qfrc_bias"):
        controller.inputs[name] = plant.outputs[name]
    for name in ("qpos", "qvel"):
        controller.inputs[name] = plant.outputs[name][:7]


@dataclass(frozen=True)
class Task:
    """A block to be picked up: where it is, and what it is.

    Attributes:
        x: Of the block's centre, world frame [m].
        y: Of the block's centre, world frame [m].
        yaw: Turn about z [rad].
        mass: Mass [kg].
        friction: Sliding friction [1].
    """

    x: float
    y: float
    yaw: float
    mass: float
    friction: float

    def settings(self) -> dict[str, float]:
        """Return the plant's parameters by name."""
        return {
            "block_pos[1]": self.x,
            "block_pos[2]": self.y,
            "block_yaw": self.yaw,
            "block_mass": self.mass,
            "block_friction": self.friction,
        }


def random_tasks(count: int, seed: int = SEED) -> list[Task]:
    """Draw tasks; the first ones are the same however many are drawn."""
    nominal = PlantParameters()
    low = (*(p - OFFSET for p in nominal.block_pos), -YAW, MASS[0], FRICTION[0])
    high = (*(p + OFFSET for p in nominal.block_pos), YAW, MASS[1], FRICTION[1])
    drawn = np.random.default_rng(seed).uniform(low, high, (count, len(low)))
    return [Task(*row) for row in drawn.tolist()]


@dataclass(frozen=True)
class Outcome:
    """How a task went.

    Attributes:
        task: The task.
        summary: Metrics, and whether the scenario's criteria hold.
    """

    task: Task
    summary: Summary

    @property
    def largest_share(self) -> float:
        """Largest share of any of the robot's limits [1]."""
        share = largest_share(self.summary.limits)
        assert share is not None
        return share

    @property
    def ok(self) -> bool:
        """The criteria hold, and no limit was exceeded."""
        return self.summary.success and self.largest_share <= 1.0


def run_task(scenario: Scenario, task: Task) -> Outcome:
    """Run a scenario on another block."""
    course = run_plain(scenario, {"plant": task.settings()})
    # A summary reads signals by their names only.
    return Outcome(task, summarize(cast(Recording, course), scenario))


def run_tasks(
    scenario: Scenario, tasks: Sequence[Task], processes: int | None = None
) -> Iterator[Outcome]:
    """Run a scenario on many blocks, several at a time.

    Args:
        scenario: What shall happen.
        tasks: On which blocks.
        processes: How many at a time; None: one a core.

    Yields:
        The outcomes, in the order of the tasks.
    """
    with ProcessPoolExecutor(processes or os.cpu_count()) as pool:
        yield from pool.map(partial(run_task, scenario), tasks)
