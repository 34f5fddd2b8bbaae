"""Computes the controller's commands at any time from a table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..assets.fields import Array
from ..fmus.interface import controller
from ..fmus.interface.controller import CONTROLLER
from . import rotations
from .fields import Quantity, Vector, checked
from .table import FRAMES, POSITION, TrajectoryTable

INTERPOLATIONS = ("linear", "quintic", "spline")

# The controller's command inputs, the columns that `Trajectory.sample` returns.
COMMANDS = tuple(n for v in controller.COMMANDS for n in CONTROLLER.variable(v).names())
# The further columns, if the rows have a posture.
POSTURE_COMMANDS = tuple(
    n for v in controller.POSTURE_COMMANDS for n in CONTROLLER.variable(v).names()
)

TIME_TOLERANCE = 1e-9  # s; k * dt reaches a row's time even if rounding makes it a little less

Position = Annotated[tuple[float, float, float], Vector(3, POSITION)]


@checked
class StartPose:
    """Poses of hand and block when a table is resolved, in world axes."""

    hand_position: Position  # hand origin at the keyframe `home` [m]
    hand_orientation: Annotated[tuple[float, float, float, float], Vector(4)]  # to world, at `home`
    target_position: Position  # centre of the block's top face [m]
    block_yaw: Annotated[float, Quantity()] = 0.0  # rotation of the block about z [rad]

    @property
    def grasp_yaw(self) -> float:
        """Smallest rotation about z that aligns the hand with the square block's sides [rad]."""
        return math.remainder(self.block_yaw, math.pi / 2)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of the hand in the world at given times, and the path between them.

    `Trajectory.from_table` makes it, once the plant's start pose is known; the inputs of a run
    sample it, and so does whatever looks at a motion before it runs. It ends no row early: commands
    that wait for a contact are `GuardedCommands`.

    Between rows the hand moves in a straight line and turns about one axis, the shortest way:

        p(t) = p_k + s(u) (p_k+1 - p_k),  q(t) = exp(s(u) r_k) q_k,  u = (t - t_k) / T_k

    with s = u for `linear` (its velocity commands are zero) and s = 10 u^3 - 15 u^4 + 6 u^5 for
    `quintic`, which starts and ends each segment at rest. `spline` passes all rows without a stop,
    on polynomials of degree 5 with four continuous derivatives, from rest to rest. Before the
    first row and after the last the hand does not move. A grip applies from its row's time on.
    Postures go from row to row as positions do.

    Attributes:
        times: Increasing, shape (n,) [s].
        positions: Hand origin in world, shape (n, 3) [m].
        orientations: Hand to world, (w, x, y, z) of length 1, shape (n, 4).
        grips: Opening between the fingertips, shape (n,) [m].
        interpolation: One of `INTERPOLATIONS`.
        postures: Joint positions, shape (n, 7) [rad]; None: the rows have no posture.
        untils: What ends each row early, see `TableRow`; may be empty if nothing does. `sample`
            does not know of it.
    """

    times: Array
    positions: Array
    orientations: Array
    grips: Array
    interpolation: str = "quintic"
    postures: Array | None = None
    untils: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("times", "positions", "orientations", "grips", "postures"):
            if getattr(self, name) is not None:
                values = np.array(getattr(self, name), dtype=np.float64)
                if name == "orientations":
                    values = rotations.same_sign_chain(values)
                values.flags.writeable = False
                object.__setattr__(self, name, values)

    @classmethod
    def from_table(
        cls,
        table: TrajectoryTable,
        start: StartPose,
        *,
        interpolation: str = "quintic",
        align: bool = False,
    ) -> Self:
        """Resolve a table once, from the poses at the start.

        Args:
            table: The rows, relative to their frames.
            start: The frames `home` and `target`.
            interpolation: One of `INTERPOLATIONS`.
            align: Turn offset and orientation of rows of frame `target` about z with the block,
                by at most 45 deg.
        """
        starts = ((0.0, 0.0, 0.0), start.hand_position, start.target_position)
        origins = dict(zip(FRAMES, starts, strict=True))
        columns = (
            (row.time, origins[row.frame], row.position, row.orientation or start.hand_orientation,
             row.opening, row.frame == "target")
            for row in table.rows
        )  # fmt: skip
        times, places, offsets, turns, grips, turned = map(np.array, zip(*columns, strict=True))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        if align:
            _turn(offsets, turns, turned, start.grasp_yaw)
        postures = np.array([row.posture for row in table.rows]) if table.has_posture else None
        untils = tuple(row.until for row in table.rows)
        return cls(times, places + offsets, turns, grips, interpolation, postures, untils)

    def sample(self, times: ArrayLike) -> Array:
        """Return the commands at the given times.

        Args:
            times: Shape (m,) [s].

        Returns:
            Shape (m, 14), columns as in `COMMANDS`: hand origin [m], hand to world
            (w, x, y, z), its velocity [m/s] and angular velocity [rad/s], all in world axes,
            and the opening between the fingertips [m]. With postures, shape (m, 28): their joint
            positions [rad] and velocities [rad/s] follow, as in `POSTURE_COMMANDS`.
        """
        t = np.asarray(times, dtype=np.float64).reshape(-1)
        row = np.searchsorted(self.times, t + TIME_TOLERANCE, side="right") - 1
        row = np.clip(row, 0, None)
        if self.interpolation == "spline" and len(self.times) > 1:
            return self._sample_spline(t, row)
        # The last row gets a segment of zero length that takes 1 s.
        duration = np.append(np.diff(self.times), 1.0)[row]
        u = np.clip((t - self.times[row]) / duration, 0.0, 1.0)
        s, rate = self.time_law(u, duration)
        shift = np.diff(self.positions, axis=0, append=self.positions[-1:])[row]
        turn = turns(self.orientations)[row]
        parts = [
            self.positions[row] + s * shift,
            rotations.multiply(rotations.exp(s * turn), self.orientations[row]),
            rate * shift,
            rate * turn,
            self.grips[row, None],
        ]
        if self.postures is not None:
            change = np.diff(self.postures, axis=0, append=self.postures[-1:])[row]
            parts += [self.postures[row] + s * change, rate * change]
        return np.hstack(parts)

    def _sample_spline(self, t: Array, row: NDArray[np.intp]) -> Array:
        """Return the commands on the spline of degree 5 from rest to rest, as `sample` does."""
        from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - slow, and rarely needed

        within = np.clip(t, self.times[0], self.times[-1])
        moving = (t >= self.times[0]) & (t <= self.times[-1])
        postures = np.empty((len(self.times), 0)) if self.postures is None else self.postures
        rows = np.hstack((self.positions, self.orientations, postures))
        at_rest = [(order, np.zeros(rows.shape[1])) for order in (1, 2)]
        path = make_interp_spline(self.times, rows, k=5, bc_type=(at_rest, at_rest))
        values, rates = path(within), path(within, 1) * moving[:, None]
        # The parts of the quaternion leave the unit sphere between rows: q = p / |p|.
        p, p_rate = values[:, 3:7], rates[:, 3:7]
        square = (p * p).sum(axis=1, keepdims=True)
        spin = rotations.multiply(p_rate, rotations.conjugate(p)) / square
        pose, twist = (values[:, :3], p / np.sqrt(square)), (rates[:, :3], 2.0 * spin[:, 1:])
        return np.hstack((*pose, *twist, self.grips[row, None], values[:, 7:], rates[:, 7:]))

    def time_law(self, u: Array, duration: Array) -> tuple[Array, Array]:
        """Return share of the way and its rate [1/s] that is commanded, each of shape (m, 1)."""
        if self.interpolation == "linear":
            return u[:, None], np.zeros((len(u), 1))
        s = u**3 * (10.0 + u * (6.0 * u - 15.0))
        rate = 30.0 * (u * (1.0 - u)) ** 2 / duration
        return s[:, None], rate[:, None]


def _turn(offsets: Array, orientations: Array, turned: NDArray[np.bool_], angle: float) -> None:
    """Turn some offsets (n, 3) and orientations (n, 4) about z, in place [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    to_world = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    offsets[turned] = offsets[turned] @ to_world.T
    orientations[turned] = rotations.multiply(rotations.about_z(angle), orientations[turned])


def turns(orientations: Array) -> Array:
    """Return each segment's rotation vector in world axes, and zero. Shape (n, 3) [rad]."""
    following = np.concatenate([orientations[1:], orientations[-1:]])
    turned = rotations.log(rotations.multiply(following, rotations.conjugate(orientations)))
    turned[(following == orientations).all(axis=1)] = 0.0  # exactly, instead of about 1e-17
    return turned
