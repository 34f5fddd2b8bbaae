"""Runs without FMUs and in memory, and many random pick-and-place tasks.

Plant, controller and trajectory in a plain loop give the same numbers as the co-simulation, bit for
bit, and need no FMUs, but ten times as long. `panda-cosim sweep random_box` draws such tasks, too.
"""

from typing import NamedTuple

import numpy as np

from fake_recording import FakeRecording
from fmu_support import in_fork
from panda_cosim.assets import STEP_SIZE
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import Gains
from panda_cosim.fmus.interface.controller import CONTROLLER
from panda_cosim.fmus.interface.parameters import grouped
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.plant import Plant
from panda_cosim.result.judging.summary import Summary
from panda_cosim.run.execution import Execution
from panda_cosim.run.prepare import Prepared, prepare
from panda_cosim.run.start import instants, resolve, start_values
from panda_cosim.run.stopping import StopRequest
from panda_cosim.task.rotations import Array
from panda_cosim.task.scenario import Scenario
from panda_cosim.task.trajectory import COMMANDS

Task = dict[str, float]  # the plant's parameters by key

DRAWN = tuple(f"plant.block_{name}" for name in ("pos[1]", "pos[2]", "yaw", "mass", "friction"))
# Ranges of a random task: offset from the nominal place, yaw, mass, friction.
OFFSET = 0.10  # [m]
YAW = np.pi / 4  # [rad]
MASS = (0.05, 0.5)  # [kg]
FRICTION = (0.5, 1.2)  # [1]
SEED = 4


def run_plain(scenario: Scenario) -> FakeRecording:
    """Run a scenario with plain objects in place of FMUs; its pushes are left out.

    Returns what happened at each tick from t = 0 to the end.
    """
    values = start_values(scenario)
    plant = Plant(PlantParameters(**grouped(PLANT, values["plant"])))
    gains = grouped(CONTROLLER, values["controller"])
    period = gains.pop("period")
    controller = Controller(Gains(**gains), period)
    period_ticks = round(controller.period / STEP_SIZE)
    commands = resolve(scenario, values).sample(instants(scenario))
    parts = {"plant": plant, "controller": controller}
    log = {name: np.empty((len(commands), p.output_values.size)) for name, p in parts.items()}
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
        for name, part in parts.items():
            log[name][tick] = part.output_values
    names, signals = [name.partition("[")[0] for name in COMMANDS], {}
    for name in names:
        at = [column for column, n in enumerate(names) if n == name]
        signals[f"controller.{name}"] = commands[:, at if len(at) > 1 else at[0]]
    for name, part in parts.items():
        dtype = part.outputs.dtype
        signals |= {f"{name}.{n}": log[name].view(dtype)[:, 0][n] for n in dtype.names or ()}
    scalars = [(f"{part}.{s.name}", s) for part, i in INTERFACES.items() for s in i.scalars()]
    metadata = {"coupling": scenario.coupling, "parameters": values}
    run = FakeRecording(instants(scenario), signals, metadata)
    run.units = {name: scalar.unit for name, scalar in scalars if name in run}
    return run


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
