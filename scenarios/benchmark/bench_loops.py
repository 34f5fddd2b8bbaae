"""The ways to step plant and controller that `bench` compares, each over the same scenario.

Each is made anew for a pass over the scenario and advances in chunks, so that the ways can take
turns within milliseconds and meet the same load of the machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np
from fmpy.fmi2 import FMU2Slave
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...controller.controller import Controller
from ...controller.gains import preset
from ...fmus.interface.tables import COMMANDS, CONNECTIONS, INTERFACES
from ...fmus.master.system import OpenSystem, System, open_system
from ...plant.plant import Plant, PlantParameters
from ..definition.scenario import Scenario
from ..running.start import StartValues, instants, resolve

Array = NDArray[np.float64]
MEASURED = ("hand_xpos", "hand_xquat", "jac", "qpos", "qvel", "qfrc_bias")


class Way(Protocol):
    """One way to step."""

    def advance(self, first: int, count: int) -> None:
        """Take `count` steps from tick `first` on."""

    def state(self) -> Array:
        """Positions of arm, fingers and block (16,)."""


class Workload:
    """A scenario as the ways take it.

    Attributes:
        values: Start values by instance and scalar variable.
        commands: Commands at each instant (steps + 1, 14).
        steps: Number of steps.
        ctrl: What the controller answers at each tick (steps, 8).
    """

    def __init__(self, scenario: Scenario, values: StartValues) -> None:
        self.scenario, self.values = scenario, values
        self.commands = resolve(scenario, values).sample(instants(scenario))
        self.steps = scenario.ticks
        self.ctrl = np.zeros((self.steps, 8))
        plain = PlainLoop(self)
        plain.advance(0, self.steps)
        self.ctrl[:] = plain.rows[: self.steps, -38:-30]

    def plant(self) -> Plant:
        """Return a new plant."""
        return Plant(PlantParameters(scene=self.scenario.scene))

    def controller(self) -> Controller:
        """Return a new controller."""
        return Controller(preset(self.scenario.gains))


class Physics:
    """(a) Bare `mj_step` with the servo targets of the whole loop.

    Args:
        workload: The scenario to step.
        model: The scene, or another arm before the same table and block.
    """

    def __init__(self, workload: Workload, model: Any) -> None:
        plant = workload.plant()
        self._ctrl = workload.ctrl
        self._model = model
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = plant.data.qpos
        self._data.ctrl[:] = workload.ctrl[0]
        mujoco.mj_forward(self._model, self._data)

    def advance(self, first: int, count: int) -> None:
        """Take `count` steps from tick `first` on."""
        model, data, step, ctrl = self._model, self._data, mujoco.mj_step, self._data.ctrl
        for k in range(first, first + count):
            ctrl[:] = self._ctrl[k]
            step(model, data)

    def state(self) -> Array:
        """Positions of arm, fingers and block (16,)."""
        return np.array(self._data.qpos)


class PlainLoop:
    """(b) The plant's and the controller's objects, called in turn; rows are recorded.

    Attributes:
        rows: What is recorded: time, commands, the plant's outputs, the controller's.
    """

    def __init__(self, workload: Workload) -> None:
        self.plant, self.controller = workload.plant(), workload.controller()
        self._commands = workload.commands
        self._n_commands = workload.commands.shape[1]
        size = self.plant.output_values.size + self.controller.output_values.size
        self.rows = np.zeros((workload.steps + 1, 1 + self._n_commands + size))
        inputs, outputs = self.controller.inputs, self.plant.outputs
        self._pairs = [(inputs[n], outputs[n][: len(inputs[n])]) for n in MEASURED]

    def advance(self, first: int, count: int) -> None:
        """Take `count` steps from tick `first` on."""
        plant, controller, pairs = self.plant, self.controller, self._pairs
        commands = controller.input_values[: self._n_commands]
        asked, given = plant.inputs["ctrl"], controller.outputs["ctrl"]
        measured, answered = plant.output_values, controller.output_values
        split = 1 + self._n_commands + measured.size
        for k in range(first, first + count):
            commands[:] = self._commands[k]
            for target, source in pairs:
                target[:] = source
            controller.update()
            asked[:] = given
            row = self.rows[k]
            row[0] = k * STEP_SIZE
            row[1 : 1 + self._n_commands] = commands
            row[1 + self._n_commands : split] = measured
            row[split:] = answered
            plant.step()

    def state(self) -> Array:
        """Positions of arm, fingers and block (16,)."""
        return np.array(self.plant.outputs["qpos"])


class OwnMaster:
    """(c) This project's master over the FMUs.

    Args:
        workload: The scenario to step.
        opened: The initialized FMUs, fresh.
    """

    def __init__(self, workload: Workload, opened: OpenSystem) -> None:
        self._commands, self._session = workload.commands, opened

    def advance(self, first: int, count: int) -> None:
        """Take `count` steps from tick `first` on."""
        if first == 0:
            self._session.master.begin(_drop)
        self._session.master.step(count, self._commands[first : first + count])

    def state(self) -> Array:
        """Positions of arm, fingers and block (16,)."""
        names = INTERFACES["plant"].variable("qpos").names()
        return np.array(self._session.slaves["plant"].get_real(names))


def _drop(_rows: Array) -> None:
    """A recording's place."""


@contextmanager
def own_master(workload: Workload, system: System) -> Iterator[OwnMaster]:
    """Open the FMUs for one pass."""
    with open_system(system, workload.values, stop=workload.steps * STEP_SIZE) as opened:
        yield OwnMaster(workload, opened)


class ListLoop:
    """(d) A plain loop over FMPy's `FMU2Slave` as its documentation shows it, with lists.

    Args:
        workload: The scenario to step.
        folders: By instance, the unpacked FMU and its description.
    """

    def __init__(self, workload: Workload, folders: Mapping[str, tuple[Path, Any]]) -> None:
        self._slaves: dict[str, Any] = {}
        self._references: dict[str, dict[str, int]] = {}
        for name, (folder, description) in folders.items():
            slave = FMU2Slave(
                guid=description.guid,
                unzipDirectory=str(folder),
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName=name,
            )
            slave.instantiate()
            slave.setupExperiment(startTime=0.0)
            self._slaves[name] = slave
            variables = description.modelVariables
            self._references[name] = {v.name: v.valueReference for v in variables}
            self._set_start(slave, variables, workload.values[name])
            slave.enterInitializationMode()
            slave.exitInitializationMode()
        self._commands = workload.commands.tolist()
        self.rows: list[list[float]] = []

    @staticmethod
    def _set_start(slave: Any, variables: Any, values: Mapping[str, Any]) -> None:
        for variable in variables:
            if variable.name in values:
                kind, value = variable.type, values[variable.name]
                if kind == "Enumeration":  # FMI 2.0 sets the number of the name
                    numbers = {item.name: int(item.value) for item in variable.declaredType.items}
                    kind, value = "Integer", numbers[value]
                getattr(slave, f"set{kind}")([variable.valueReference], [value])

    def advance(self, first: int, count: int) -> None:
        """Take `count` steps from tick `first` on."""
        plant, controller = self._slaves["plant"], self._slaves["controller"]
        of_plant, of_controller = self._references["plant"], self._references["controller"]
        commands = [of_controller[n] for c in COMMANDS for n in _names("controller", c)]
        measured_from = [of_plant[c.source[1]] for c in CONNECTIONS if c.source[0] == "plant"]
        measured_to = [of_controller[c.target[1]] for c in CONNECTIONS if c.source[0] == "plant"]
        outputs = [of_plant[n] for v in INTERFACES["plant"].of("output") for n in v.names()]
        at = {reference: i for i, reference in enumerate(outputs)}
        where = [at[reference] for reference in measured_from]
        answers = [
            of_controller[n] for v in INTERFACES["controller"].of("output") for n in v.names()
        ]
        servos = [of_plant[n] for n in _names("plant", "ctrl")]
        state = plant.getReal(outputs)
        for k in range(first, first + count):
            time = k * STEP_SIZE
            controller.setReal(commands, self._commands[k])
            controller.setReal(measured_to, [state[i] for i in where])
            controller.doStep(currentCommunicationPoint=time, communicationStepSize=STEP_SIZE)
            answer = controller.getReal(answers)
            self.rows.append([time, *self._commands[k], *state, *answer])
            plant.setReal(servos, answer[:8])
            plant.doStep(currentCommunicationPoint=time, communicationStepSize=STEP_SIZE)
            state = plant.getReal(outputs)

    def state(self) -> Array:
        """Positions of arm, fingers and block (16,)."""
        references = [self._references["plant"][n] for n in _names("plant", "qpos")]
        return np.array(self._slaves["plant"].getReal(references))

    def close(self) -> None:
        """Free the instances."""
        for slave in self._slaves.values():
            slave.terminate()
            slave.freeInstance()


def _names(instance: str, variable: str) -> list[str]:
    return INTERFACES[instance].variable(variable).names()
