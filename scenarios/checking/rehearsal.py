"""Simulates a scenario without FMUs, to find collisions, a weak grip and overloaded servos.

Pushes are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import BLOCK_WIDTH
from ...controller.controller import Controller
from ...controller.gains import Gains
from ...controller.sensors import TRUTH, SensorErrors, Sensors
from ...fmus.interface.controller import CONTROLLER
from ...fmus.interface.parameters import grouped
from ...fmus.interface.plant import PLANT
from ...fmus.interface.sensors import MEASURED, SENSORS
from ...fmus.interface.tables import INTERFACES
from ...plant.plant import DivergenceError, Plant, PlantParameters
from ..definition.limits import LIMITS, saturated, shares
from ..definition.rates import torque_rates
from ..definition.scenario import Scenario
from ..definition.trajectory import COMMANDS
from ..judging.contacts import Touch, find_touches, scene_model
from ..recording import Column, MemoryRecorder, Recording
from ..running.start import StartValues, instants, resolve, start_values
from .placing import Release

GRAVITY: Final = 9.81  # [m/s^2]
SLIDING: Final = 0.05  # [m/s] of a held block on table or floor, above which it is no setting down
HELD: Final = 0.5  # [N] of both fingers on the block
AWAY: Final = 0.001  # [m] of the hand from where it let go
CARRIED: Final = 0.005  # [m] above its start, from which the block hangs in the fingers
SMOOTHING: Final = 50  # [ticks] over which forces and the hand's acceleration are averaged


@dataclass(frozen=True)
class Hold:
    """Where the grip is weakest while the block is carried.

    Attributes:
        time: When [s].
        force: What the fingers can hold by friction [N].
        needed: What the block's weight and acceleration take [N].
    """

    time: float
    force: float
    needed: float


@dataclass(frozen=True)
class Strain:
    """What a servo was asked for.

    Attributes:
        time: When [s].
        joint: Its number, from 1.
        value: Its torque [N.m], or the torque's rate [N.m/s].
    """

    time: float
    joint: int
    value: float


@dataclass(frozen=True)
class Rehearsal:
    """The results.

    Attributes:
        touches: Contacts that nobody wants, in the order of time.
        dragged: When the fingers first drag the block along what it stands on [s]; None: never.
        hold: The weakest moment of the grip; None: nothing was carried.
        dropped: When the block left fingers that were not told to open [s]; None: never.
        releases: When the fingers were told to open, and where the block was.
        lift: Largest height of the block above its start [m].
        failure: Why the physics broke off; "" if it did not.
        saturated: The first servo that gave all the torque it has; None: none did.
        rate: The largest torque rate above the robot's limit; None: it was kept.
        recording: What a run would record of plant and controller.
    """

    touches: tuple[Touch, ...]
    dragged: float | None
    hold: Hold | None
    dropped: float | None
    releases: tuple[Release, ...]
    lift: float
    failure: str
    saturated: Strain | None
    rate: Strain | None
    recording: Recording


class _Stage:
    """Plant, controller and, if the scenario has them, sensors, wired to each other."""

    def __init__(self, scenario: Scenario) -> None:
        values = start_values(scenario)
        self.parameters = PlantParameters(**grouped(PLANT, values["plant"]))
        self.plant = Plant(self.parameters)
        gains = grouped(CONTROLLER, values["controller"])
        period = gains.pop("period")
        self.controller = Controller(Gains(**gains), period)
        self._sensors = _sensors(values, self.plant) if "sensors" in values else None
        self._period_ticks = round(period / STEP_SIZE)
        self._delayed = scenario.coupling == "jacobi"
        self.commands = resolve(scenario, values).sample(instants(scenario))

    def play(self) -> Iterator[int]:
        """Step tick by tick; yield their numbers."""
        plant, controller = self.plant, self.controller
        for tick, command in enumerate(self.commands):
            if tick:
                plant.step()
            if self._delayed:
                plant.inputs["ctrl"] = controller.outputs["ctrl"]
            else:
                self._measure()
            if tick % self._period_ticks == 0:
                self._update(command)
            if self._delayed:
                self._measure()  # for the next tick
            else:
                plant.inputs["ctrl"] = controller.outputs["ctrl"]
            yield tick

    def _measure(self) -> None:
        if self._sensors:
            _tell(self._sensors, self.plant)
            self._sensors.update()

    def _update(self, command: NDArray[np.float64]) -> None:
        self.controller.input_values[: len(COMMANDS)] = command
        measured = self._sensors.readings if self._sensors else self.plant.outputs
        for name in MEASURED:
            self.controller.inputs[name] = _of_arm(measured, name)
        self.controller.update()


def _of_arm(measured: NDArray[np.void], name: str) -> NDArray[np.float64]:
    """Return a signal of the plant or of the sensors, without fingers and block."""
    signal: NDArray[np.float64] = measured[name]
    return signal[:7] if name in ("qpos", "qvel") else signal


def _sensors(values: StartValues, plant: Plant) -> Sensors:
    errors: Any = grouped(SENSORS, values["sensors"])
    sensors = Sensors(SensorErrors(**errors | {"delay": round(errors["delay"] / STEP_SIZE)}))
    _tell(sensors, plant)
    sensors.model_start()
    return sensors


def _tell(sensors: Sensors, plant: Plant) -> None:
    """Set the sensors' inputs to the plant's outputs."""
    for name in TRUTH.names or ():
        sensors.truth[name] = _of_arm(plant.outputs, name).reshape(TRUTH[name].shape)


def rehearse(scenario: Scenario) -> Rehearsal:
    """Run a scenario without FMUs and look at what touches, and at the grip.

    Raises:
        InputError: A parameter is unknown or out of its bounds.
    """
    stage = _Stage(scenario)
    log, answers, failure = [], [], ""
    try:
        for _ in stage.play():
            log.append(stage.plant.outputs.copy())
            answers.append(stage.controller.outputs.copy())
    except DivergenceError as error:
        failure = str(error)
    out = np.array(log)
    commands = stage.commands[: len(log)]
    scene = stage.parameters.scene
    recording = _recording(scene, commands, plant=out, controller=np.array(answers))
    places, force, torque = out["qpos"][:, 9:12], out["contact_force"], out["actuator_force"][:, :7]
    speed = np.einsum("nij,nj->ni", out["jac"][:, :3], out["qvel"][:, :7])
    told = stage.commands[: len(force), 13] < BLOCK_WIDTH
    height = places[:, 2]
    hung = told & (height > height[0] + CARRIED)
    mean = _average(force)
    hold = _weakest(stage.parameters, mean, _average(speed), hung & (mean > HELD))
    lost = np.flatnonzero(hung[1:] & (mean[1:] <= HELD) & (mean[:-1] > HELD))
    dropped = float(lost[0] * STEP_SIZE) if len(lost) else None
    opened = np.flatnonzero(told[:-1] & ~told[1:] & (mean[:-1] > HELD)) + 1
    releases = tuple(
        Release(
            float(tick * STEP_SIZE), tuple(places[tick]), _pressing(tick, stage.commands, force)
        )
        for tick in opened.tolist()
    )
    lift = float(height.max() - height[0])
    strains = _first_saturated(torque, stage.parameters), _largest_rate(torque)
    return Rehearsal(
        _touches(stage.parameters.scene, out), _dragged(out), hold, dropped, releases, lift,
        failure, *strains, recording,
    )  # fmt: skip


def _recording(scene: str, commands: NDArray[np.float64], **logs: NDArray[np.void]) -> Recording:
    """Return what a run would record of plant and controller, without Jacobian and mass matrix."""
    columns = [Column("time", "s"), *(Column(f"controller.{name}") for name in COMMANDS)]
    time = STEP_SIZE * np.arange(len(commands), dtype=np.float64)
    values = [time, commands]
    for instance, log in logs.items():
        for variable in INTERFACES[instance].of("output"):
            if len(variable.shape) < 2:
                columns += [Column(f"{instance}.{s.name}", s.unit) for s in variable.scalars(0)]
                values.append(log[variable.name].reshape(len(log), -1))
    recorder = MemoryRecorder(Path(), columns, {"scene": scene})
    recorder.append(np.column_stack(values))
    recorder.close(complete=True)
    return recorder.recording()


def _touches(scene: str, out: NDArray[np.void]) -> tuple[Touch, ...]:
    force = out["unwanted_contact_force"]
    if not force.any():
        return ()
    time: NDArray[np.float64] = STEP_SIZE * np.arange(len(out), dtype=float)
    return find_touches(scene_model(scene), out["qpos"], force, time)


def _dragged(out: NDArray[np.void]) -> float | None:
    sliding = np.linalg.norm(out["qvel"][:, 9:11], axis=1) > SLIDING
    ticks = np.flatnonzero(sliding & (out["contact_force"] > HELD) & (out["support_force"] > 0.0))
    return float(ticks[0] * STEP_SIZE) if len(ticks) else None


def _pressing(tick: int, commands: NDArray[np.float64], force: NDArray[np.float64]) -> float:
    """Force of each finger when the hand has moved on after a release [N]; 0: it stays."""
    away = np.linalg.norm(commands[tick : len(force), :3] - commands[tick, :3], axis=1)
    moved = np.flatnonzero(away > AWAY)
    return 0.5 * float(force[tick + int(moved[0])]) if len(moved) else 0.0


def _first_saturated(torque: NDArray[np.float64], parameters: PlantParameters) -> Strain | None:
    full = saturated(torque, np.array(parameters.torque_limit_scale))
    ticks = np.flatnonzero(full.any(axis=1))
    if not len(ticks):
        return None
    joint = int(full[ticks[0]].argmax())
    return Strain(float(ticks[0] * STEP_SIZE), joint + 1, float(abs(torque[ticks[0], joint])))


def _largest_rate(torque: NDArray[np.float64]) -> Strain | None:
    share = np.abs(shares("torque rate", torque_rates(torque)))
    tick, joint = np.unravel_index(share.argmax(), share.shape)
    if share[tick, joint] <= 1.0:
        return None
    value = float(share[tick, joint] * LIMITS["torque rate"].bound[joint])
    return Strain(float(tick * STEP_SIZE), int(joint) + 1, value)


def _average(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Average values (n, ...) over the last `SMOOTHING` ticks, up to each."""
    padded = np.pad(values, [(SMOOTHING, 0), *[(0, 0)] * (values.ndim - 1)], mode="edge")
    total = padded.cumsum(axis=0)
    mean: NDArray[np.float64] = (total[SMOOTHING:] - total[:-SMOOTHING]) / SMOOTHING
    return mean


def _weakest(
    parameters: PlantParameters,
    force: NDArray[np.float64],
    velocity: NDArray[np.float64],
    carried: NDArray[np.bool_],
) -> Hold | None:
    """Compare friction with weight and acceleration while the block is carried."""
    if not carried.any():
        return None
    acceleration = np.diff(velocity, axis=0, prepend=velocity[:1]) / STEP_SIZE
    acceleration[:, 2] += GRAVITY
    needed = parameters.block_mass * np.linalg.norm(acceleration, axis=1)
    held = parameters.block_friction * force
    at = np.flatnonzero(carried)[(held[carried] / needed[carried]).argmin()]
    return Hold(float(at * STEP_SIZE), float(held[at]), float(needed[at]))


__all__ = ["Hold", "Rehearsal", "Strain", "rehearse"]
