"""Runs without FMUs, and many random pick-and-place tasks.

Plant, controller and trajectory in a plain loop give the same numbers as the co-simulation, bit for
bit, and need no FMUs. `python tests/random_tasks.py` tries 300 random tasks;
any one of them is repeated by `panda-cosim run` with the options that it prints.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from panda_cosim.assets import STEP_SIZE
from panda_cosim.controller import Controller, Gains
from panda_cosim.fmus.interface.controller import CONTROLLER
from panda_cosim.fmus.interface.parameters import grouped
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.plant import Plant, PlantParameters
from panda_cosim.scenarios.definition.scenario import Scenario, load_scenario
from panda_cosim.scenarios.definition.trajectory import COMMANDS
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.running.start import Overrides, instants, resolve, start_values
from panda_cosim.scenarios.running.summary import Summary, summarize

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
        commands: Shape (n, 14), columns as in `scenarios.definition.trajectory.COMMANDS`.
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

    def __getitem__(self, name: str) -> Array:
        """Return a signal by its name in a recording, as "plant.qpos"; shape (n, ...)."""
        instance, _, signal = name.partition(".")
        columns = [i for i, command in enumerate(COMMANDS) if command.split("[")[0] == signal]
        if instance == "controller" and columns:
            return self.commands[:, columns]
        values: Array = getattr(self, instance)[signal]
        return values


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
    return Course(instants(scenario), commands, made[0], made[1], {"parameters": values})


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

    def options(self) -> str:
        """Return what repeats the task with `panda-cosim run`."""
        return " ".join(f"--set plant.{name}={value!r}" for name, value in self.settings().items())


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
        """Largest share of any of the robot's limits."""
        return float(max(chain.from_iterable(self.summary.limits.values())))

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


def _count(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"value {number}; must be 1 or more")
    return number


def main(arguments: Sequence[str] | None = None) -> int:
    """Try random tasks, print what fails and the worst of all; return how many failed."""
    program = "python tests/random_tasks.py"
    parser = argparse.ArgumentParser(prog=program, description=main.__doc__)
    parser.add_argument("--count", type=_count, default=300, help="number of tasks")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the drawing")
    parser.add_argument("--processes", type=_count, help="how many at a time; default: one a core")
    options = parser.parse_args(arguments)
    scenario = load_scenario("pick_and_place")
    tasks = random_tasks(options.count, options.seed)
    outcomes = list(run_tasks(scenario, tasks, options.processes))
    failed = [outcome for outcome in outcomes if not outcome.ok]
    for outcome in failed:
        missed = [c.name for c in outcome.summary.criteria if not c.ok]
        print(f"failed: {outcome.task.options()}")
        print(f"  missed {missed}, largest share of a limit {outcome.largest_share:.3f}")
    place = [o.summary.block["place_error_mm"] or np.inf for o in outcomes]
    slip = [o.summary.block["slip_mm"] or np.inf for o in outcomes]
    track = [o.summary.tracking["max_mm"] for o in outcomes]
    shares = [o.largest_share for o in outcomes]
    print(
        f"{len(outcomes) - len(failed)} of {len(outcomes)} succeed; place error median "
        f"{np.median(place):.2f} mm, largest {max(place):.2f} mm; largest slip {max(slip):.2f} mm, "
        f"tracking error {max(track):.2f} mm, share of a limit {max(shares):.3f}"
    )
    return len(failed)


if __name__ == "__main__":
    raise SystemExit(min(main(), 1))
