"""The ways to step plant and controller that `bench` compares, each over the same scenario.

Each is made anew for a pass over the scenario and advances in chunks, so that the ways can take
turns within milliseconds and meet the same load of the machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol

import mujoco
import numpy as np
from fmpy.fmi2 import FMU2Slave
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...fmus.interface.tables import COMMANDS, CONNECTIONS, INTERFACES
from ...fmus.master.fmu_file import Fmu
from ...fmus.master.system import OpenSystem, System, open_system
from ...plant.plant import Plant, PlantParameters
from ...plant.scene import load_scene
from ..definition.scenario import Scenario
from ..running.start import instants, resolve, start_values

Array = NDArray[np.float64]


class Way(Protocol):
    """One way to step."""

    def advance(self, first: int, count: int) -> None:
        """Take `count` steps from tick `first` on."""

    def state(self) -> Array:
        """Positions of arm, fingers and block (16,)."""


class Workload:
    """A scenario as the ways take it.

    Attributes:
        system: The FMUs.
        values: Start values by instance and scalar variable.
        commands: Commands at each instant (steps + 1, 14).
        steps: Number of steps.
        ctrl: What the controller answers at each tick (steps, 8).
    """

    def __init__(self, scenario: Scenario, system: System) -> None:
        self.system, self.values = system, start_values(scenario)
        self.commands = resolve(scenario, self.values).sample(instants(scenario))
        self.steps = scenario.ticks
        self._scene = PlantParameters(scene=scenario.scene)
        rows: list[Array] = []
        with self.opened() as session:
            session.master.run(self.steps, self.commands, lambda block: rows.append(block.copy()))
            columns = [("controller", name) for name in _names("controller", "ctrl")]
            where = [1 + session.master.columns.index(column) for column in columns]
        self.ctrl: Array = np.concatenate(rows)[: self.steps, where]

    @contextmanager
    def opened(self) -> Iterator[OpenSystem]:
        """Open the FMUs for one pass."""
        with open_system(self.system, self.values, stop=self.steps * STEP_SIZE) as session:
            yield session

    def physics(self, *, drawn: bool) -> Physics:
        """Return the bare physics, with or without the shapes that are only drawn."""
        start = Plant(self._scene).data.qpos
        return Physics(load_scene(self._scene, drawn=drawn), start, self.ctrl)


class Physics:
    """(a) Bare `mj_step` with the servo targets of the whole loop.

    Args:
        model: The scene.
        start: Positions at the start (16,).
        ctrl: Servo targets of each tick (steps, 8).
    """

    def __init__(self, model: Any, start: Array, ctrl: Array) -> None:
        self._model, self._data, self._ctrl = model, mujoco.MjData(model), ctrl
        self._data.qpos[:] = start
        self._data.ctrl[:] = ctrl[0]
        mujoco.mj_forward(model, self._data)

    def advance(self, first: int, count: int) -> None:
        """Take `count` steps from tick `first` on."""
        model, data, step, ctrl = self._model, self._data, mujoco.mj_step, self._data.ctrl
        for k in range(first, first + count):
            ctrl[:] = self._ctrl[k]
            step(model, data)

    def state(self) -> Array:
        """Positions of arm, fingers and block (16,)."""
        return np.array(self._data.qpos)


class OwnMaster:
    """(c) This project's master over the FMUs."""

    def __init__(self, workload: Workload, session: OpenSystem) -> None:
        self._commands, self._session = workload.commands, session

    def advance(self, first: int, count: int) -> None:
        """Take `count` steps from tick `first` on."""
        if first == 0:
            self._session.master.begin(lambda _rows: None)
        self._session.master.step(count, self._commands[first : first + count])

    def state(self) -> Array:
        """Positions of arm, fingers and block (16,)."""
        return self._session.slaves["plant"].get_real(_names("plant", "qpos"))


class PlainLoop:
    """(b) A plain loop over FMPy's `FMU2Slave` as its documentation shows it, with lists."""

    def __init__(self, workload: Workload) -> None:
        self._commands = workload.commands.tolist()
        self._slaves: dict[str, Any] = {}
        self._references: dict[str, dict[str, int]] = {}
        for name, path in workload.system.fmus.items():
            fmu = Fmu(path)
            slave = FMU2Slave(
                guid=fmu.guid,
                unzipDirectory=str(fmu.folder),
                modelIdentifier=fmu.description.coSimulation.modelIdentifier,
                instanceName=name,
            )
            slave.instantiate()
            slave.setupExperiment(startTime=0.0)
            _set_start(slave, fmu, workload.values[name])
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            self._slaves[name] = slave
            self._references[name] = {n: v.value_reference for n, v in fmu.variables.items()}
        self.rows: list[list[float]] = []

    def _of(self, instance: str, *variables: str) -> list[int]:
        names = (n for variable in variables for n in _names(instance, variable))
        return [self._references[instance][name] for name in names]

    def advance(self, first: int, count: int) -> None:
        """Take `count` steps from tick `first` on."""
        plant, controller = self._slaves["plant"], self._slaves["controller"]
        commands, servos = self._of("controller", *COMMANDS), self._of("plant", "ctrl")
        outputs, answers = (
            self._of(name, *(v.name for v in INTERFACES[name].of("output")))
            for name in ("plant", "controller")
        )
        wires = [c for c in CONNECTIONS if c.source[0] == "plant"]
        measured = [self._references["controller"][c.target[1]] for c in wires]
        where = [outputs.index(self._references["plant"][c.source[1]]) for c in wires]
        state = plant.getReal(outputs)
        for k in range(first, first + count):
            now = {"currentCommunicationPoint": k * STEP_SIZE, "communicationStepSize": STEP_SIZE}
            controller.setReal(commands, self._commands[k])
            controller.setReal(measured, [state[i] for i in where])
            controller.doStep(**now)
            answer = controller.getReal(answers)
            self.rows.append([k * STEP_SIZE, *self._commands[k], *state, *answer])
            plant.setReal(servos, answer[:8])
            plant.doStep(**now)
            state = plant.getReal(outputs)

    def state(self) -> Array:
        """Positions of arm, fingers and block (16,)."""
        return np.array(self._slaves["plant"].getReal(self._of("plant", "qpos")))

    def close(self) -> None:
        """Free the instances."""
        for slave in self._slaves.values():
            slave.terminate()
            slave.freeInstance()


def _set_start(slave: Any, fmu: Fmu, values: Mapping[str, Any]) -> None:
    """Set start values; FMI 2.0 sets the number of an enumeration's item."""
    for name, value in values.items():
        scalar = fmu.variable(name)
        kind = "Integer" if scalar.variable.kind == "Enumeration" else scalar.variable.kind
        getattr(slave, f"set{kind}")([scalar.value_reference], [scalar.converted(value)])


def _names(instance: str, variable: str) -> list[str]:
    return INTERFACES[instance].variable(variable).names()
