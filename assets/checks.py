"""The conditions of the real robot's interface: the rows of checks.toml, and what they bound.

The robot differentiates what it is sent by backward differences at 1 kHz. Preflight looks for
refusals in recordings; the interface of a real robot's program refuses at once.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from . import ASSETS, STEP_SIZE
from .fields import Array
from .limits import RobotLimits

ARMS: Final = {"fer": "panda", "fr3": "fr3"}  # as the key `robot` of a scenario has them
AT_LIMIT: Final = 1.0 - 1e-9  # share from which a value is refused: it must be below its limit
DERIVATIVES: Final = ("velocity", "acceleration", "jerk")
_TABLES: Final = tomllib.loads((ASSETS / "checks.toml").read_text(encoding="utf-8"))
SIGNALS: Final[Mapping[str, list[str]]] = _TABLES.pop("signals")

Rates = Sequence[Array]  # positions (n, k) and their three derivatives
# Key of `CHECKS`, values (n, k), largest sizes (k,) or (n, k), and what both are counted from (k,).
Measure = tuple[str, Array, Array, Array | float]


@dataclass(frozen=True)
class Check:
    """One condition of the interface; checks.toml says what the fields are."""

    interface: str
    error: str
    what: str
    unit: str
    remedy: str  # name of the advice that helps
    necessary: bool = True
    limit: str = "the limit"


# By the key of their largest share in summary.json.
CHECKS: Final[Mapping[str, Check]] = {key: Check(**entry) for key, entry in _TABLES.items()}


def refusals(measures: Iterable[Measure]) -> list[str]:
    """Return the errors, in libfranka's names, of the measures that reach their bounds."""
    names = [
        CHECKS[key].error
        for key, values, bounds, _ in measures
        if not (np.abs(values) < AT_LIMIT * bounds).all()  # nor are they numbers at all
    ]
    return [*dict.fromkeys(names)]


def start_measure(away: Array, limits: RobotLimits) -> Measure:
    """Return how far a first command is from the joints (1, 7) [rad], per tick at full speed."""
    return "start_pose", away, limits.velocity * STEP_SIZE, 0.0


def start_place_measure(away: Array, limits: RobotLimits) -> Measure:
    """Return the same of the end effector (1, 3) [m]."""
    return "start_place", lengths(away), limits.translation[:1] * STEP_SIZE, 0.0


def rate_measures(rates: Rates, limits: RobotLimits) -> Iterator[Measure]:
    """Yield the three derivatives of the joints' positions."""
    bounds = limits.speed(*rates[:2]), limits.acceleration, limits.jerk
    return _derivatives("joint", rates[1:], bounds)


def _derivatives(what: str, rates: Iterable[Array], bounds: Iterable[Array]) -> Iterator[Measure]:
    for name, rate, bound in zip(DERIVATIVES, rates, bounds, strict=True):
        yield f"{what}_{name}", rate, bound, 0.0


def joint_measures(rates: Rates, limits: RobotLimits) -> Iterator[Measure]:
    """Yield what is commanded of the joints."""
    middle: Array = 0.5 * (limits.q_min + limits.q_max)
    yield "joint_position", rates[0] - middle, limits.q_max - middle, middle
    yield from rate_measures(rates, limits)


def elbow_measures(rates: Rates, limits: RobotLimits) -> Iterator[Measure]:
    """Yield what is commanded of the elbow, of which joint 3 is the angle (n, 1)."""
    middle: Array = 0.5 * (limits.q_min[2:3] + limits.q_max[2:3])
    yield "elbow_position", rates[0] - middle, limits.q_max[2:3] - middle, middle
    yield from _derivatives("elbow", rates[1:], limits.elbow)


def hand_measures(
    moving: Sequence[Array], turning: Sequence[Array], limits: RobotLimits
) -> Iterator[Measure]:
    """Yield the three derivatives of the end effector's position and orientation (n, 3)."""
    yield from _derivatives("translation", map(lengths, moving), limits.translation)
    yield from _derivatives("rotation", map(lengths, turning), limits.rotation)


def end_measures(rates: Rates, limits: RobotLimits) -> Iterator[Measure]:
    """Yield what is left of the motion, of which the robot can stop so much within a tick."""
    yield "end_velocity", rates[1], limits.acceleration * STEP_SIZE, 0.0
    yield "end_acceleration", rates[2], limits.jerk * STEP_SIZE, 0.0


def arm_measures(q: Array, qd: Array, torque: Array, limits: RobotLimits) -> Iterator[Measure]:
    """Yield what is measured of the joints."""
    middle: Array = 0.5 * (limits.q_min + limits.q_max)
    yield "arm_position", q - middle, limits.q_max - middle, middle
    yield "arm_velocity", qd, limits.speed(q, qd), 0.0
    yield "torque", torque, limits.torque, 0.0


def touch_measures(
    external: Array, at_hand: Array, most_torque: Array, most_force: Array
) -> Iterator[Measure]:
    """Yield external torques (n, 7) [N.m], and force and moment at the hand (n, 6) [N, N.m]."""
    yield "external_torque", external, most_torque, 0.0
    yield "external_force", at_hand[:, :3], most_force[:3], 0.0
    yield "external_moment", at_hand[:, 3:], most_force[3:], 0.0


def hand_velocity_measure(velocity: Array, limits: RobotLimits) -> Measure:
    """Return the end effector's speed, of its velocity (n, 3) [m/s]."""
    return "hand_velocity", lengths(velocity), limits.translation[:1], 0.0


def torque_rate_measure(rate: Array, limits: RobotLimits) -> Measure:
    """Return rates of commanded torques (n, 7) [N.m/s]."""
    return "torque_rate", rate, limits.torque_rate, 0.0


def lengths(vectors: Array) -> Array:
    """Return the lengths of vectors (n, 3) as (n, 1)."""
    return np.asarray(np.linalg.norm(vectors, axis=1, keepdims=True))
