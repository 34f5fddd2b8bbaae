"""What the interface of the real robot would refuse of a run, in libfranka's own error names.

The robot differentiates what it is sent by backward differences at 1 kHz, and stands still before
the first command. A recording is read once, in blocks, so that a long one takes little memory.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Final

import numpy as np

from ...assets import STEP_SIZE, TORQUE_DRIVEN
from ...assets.checks import (
    AT_LIMIT,
    CHECKS,
    Measure,
    Rates,
    arm_measures,
    elbow_measures,
    end_measures,
    hand_measures,
    hand_velocity_measure,
    joint_measures,
    rate_measures,
    start_measure,
    start_place_measure,
    torque_rate_measure,
    touch_measures,
)
from ...assets.fields import Array
from ...assets.franka import JOINT_DAMPING
from ...assets.limits import RobotLimits, robot_limits
from ...controller.model import FINGERTIPS, ArmModel
from ...controller.presets import DEFAULT
from ...controller.touch import ROTOR
from ...task import rotations
from ...task.limits import robot_of
from ..recording import Recording
from .advice import REMEDIES
from .holds import COMMAND, first_collision
from .rows import table_row
from .summary import Metrics

INTERFACES: Final = ("joint", "cartesian", "torque", "arm")
BEFORE: Final = 25  # rows that a row is judged with: 19 lost packets, and differences around
HAND: Final = ("plant.hand_xpos", "plant.hand_xquat")
Q, QD, FORCE = "plant.qpos", "plant.qvel", "plant.actuator_force"
BIAS, JAC = "plant.qfrc_bias", "plant.jac"
MEASURED: Final = (Q, QD, FORCE, BIAS, JAC)
SENSED: Final = "sensors.qpos_measured"
MODE: Final = "controller.controller_mode"  # of FrankaInterface; in others, the robot makes torques
TORQUES: Final = 2.0  # the program commands torques
REGULAR: Final = 1e-12  # [m^2] keeps J J^T regular where the arm is singular


class _Judge:
    """Keeps the largest share of each limit, and the first time that it is reached."""

    def __init__(self, robot: str, recording: Recording, touch: float) -> None:
        self.shares: dict[str, Array] = {}
        self.first: dict[str, Metrics] = {}  # of each check
        self._robot, self._cause = robot, _cause(recording)
        self._touch = touch  # when a joint first collides [s]
        self._metadata = recording.metadata

    def see(self, time: Array, measures: Iterable[Measure]) -> None:
        """Compare values with their bounds in the last rows, whose instants are (n,) [s]."""
        for key, values, bounds, origin in measures:
            rows = slice(len(values) - len(time), None)
            sizes = np.broadcast_to(bounds, values.shape)[rows]
            shares = np.abs(values[rows]) / sizes
            self.shares[key] = np.maximum(self.shares.get(key, 0.0), shares.max(axis=0))
            refused = np.flatnonzero((shares >= AT_LIMIT).any(axis=1))
            if len(refused) and key not in self.first:
                row, k = refused[0], int(shares[refused[0]].argmax())
                value, size = float(values[rows][row, k]), float(sizes[row, k])
                zero = float(np.broadcast_to(origin, values.shape[1:])[k])
                at, check = float(time[row]), CHECKS[key]
                remedy = self._cause if check.remedy == "more_time" else check.remedy
                if at >= self._touch and check.remedy in ("more_time", "smooth"):
                    remedy = "after_touch"
                self.first[key] = {
                    "name": key,
                    **vars(check),
                    "remedy": REMEDIES[remedy].format(robot=self._robot, touch=self._touch),
                    "time_s": at,
                    "row": table_row(self._metadata, at),
                    "joint": k + 1 if values.shape[1] > 1 else None,
                    "value": zero + value,
                    "bound": zero + math.copysign(size, value),
                }


def _received(count: int, rates: Rates) -> Rates:
    """Return the largest rates at each row, if the gap has ended there or up to two rows before.

    While packets are lost, the robot keeps its last acceleration; then it gets the command of its
    time.
    """
    q, v, a, _ = (rate[: -count - 1] for rate in rates)  # of the last packet before
    command, velocity, acceleration, _ = (rate[count + 1 :] for rate in rates)  # with no gap
    v_kept = v + count * STEP_SIZE * a
    q_kept = q + count * STEP_SIZE * (v + 0.5 * (count + 1) * STEP_SIZE * a)
    v_then = (command - q_kept) / STEP_SIZE
    a_then = (v_then - v_kept) / STEP_SIZE
    j_then = (a_then - a) / STEP_SIZE
    # The differences of the two rows after still span the gap.
    a_next = (velocity[1:] - v_then[:-1]) / STEP_SIZE
    j_next = (a_next - a_then[:-1]) / STEP_SIZE
    j_last = (acceleration[2:] - a_next[:-1]) / STEP_SIZE
    return (
        command[2:],
        _largest(v_kept[2:], v_then[2:]),
        _largest(a_then[2:], a_next[1:]),
        _largest(j_then[2:], j_next[1:], j_last),
    )


def _largest(*values: Array) -> Array:
    """Return which of the values is the largest in magnitude, element by element."""
    stack = np.stack(values)
    return np.asarray(np.take_along_axis(stack, np.abs(stack).argmax(axis=0)[None], axis=0)[0])


class _Arm:
    """Torques that are commanded, and those that others exert, as the controller's observer finds.

    The robot adds gravity itself, of the arm without load. External torques are those of `Touch`,
    with its default gain, and the force is the one at the hand that would exert them.
    """

    def __init__(self, recording: Recording, limits: RobotLimits) -> None:
        robot = robot_of(recording.metadata)
        self._limits, self._model, self._damping = limits, ArmModel(robot), JOINT_DAMPING[robot]
        self._rotor = 0.0 if _has_motors(recording) else ROTOR
        gain = DEFAULT.observer_gain * STEP_SIZE
        self._share = gain / (1.0 + gain)
        self._torque, self._external = np.zeros(7), np.zeros(7)  # of the last row

    def measures(self, signals: Mapping[str, Array], count: int) -> Iterator[Measure]:
        """Yield what is measured of the last rows."""
        last = slice(-count - 1, None)
        q, qd, force, bias = (signals[name][last, :7] for name in (Q, QD, FORCE, BIAS))
        read = signals.get(SENSED, signals[Q])[last, :7]  # a tick before the torque
        limits, still = self._limits, np.zeros(7)
        yield from arm_measures(q, qd, force, limits)
        qdd = np.diff(qd, axis=0) / STEP_SIZE
        q, qd, force, bias = q[1:], qd[1:], force[1:], bias[1:]
        commanded, needed = np.empty((2, count, 7))
        for row in range(count):
            commanded[row] = force[row] - self._model.hand(read[row], still).bias
            needed[row] = self._model.inertia_force(q[row], qdd[row])
        needed += bias - (force - self._rotor * qdd - self._damping * qd)
        begins = ~force.any(axis=1)  # before the first step, the servos give nothing
        commanded[begins], needed[begins] = 0.0, 0.0
        rate: Array = np.diff(commanded, axis=0, prepend=self._torque[None]) / STEP_SIZE
        self._torque = commanded[-1]
        mode = signals.get(MODE, np.full(count, TORQUES))
        is_commanded = mode[-count:] == TORQUES
        if is_commanded.any():
            yield torque_rate_measure(np.where(is_commanded[:, None], rate, 0.0), limits)
        external = needed
        for row in range(count):
            self._external += self._share * (needed[row] - self._external)
            external[row] = self._external
        jac = signals[JAC][-count:]
        square = jac @ jac.transpose(0, 2, 1) + REGULAR * np.eye(6)
        at_hand = np.linalg.solve(square, (jac @ external[:, :, None]))[:, :, 0].astype(float)
        yield from touch_measures(
            external, at_hand, limits.collision_torque, limits.collision_force
        )
        twist = (jac @ qd[:, :, None])[:, :, 0]
        lever = _fingertips(signals[HAND[1]][-count:])
        yield hand_velocity_measure(twist[:, :3] + np.cross(twist[:, 3:], lever), limits)


def preflight(recording: Recording, robot: str) -> Metrics:
    """Return what one of `ROBOTS` would refuse, and the largest share of each of its limits [1]."""
    if not recording.rows:
        return {}
    row = first_collision(recording)
    touch = math.inf if row is None else float(recording.time[row])
    new_judge = partial(_Judge, robot, recording, touch)
    limits, judge, reference = robot_limits(robot), new_judge(), _reference(recording)
    lost = [new_judge() for _ in range(1, limits.lost_packets)]  # by the packets lost in a row
    arm = _Arm(recording, limits)
    for time, signals in _windows(recording, reference):
        if not judge.shares:
            judge.see(time[:1], _start_measures(signals, reference, limits))
        if reference in signals:
            rates = _rates(signals[reference][:, :7], 3)
            judge.see(time, joint_measures(rates, limits))
            judge.see(time, elbow_measures([rate[:, 2:3] for rate in rates], limits))
            for count, each in enumerate(lost, 1):
                each.see(time, rate_measures(_received(count, rates), limits))
                if each.first:
                    del lost[count:]
        if signals.keys() >= {*COMMAND}:
            judge.see(time, _hand_measures(signals, limits))
        if signals.keys() >= {*HAND, *MEASURED}:
            judge.see(time, arm.measures(signals, len(time)))
    if reference in signals:
        judge.see(time[-1:], end_measures(rates, limits))
    return _result(robot, _own_interface(recording, reference), judge, lost)


def _windows(recording: Recording, reference: str) -> Iterator[tuple[Array, dict[str, Array]]]:
    """Yield instants block by block, and signals, which begin `BEFORE` rows earlier.

    Before the first row, the robot stands still.
    """
    names = [n for n in (reference, *COMMAND, *HAND, *MEASURED, SENSED, MODE) if n in recording]
    is_late = recording.metadata.get("coupling") == "jacobi" and reference in names
    kept: list[Array] = []
    for time, *block in recording.in_blocks("time", *names):
        before = kept or [np.repeat(signal[:1], BEFORE, axis=0) for signal in block]
        signals = [np.concatenate(pair) for pair in zip(before, block, strict=True)]
        if not kept and is_late:  # the first row has no command yet
            signals[0][: BEFORE + 1] = block[0][:2][-1]
        kept = [signal[-BEFORE:] for signal in signals]
        yield time, dict(zip(names, signals, strict=True))


def _result(robot: str, own: str, judge: _Judge, lost: Sequence[_Judge]) -> Metrics:
    """Return the section of summary.json."""
    late = [min(each.first.values(), key=itemgetter("time_s")) for each in lost if each.first]
    found = [{**each, "share": float(judge.shares[k].max())} for k, each in judge.first.items()]
    findings = sorted(found, key=itemgetter("time_s"))
    refused = [each for each in findings if each["necessary"]]
    counts = {name: _count(name, refused, judge.shares) for name in INTERFACES}
    is_known = None not in (counts[own], counts["arm"])
    told = [each for each in refused if is_known and each["interface"] in (own, "arm")]
    return {
        "robot": robot,
        "interface": own,
        "refusals": len(told) if is_known else None,
        "first_s": told[0]["time_s"] if told else None,
        **{f"{name}_refusals": count for name, count in counts.items()},
        "lost_packets": len(lost) - len(late) if "joint_jerk" in judge.shares else None,
        **{f"{key}_share": judge.shares.get(key, np.empty(0)).tolist() or None for key in CHECKS},
        "findings": findings,
        "late": {"lost_packets": late[0] | {"remedy": REMEDIES["smoother"]}} if late else {},
    }


def _count(interface: str, refused: Iterable[Metrics], measured: Container[str]) -> int | None:
    """Count what is refused over an interface; None: a condition of it was not measured."""
    if any(key not in measured for key, check in CHECKS.items() if check.interface == interface):
        return None
    return [each["interface"] for each in refused].count(interface)


def _reference(recording: Recording) -> str:
    """Return the signal that a joint motion generator would be sent; "": torques are commanded."""
    if _has_motors(recording):
        return ""
    angles = "controller.qpos_ref" not in recording and "controller.ctrl[8]" in recording
    follows = _gains(recording).get("use_reference", not angles)
    return "controller.qpos_ref" if follows else "controller.ctrl"


def _own_interface(recording: Recording, reference: str) -> str:
    """Return what a run is judged by: "arm" alone, if a program commanded motions of its own.

    FrankaInterface has judged these as they came.
    """
    if reference:
        return "joint"
    is_of_program = MODE in recording and TORQUES not in recording[MODE]
    return "arm" if is_of_program else "torque"


def _has_motors(recording: Recording) -> bool:
    """Whether torques are commanded, by the impedance law or by a law of its own."""
    scene, unit = recording.metadata.get("scene"), recording.units.get("controller.ctrl[1]")
    return scene == TORQUE_DRIVEN or unit == "N.m" or bool(_gains(recording).get("impedance"))


def _gains(recording: Recording) -> Metrics:
    return dict(recording.metadata.get("parameters", {}).get("controller", {}))


def _cause(recording: Recording) -> str:
    """Return which remedy helps if joints are too fast."""
    if _gains(recording).get("period", STEP_SIZE) > STEP_SIZE:
        return "period"
    return "no_reference" if _reference(recording) == "controller.ctrl" else "more_time"


def _rates(values: Array, count: int) -> list[Array]:
    """Return values (n, k) and so many of their derivatives, by backward differences."""
    rates = [values]
    for _ in range(count):
        rates.append(np.diff(rates[-1], axis=0, prepend=rates[-1][:1]) / STEP_SIZE)
    return rates


def _hand_measures(signals: Mapping[str, Array], limits: RobotLimits) -> Iterator[Measure]:
    """Yield what the commanded pose asks of the end effector, between the fingertips."""
    position, orientation = (signals[name] for name in COMMAND)
    turns = rotations.multiply(orientation[1:], rotations.conjugate(orientation[:-1]))
    turning = np.concatenate((np.zeros((1, 3)), rotations.log(turns))) / STEP_SIZE
    moving = _rates(position + _fingertips(orientation), 3)[1:]
    yield from hand_measures(moving, _rates(turning, 2), limits)


def _start_measures(
    signals: Mapping[str, Array], reference: str, limits: RobotLimits
) -> Iterator[Measure]:
    """Yield how far the first command is from where the robot stands, per tick at full speed."""
    measured = signals.get(SENSED, signals.get(Q))
    if reference in signals and measured is not None:
        yield start_measure(signals[reference][:1, :7] - measured[:1, :7], limits)
    if signals.keys() >= {*COMMAND, *HAND}:
        poses = ((signals[pose[0]][:1], signals[pose[1]][:1]) for pose in (COMMAND, HAND))
        command, hand = (position + _fingertips(turn) for position, turn in poses)
        yield start_place_measure(command - hand, limits)


def _fingertips(orientation: Array) -> Array:
    """Return where the fingertips' centre is from the hand's origin (n, 3) [m], world axes."""
    return rotations.rotate(orientation, np.broadcast_to(FINGERTIPS, (len(orientation), 3)))
