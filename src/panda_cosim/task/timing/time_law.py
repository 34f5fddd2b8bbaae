"""The time-optimal law of a motion along its path, with bounded jerk.

Where the joint path has kinks, as where the controller's damping sets in near singularities, the
joints' acceleration jumps from one tick to the next. A longer window does not help there, as it
does elsewhere: only a lower speed at that place does, see `lowered`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Final

import numpy as np

from ...assets import STEP_SIZE, franka
from ...assets.fields import Array
from ...fmus.extras import needing
from .demand import WAY_TOLERANCE, ArmDynamics, Shares
from .path import Motion

NODES: Final = 80  # of the joint path, between which it is interpolated
GRID: Final = 300  # intervals of the time law
BOUNDED: Final = (
    "velocity", "acceleration", "torque", "hand speed", "hand acceleration", "hand turn",
)  # fmt: skip
FIRST_WINDOW: Final = 0.04  # [s]
MOST: Final = 1.4  # largest bound, as a multiple of the wanted share
TINY: Final = 1e-9
FREE: Final = 1e6  # a bound that never binds
SPIKE: Final = 9  # [ticks] up to half as many are a spike
SPIKY: Final = 2.0  # times as high as without spikes
NEAR: Final = 40  # [ticks] around a spike; the law is averaged over about as many
SLACK: Final = 0.95  # of the speed that is allowed, so that few rounds suffice
CRAWL: Final = 2e-4  # [m/s] no slower
LAG_ORDER: Final = 0.7  # the hand's lag falls more slowly than its speed
# Directions in which the hand's acceleration is bounded: faces, edges and corners of a cube.
_CUBE = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
DIRECTIONS: Final = _CUBE / np.linalg.norm(_CUBE, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Bounds:
    """Share of each limit that a time law may use [1], and the window it is averaged over.

    Averaging bounds jerk and torque rate, which toppra does not limit. It also lowers peaks of the
    acceleration, so that shares above the wanted one can be right here.
    """

    shares: Shares  # by the names in `BOUNDED`
    window: float = FIRST_WINDOW  # [s]
    # Largest speed at each grid point of the path (`GRID` + 1,) [m/s].
    ceiling: Array = field(default_factory=lambda: np.full(GRID + 1, FREE))

    def corrected(self, measured: Shares, share: float) -> Bounds:
        """Return bounds that bring the measured shares closer to the wanted one."""
        used = {name: max(value, TINY) for name, value in measured.items()}
        rates = max(used.pop("jerk"), used.pop("torque rate"))
        shares = {
            name: min(self.shares[name] * _step(share / value), MOST * share)
            for name, value in used.items()
        }
        return replace(self, shares=shares, window=self.window * _step(rates / share))


def _step(ratio: float) -> float:
    """Damp a correction, so that the rounds converge."""
    return math.sqrt(min(max(ratio, 0.7), 1.4))


class NoTimingError(Exception):
    """No time law keeps the limits along a path."""


def time_law(motion: Motion, joints: Array, bounds: Bounds, dynamics: ArmDynamics) -> Array:
    """Return the place on the path at each tick, from rest to rest (m,) [m].

    The joint positions (n, 7) [rad] are those at `NODES` evenly spaced points of the path.
    """
    places, speeds = _parametrized(motion, joints, bounds, dynamics)
    between = 2.0 * np.diff(places) / (speeds[1:] + speeds[:-1])
    times = np.concatenate(([0.0], np.cumsum(between)))
    return _averaged(_sampled(times, places, speeds), bounds.window)


def _sampled(times: Array, places: Array, speeds: Array) -> Array:
    """Return the place at each tick, with constant acceleration between grid points."""
    t = np.append(np.arange(0.0, times[-1], STEP_SIZE), times[-1])
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    rate = np.diff(speeds)[k] / np.diff(times)[k]
    since = t - times[k]
    return np.asarray(places[k] + since * (speeds[k] + 0.5 * rate * since))


def _averaged(law: Array, window: float) -> Array:
    """Average a law over a window and over a third of it, so that the acceleration has no steps."""
    for length in (window, window / 3.0):
        ticks = max(round(length / STEP_SIZE), 1)
        padded = np.concatenate((np.zeros(ticks), law, np.full(ticks, law[-1])))
        law = np.convolve(padded, np.full(ticks, 1.0 / ticks), mode="valid")
    law[0], law[-1] = 0.0, padded[-1]
    return law


def _parametrized(
    motion: Motion, joints: Array, bounds: Bounds, dynamics: ArmDynamics
) -> tuple[Array, Array]:
    """Return places (m,) [m] on the path and the speeds there [m/s]."""
    with needing("toppra", "retime", "time-optimal timing"):
        from toppra import SplineInterpolator, algorithm  # noqa: PLC0415 - an extra
    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    nodes = np.linspace(0.0, motion.length, len(joints))
    path = SplineInterpolator(nodes, np.hstack((joints, _hand(motion, nodes))))
    grid = np.linspace(0.0, motion.length, GRID + 1)
    solver = algorithm.TOPPRA(
        _constraints(bounds, grid, dynamics, lambda place: path(place)[:7]),
        path,
        gridpoints=grid,
        parametrizer="ParametrizeSpline",
    )
    _, speeds, _ = solver.compute_parameterization(0.0, 0.0)
    if speeds is None or not np.isfinite(speeds).all():
        raise NoTimingError
    return grid, speeds


def _hand(motion: Motion, places: Array) -> Array:
    """Coordinates besides the joints: position, way, turn and place (m, 6) [m, m, rad, m]."""
    poses = motion.poses(np.linspace(0.0, motion.length, 20 * len(places)))
    steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    cosines = np.abs((poses[1:, 3:] * poses[:-1, 3:]).sum(axis=1))
    turns = 2.0 * np.arccos(np.clip(cosines, 0.0, 1.0))
    fine = np.linspace(0.0, motion.length, len(poses))
    sums = (np.concatenate(([0.0], np.cumsum(part))) for part in (steps, turns))
    along = [np.interp(places, fine, part) for part in sums]
    return np.column_stack((motion.poses(places)[:, :3], *along, places))


def _constraints(
    bounds: Bounds, grid: Array, dynamics: ArmDynamics, joints_at: Callable[[float], Array]
) -> list[Any]:
    """Limits as toppra takes them, over the seven joints and the six of `_hand`."""
    from scipy.linalg import block_diag  # noqa: PLC0415 - slow, and rarely needed
    from toppra import constraint  # noqa: PLC0415 - an extra

    robot, limit = dynamics.robot, bounds.shares
    hand = limit["hand speed"] * robot.translation[0], limit["hand turn"] * robot.rotation[0]

    def speeds_at(place: float) -> Array:
        q, other_way = joints_at(place), -np.ones(7)
        down, up = (limit["velocity"] * robot.speed(q, way) for way in (other_way, -other_way))
        others = np.array([FREE, FREE, FREE, *hand, np.interp(place, grid, bounds.ceiling)])
        return np.column_stack((np.append(-down, -others), np.append(up, others)))

    sides = np.vstack((np.eye(7), -np.eye(7)))
    rows = block_diag(sides, sides, DIRECTIONS)
    joints = limit["acceleration"] * robot.acceleration
    torques = limit["torque"] * franka.TORQUE_MAX
    at_hand = np.full(len(DIRECTIONS), limit["hand acceleration"] * robot.translation[1])
    most = np.concatenate((joints, joints, torques, torques, at_hand))

    def forces(p: Array, rate: Array, change: Array) -> Array:
        """Joint accelerations, torques and the hand's acceleration."""
        torque = dynamics.torque(p[:7], rate[:7], change[:7])
        return np.concatenate((change[:7], torque, change[7:10]))

    bounded = constraint.SecondOrderConstraint(
        forces, lambda _: rows, lambda _: most, dof=13,
        discretization_scheme=constraint.DiscretizationType.Collocation,
    )  # fmt: skip
    return [constraint.JointVelocityConstraintVarying(speeds_at), bounded]


def without_spikes(rates: Array) -> Array:
    """Return the largest of rates (n, joints) at each tick, without what lasts a few ticks only."""
    from scipy.ndimage import median_filter  # noqa: PLC0415 - slow, and rarely needed

    return np.asarray(median_filter(np.abs(rates), size=(SPIKE, 1)).max(axis=1))


def lowered(ceiling: Array, law: Array, rates: Array, miss: Array, aim: float) -> Array:
    """Lower the ceiling of a path's speed (g,) [m/s] where a law (n,) [m] asks too much.

    `rates` are the shares of the limits of jerk and torque rate at each tick (n, joints) [1],
    `miss` the distance of hand and command (n,) [m], and `aim` the share that may be used [1].
    """
    from scipy.ndimage import minimum_filter1d  # noqa: PLC0415 - slow, and rarely needed

    speed = np.gradient(law) / STEP_SIZE
    kink = np.sqrt(np.abs(rates).max(axis=1) / aim)
    lag = (miss / WAY_TOLERANCE) ** (1.0 / LAG_ORDER)
    excess = np.maximum(kink, lag)
    allowed = np.where(excess > 1.0, SLACK * speed / np.maximum(excess, 1.0), np.inf)
    allowed = minimum_filter1d(allowed, 2 * NEAR + 1)
    places = np.linspace(0.0, law[-1], len(ceiling))
    ticks = np.interp(places, law, np.arange(len(law))).round().astype(int)
    return np.asarray(np.minimum(ceiling, np.maximum(allowed[ticks], CRAWL)))
