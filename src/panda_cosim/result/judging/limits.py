"""The robot's limits: how much of each a run uses, and which one bound it first."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from itertools import repeat
from typing import Final

import numpy as np

from ...assets import STEP_SIZE
from ...assets.fields import Array
from ...assets.franka import ROBOTS
from ...assets.limits import RobotLimits
from ...task.limits import LIMITS, LIMITS_OF, robot_of
from ..recording import Recording, by_rows
from .holds import HAND
from .summary import Metrics

Elements = Callable[[Recording], Iterable[Array]]  # each (n,), so that a long run takes little

FORCE: Final = "plant.actuator_force"  # of the servos [N.m, N]
REFERENCE, Q_REFERENCE = "controller.qvel_ref", "controller.qpos_ref"
SATURATED: Final = 1.0 - 1e-9  # share of its torque from which a servo has none left
# Values 1 to 6 of `controller.limit`.
KINDS: Final = ("position", "velocity", "acceleration", "jerk", "torque", "torque rate")
_Q, _QD, _F = "plant.qpos[16]", "plant.qvel[9]", f"{FORCE}[7]"
_REF, _Q_REF = f"{REFERENCE}[7]", f"{Q_REFERENCE}[7]"


def limit_shares(recording: Recording) -> Metrics:
    """Largest use of each robot limit, per joint or finger, 1 at the limit."""
    # Positions, speeds and torques are the plant's. Metrics named `reference_` are those of the
    # controller's joint reference: acceleration and jerk are finite differences between its
    # updates. The torque rate is that of the servos' torques, without their switching on.
    shares: Metrics = {}
    missing = {}
    controller = recording.metadata.get("parameters", {}).get("controller", {})
    for key in _USES:
        if key.startswith("reference_") and controller.get("impedance"):
            missing[key] = "the impedance law has no joint reference"
        elif reason := lacking(key, recording):
            missing[key] = reason
        elif not len(recording.time):
            missing[key] = "no row is recorded"
        else:
            shares[key] = [float(np.abs(used).max()) for used in shares_over_time(recording, key)]
    return shares | {"not_measured": missing}


def lacking(key: str, recorded: Container[str]) -> str:
    """Return which signal the use of a limit lacks, or ""."""
    # The hand tells our arm from another plant, whose joints these limits are not of.
    needed = (*_USES[key][1], *((HAND,) if not key.startswith("reference_") else ()))
    missing = [each.partition("[")[0] for each in needed if each not in recorded]
    return f"{missing[0]} is not recorded" if missing else ""


def all_lacking(recorded: Container[str]) -> str:
    """Return a signal without which no use of a limit is known, or ""."""
    reasons = [lacking(key, recorded) for key in _USES]
    return reasons[0] if all(reasons) else ""


def shares_over_time(recording: Recording, metric: str) -> Iterator[Array]:
    """Yield the use of a limit at each row (n,), joint by joint, 1 and -1 at the limit."""
    *_, quantity, used = _USES[metric]
    bounds = LIMITS_OF[robot_of(recording.metadata)][quantity].bound if quantity else repeat(1.0)
    return map(np.divide, used(recording), bounds)


def _robot(recording: Recording) -> RobotLimits:
    return ROBOTS[robot_of(recording.metadata)]


def _positions(recording: Recording) -> Iterable[Array]:
    """Yield how far each joint is from the middle of its range."""
    low, high = _robot(recording).q_min, _robot(recording).q_max
    centre = (high + low) / 2
    away = map(np.subtract, _of("plant.qpos")(recording), centre)
    return map(np.divide, away, high - centre)


def _velocities(velocity: str, position: str) -> Elements:
    """Return the shares of the velocity limits at positions."""

    def shares(recording: Recording) -> Iterable[Array]:
        robot = _robot(recording)
        if not robot.approach:
            return map(np.divide, _of(velocity)(recording), robot.velocity)

        def used(q: Array, qd: Array) -> Array:
            return qd[:, :7] / robot.speed(q[:, :7], qd[:, :7])

        return by_rows(recording, used, position, velocity).T

    return shares


def _of(signal: str, first: int = 1, count: int = 7) -> Elements:
    return lambda recording: (recording[f"{signal}[{first + i}]"] for i in range(count))


def _torque_rates(recording: Recording) -> Iterator[Array]:
    """Yield the rates of the servos' torques [N.m/s]; 0 while the servos are switched on."""
    # They are in row `on`, when a torque first differs from 0, and take up what they hold in that
    # tick and the next.
    has_torque = by_rows(recording, lambda torque: torque[:, :7].any(axis=1), FORCE)
    on = int(np.append(has_torque, True).argmax())
    for torque in _of(FORCE)(recording):
        rates = np.zeros_like(torque)
        rates[on + 2 :] = np.diff(torque[on + 1 :]) / STEP_SIZE
        yield rates


def _reference_rates(order: int) -> Elements:
    """Return acceleration (1) or jerk (2) of the reference, held between updates."""

    def rates(recording: Recording) -> Iterator[Array]:
        metadata, rows = recording.metadata, np.arange(recording.rows)
        period = metadata.get("parameters", {}).get("controller", {}).get("period", STEP_SIZE)
        ticks = max(round(period / STEP_SIZE), 1)
        late = int(metadata.get("coupling") == "jacobi" and len(rows) > 1)  # [ticks] of the first
        for velocity in _of(REFERENCE)(recording):
            rate = velocity[late::ticks]  # 0 before there are enough updates
            zeros = np.zeros(min(order, len(rate)))
            for _ in range(order):
                rate = np.diff(rate) / period
            yield np.append(zeros, rate)[np.maximum(rows - late, 0) // ticks]

    return rates


# By its key in summary.json, where 1 is at the limit: its name, the signals that it needs, the
# limit, unless it depends on the position, and its use.
_USES: Final[Mapping[str, tuple[str, tuple[str, ...], str, Elements]]] = {
    "position_share": ("joint position", (_Q,), "", _positions),
    "velocity_share": ("joint velocity", (_QD, _Q), "", _velocities("plant.qvel", "plant.qpos")),
    "torque_share": ("joint torque", (_F,), "torque", _of(FORCE)),
    "torque_rate_share": ("torque rate", (_F,), "torque rate", _torque_rates),
    "finger_speed_share": ("finger speed", (_QD,), "finger speed", _of("plant.qvel", 8, 2)),
    "reference_velocity_share": (
        "joint-reference velocity", (_REF, _Q_REF), "", _velocities(REFERENCE, Q_REFERENCE)
    ),
    "reference_acceleration_share": (
        "joint-reference acceleration", (_REF,), "acceleration", _reference_rates(1)
    ),
    "reference_jerk_share": ("joint-reference jerk", (_REF,), "jerk", _reference_rates(2)),
}  # fmt: skip
SHARES: Final = {key: name for key, (name, *_) in _USES.items()}


def largest_share(shares: Metrics) -> float | None:
    """Largest of all `limit_shares`; None if nothing was measured."""
    return max((max(shares[key]) for key in SHARES if key in shares), default=None)


def exceeded(recording: Recording, shares: Metrics) -> Iterator[tuple[str, str, float]]:
    """Yield each kind of exceeded limit, as "torque rate of joint 2", "176%", and when [s]."""
    for key, name in SHARES.items():
        values = shares.get(key, [0.0])
        most = int(np.argmax(values))
        if values[most] > 1.0:
            part = "finger" if key == "finger_speed_share" else "joint"
            share = f"{values[most]:.0%}"
            used = [*shares_over_time(recording, key)][most]
            at = float(recording.time[np.abs(used).argmax()])
            share = "just above 100%" if share == "100%" else share
            yield f"{name} of {part} {most + 1}", share, at


def first_limit(recording: Recording) -> Metrics | None:
    """Return `time_s`, `joint` (from 1) and `kind` of the limit that bound first, or None."""
    plant = recording.metadata.get("parameters", {}).get("plant", {})
    scale = np.array([plant.get(f"torque_limit_scale[{joint}]", 1.0) for joint in range(1, 8)])
    known = (FORCE, "controller.limit") if HAND in recording else ("controller.limit",)
    names = [name for name in known if f"{name}[7]" in recording]
    for time, *signals in recording.in_blocks("time", *names):
        by_name, kinds = dict(zip(names, signals, strict=True)), np.zeros((len(time), 7))
        if FORCE in by_name:
            share = np.abs(by_name[FORCE][:, :7]) / (scale * LIMITS["torque"].bound)
            kinds[share >= SATURATED] = 1 + KINDS.index("torque")
        if "controller.limit" in by_name:
            limit = by_name["controller.limit"]
            kinds = np.where(limit > 0.0, limit, kinds)
        for row in np.flatnonzero(kinds.any(axis=1))[:1]:
            joint = int(np.flatnonzero(kinds[row])[0])
            kind = KINDS[int(kinds[row, joint]) - 1]
            return {"time_s": float(time[row]), "joint": joint + 1, "kind": kind}
    return None
