"""Time of a step by its parts, and of another arm for comparison."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import HOME_Q
from ...controller.sensors import SensorErrors, Sensors
from ...fmus.master.master import Master
from ...fmus.master.system import System, open_system
from ..definition.mismatch import Mismatch
from ..pictures.meshes import find_menagerie
from .bench_loops import MEASURED, Workload

Array = NDArray[np.float64]
MICRO = 1e6  # [us/s]


def master_parts(workload: Workload, system: System) -> dict[str, float]:
    """Measure each call of a step of the master over the FMUs.

    Args:
        workload: The scenario to step.
        system: The FMUs.

    Returns:
        Medians by part, clock readings left out [us].
    """
    steps = workload.steps
    with open_system(system, workload.values, stop=steps * STEP_SIZE) as opened:
        slaves = {name: TimedSlave(slave, steps) for name, slave in opened.slaves.items()}
        master = Master(
            list(slaves.values()),
            system.outputs,
            system.connections,
            system.external,
            STEP_SIZE,
            late_check=system.refuses_non_finite,
        )
        master.run(steps, workload.commands, lambda _rows: None)
    inside, outside = _cost_of_timing()
    labels = {"put": "inputs set", "step": "step", "get": "outputs read"}
    taken = {
        f"{name}: {label}": slave.taken[kind][-steps:] - inside  # a first read comes before
        for name, slave in slaves.items()
        for kind, label in labels.items()
    }
    leader = next(iter(slaves.values()))
    calls = np.sum(list(taken.values()), axis=0) + len(taken) * (inside + outside)
    taken["master: loop, check and recording"] = np.diff(leader.put_at) - calls[:-1]
    return {part: float(np.median(t)) * MICRO for part, t in taken.items()}


def object_parts(workload: Workload) -> dict[str, float]:
    """Measure the objects' own part of a step, in a plain loop.

    Args:
        workload: The scenario to step.

    Returns:
        Medians by part [us].
    """
    plant, controller, now = workload.plant(), workload.controller(), clock.perf_counter
    inputs, outputs = controller.inputs, plant.outputs
    pairs = [(inputs[n], outputs[n][: len(inputs[n])]) for n in MEASURED]
    commands = controller.input_values[: workload.commands.shape[1]]
    taken = np.zeros((workload.steps, 2))
    for k in range(workload.steps):
        commands[:] = workload.commands[k]
        for target, source in pairs:
            target[:] = source
        start = now()
        controller.update()
        middle = now()
        plant.inputs["ctrl"] = controller.outputs["ctrl"]
        before = now()
        plant.step()
        taken[k] = middle - start, now() - before
    update, step = np.median(taken, axis=0)  # a reading of the clock adds 0.1 us
    return {"Controller.update": update * MICRO, "Plant.step": step * MICRO}


SENSORS: Final = {
    "exact": Mismatch(dropout=0.0),
    "hand pose by the model": Mismatch(hand_pose_source="model"),
    "calibrated": Mismatch(preset="calibrated"),
}
"""Errors for which the sensors are measured, by what the table calls them."""


def sensor_parts(ticks: int = 2000) -> dict[str, float]:
    """Measure what a reading of the sensors costs, which few scenarios have.

    Args:
        ticks: How many readings are measured.

    Returns:
        Medians by errors [us].
    """
    return {
        f"Sensors.update, {name}": float(np.median(_readings(errors, ticks))) * MICRO
        for name, errors in SENSORS.items()
    }


def _readings(mismatch: Mismatch, ticks: int) -> Array:
    """Time that each reading takes (ticks,) [s]."""
    errors = mismatch.start_values()["sensors"]
    sensors = Sensors(
        SensorErrors(**errors | {"delay": round(errors.get("delay", 0.0) / STEP_SIZE)})
    )
    sensors.truth["qpos"] = HOME_Q
    taken, now = np.zeros(ticks), clock.perf_counter
    for tick in range(ticks):
        start = now()
        sensors.update()
        taken[tick] = now() - start
    return taken


def _cost_of_timing(calls: int = 2000) -> tuple[float, float]:
    """Overhead of timing a call: inside the measured time, and around it [s]."""
    idle = TimedSlave(_Idle(), calls)
    for _ in range(calls):
        idle.step(0.0, 0.0)
    plain = clock.perf_counter()
    for _ in range(calls):
        idle.step(0.0, 0.0)
    around = (clock.perf_counter() - plain) / calls
    inside = float(np.median(idle.taken["step"]))
    return inside, around - inside


class _Idle:
    """A slave that does nothing."""

    name = "idle"

    def step(self, _time: float, _step_size: float) -> None:
        """Do nothing."""


class TimedSlave:
    """A slave that measures what each of its calls takes.

    Args:
        slave: What is called.
        steps: Number of steps that there will be.

    Attributes:
        taken: Times by kind [s]: put and step (steps,), get (steps + 1,).
        put_at: When each put began (steps,) [s].
    """

    def __init__(self, slave: Any, steps: int) -> None:
        self.name: str = slave.name
        self.taken = {"put": np.zeros(steps), "step": np.zeros(steps), "get": np.zeros(steps + 1)}
        self.put_at = np.zeros(steps)
        self._slave = slave
        self._step = self._timed("step", slave.step)

    def bind_get(self, names: Any, block: Array) -> Callable[[int], None]:
        """Make a function that reads, see `fmus.master.wiring.Slave`."""
        return self._timed("get", self._slave.bind_get(names, block))

    def bind_set(self, names: Any, block: Array) -> Callable[[int], None]:
        """Make a function that writes, see `fmus.master.wiring.Slave`."""
        return self._timed("put", self._slave.bind_set(names, block))

    def step(self, time: float, step_size: float) -> None:
        """Advance."""
        self._step(time, step_size)

    def _timed(self, kind: str, call: Callable[..., None]) -> Callable[..., None]:
        taken, now = self.taken[kind], clock.perf_counter
        starts = self.put_at if kind == "put" else np.zeros_like(taken)
        count = 0

        def timed(*arguments: Any) -> None:
            nonlocal count
            start = now()
            call(*arguments)
            taken[count] = now() - start
            starts[count] = start
            count = (count + 1) % len(taken)

        return timed


def menagerie_model(like: Any) -> Any | None:
    """Menagerie's own arm with its meshes before the same table, block and options.

    Args:
        like: The project's model of the scene.

    Returns:
        The model; None if Menagerie is not at hand.
    """
    folder = find_menagerie()
    if folder is None:
        return None
    spec = mujoco.MjSpec.from_file(str(folder / "panda.xml"))
    for key in list(spec.keys):
        spec.delete(key)  # it lacks the block's positions
    for name in ("floor", "table", "obj_geom"):
        geom = like.geom(name)
        body = like.body(int(geom.bodyid[0]))
        parent = spec.worldbody if body.id == 0 else spec.worldbody.add_body(pos=body.pos)
        parent.add_geom(
            type=int(geom.type[0]),
            size=geom.size,
            pos=geom.pos,
            condim=int(geom.condim[0]),
            priority=int(geom.priority[0]),
            friction=geom.friction,
            solref=geom.solref,
            solimp=geom.solimp,
            mass=float(body.mass[0]) if name == "obj_geom" else 0.0,
        )
        if name == "obj_geom":
            parent.add_freejoint()
    model = spec.compile()
    gripper = model.actuator("actuator8").id  # Menagerie's own is too weak to carry the block
    for name in ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"):
        getattr(model, name)[gripper] = getattr(like, name)[like.actuator("actuator8").id]
    for name in ("timestep", "integrator", "cone", "impratio", "disableflags"):
        setattr(model.opt, name, getattr(like.opt, name))
    return model
