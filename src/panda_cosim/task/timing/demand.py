"""Demands of a trajectory on the robot: shares of its limits, and what is beyond them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.fields import Array
from ...assets.franka import BLOCK_WIDTH, ROBOTS, SERVO_DAMPING
from ...controller.model import load_arm
from ..limits import LIMITS, LIMITS_OF, shares
from ..table import TrajectoryTable
from ..trajectory import TIME_TOLERANCE, Trajectory
from .joint_reference import JointReference, rates

Shares = dict[str, float]

REACH_TOLERANCE: Final = 0.001  # [m] by which the hand may miss the command
# [m] The same on the way, where new times are made: near singularities the damping makes the hand
# lag, and more time does not always help.
WAY_TOLERANCE: Final = 0.005
SPEED: Final = 0.5  # [m/s] a segment's mean speed, unless the table is slower
SLOWEST: Final = 12.0  # times slower than that: what takes more is no matter of time
AWAY: Final = "the path must stay away from singularities, such as the stretched arm"
HALF_OPEN: Final = 0.02  # [m] finger position, away from the ends of the range
_STEP_DAMPING: Final = STEP_SIZE * np.array(SERVO_DAMPING)  # [kg.m^2]


@dataclass(frozen=True)
class Timing:
    """A trajectory with new times, and the shares of the limits that it uses."""

    trajectory: Trajectory  # commands at those times
    shares: Shares  # the largest of each limit [1]
    # New rows, in the world, to be interpolated by `spline`; None: the old ones, at the
    # trajectory's times.
    table: TrajectoryTable | None = None

    @property
    def cycle(self) -> float:
        """Time of the last row [s]."""
        return float(self.trajectory.times[-1])


class ArmDynamics:
    """Torques of a robot's arm, with a point mass `load` [kg] between the fingertips."""

    def __init__(self, load: float, robot: str) -> None:
        self.robot = ROBOTS[robot]
        self._model: Any = load_arm(load, robot)
        self._data: Any = mujoco.MjData(self._model)
        self._data.qpos[7:] = HALF_OPEN

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the torques (7,) [N.m] that the servos show, the joints' damping included.

        A servo's torque is measured with the velocity at the beginning of a step, but acts with
        the one at its end: what is measured has damping times the change between them on top.
        Dry friction is left out: its sign would change at once here, however slow the joint is.
        """
        data = self._data
        data.qpos[:7], data.qvel[:7], data.qacc[:7] = q, qd, qdd
        mujoco.mj_inverse(self._model, data)
        return np.asarray(data.qfrc_inverse[:7] + data.qfrc_constraint[:7] + _STEP_DAMPING * qdd)


def joint_demands(
    trajectory: Trajectory, reference: JointReference, load: float
) -> dict[str, Array]:
    """Return the share of each limit of the joints at each tick (n, 7).

    `load` is the mass of what the closed fingers carry [kg].
    """
    robot, acceleration = reference.robot, rates(reference.velocity)
    closed = trajectory.sample(reference.time)[:, 13] < BLOCK_WIDTH
    # The block's weight is taken up gradually, so the switch of loads is not a torque rate.
    empty = _torques(reference, acceleration, 0.0, ~closed)
    full = _torques(reference, acceleration, load, closed)
    used = {
        "acceleration": acceleration,
        "jerk": rates(acceleration),
        "torque": np.where(closed[:, None], full, empty),
        "torque rate": np.where(closed[:, None], rates(full), rates(empty)),
    }
    speed = ROBOTS[robot].speed(reference.position, reference.velocity)
    demanded = {name: shares(name, values, robot) for name, values in used.items()}
    return {"velocity": reference.velocity / speed} | demanded


def demands(trajectory: Trajectory, reference: JointReference, load: float) -> dict[str, Array]:
    """Return the share of each limit at each tick (n, 7), or (n, 1) for the hand's."""
    commands = trajectory.sample(reference.time)
    velocity, turn = commands[:, 7:10], commands[:, 10:13]
    vectors = {"hand speed": velocity, "hand acceleration": rates(velocity), "hand turn": turn}
    hand = {
        name: shares(name, np.linalg.norm(each, axis=1, keepdims=True), reference.robot)
        for name, each in vectors.items()
    }
    return joint_demands(trajectory, reference, load) | hand


def _torques(
    reference: JointReference, acceleration: Array, load: float, asked: NDArray[np.bool_]
) -> Array:
    """Return the torques (n, 7) [N.m] that a joint reference needs, at accelerations (n, 7).

    They are computed for the instants (n,) that are asked for and those before them.
    """
    arm, torques = ArmDynamics(load, reference.robot), np.zeros_like(acceleration)
    for i in np.flatnonzero(asked | np.append(asked[1:], False)):
        torques[i] = arm.torque(reference.position[i], reference.velocity[i], acceleration[i])
    return torques


def remedy(quantity: str) -> str:
    """Return what helps where time does not."""
    if quantity != "torque":  # so slowly, that is gravity's
        return AWAY
    return (
        "gravity alone needs it; allow a larger share, carry a lighter load, or keep closer to the "
        "base"
    )


def largest(demanded: dict[str, Array]) -> Shares:
    """Return the largest share of each limit over all ticks [1]."""
    return {name: float(np.abs(share).max()) for name, share in demanded.items()}


@dataclass(frozen=True)
class LimitViolation:
    """One limit that one segment exceeds."""

    row: int  # that the segment leads to, from 1
    time: float  # when it is exceeded most [s]
    joint: int  # from 1; 0 for the hand as a whole
    quantity: str  # one of `LIMITS`, or `reach`: the hand misses the command
    value: float  # largest magnitude, in the limit's unit; [m] for `reach`
    limit: float  # what is allowed

    @property
    def share(self) -> float:
        """Value over limit [1]."""
        return self.value / self.limit

    def __str__(self) -> str:
        """Describe it in one line."""
        if self.quantity == "reach":
            return (
                f"row {self.row}: the hand is {self.value:.3g} m off the command at "
                f"t = {self.time:.3f} s; it must be within the arm's reach and joint ranges"
            )
        unit = LIMITS[self.quantity].unit
        return (
            f"row {self.row}: {self.quantity} of joint {self.joint} is {self.value:.3g} {unit} "
            f"at t = {self.time:.3f} s; must be at most {self.limit:.3g} {unit} "
            f"({100 * self.share:.0f} %)"
        )


def find_violations(
    trajectory: Trajectory,
    reference: JointReference,
    load: float,
    share: float,
    reach: float = REACH_TOLERANCE,
) -> tuple[list[LimitViolation], Shares]:
    """Return the worst violation of each kind in each row, and the largest share of each limit.

    The closed fingers carry `load` [kg], `share` is what may be used of each limit [1], and the
    hand may miss the command by `reach` [m].
    """
    segment = np.searchsorted(trajectory.times, reference.time - TIME_TOLERANCE) + 1
    demanded = joint_demands(trajectory, reference, load)
    velocity, time, miss = reference.velocity, reference.time, reference.miss
    violations = []
    for row in np.unique(segment).tolist():
        ticks = np.flatnonzero(segment == row)
        for quantity, demand in demanded.items():
            part = np.abs(demand[ticks])
            at, joint = divmod(int(part.argmax()), part.shape[1])
            tick, used = ticks[at], float(part[at, joint])
            if used > share:
                bound = float(LIMITS_OF[reference.robot][quantity].bound[joint])
                if quantity == "velocity":  # it may depend on the position
                    bound = abs(float(velocity[tick, joint]) / used)
                found = joint + 1, quantity, used * bound, share * bound
                violations.append(LimitViolation(row, float(time[tick]), *found))
        worst = ticks[miss[ticks].argmax()]
        if miss[worst] > reach:
            found = 0, "reach", float(miss[worst]), reach
            violations.append(LimitViolation(row, float(time[worst]), *found))
    # What is out of reach makes the joints jump: the cause comes first.
    violations.sort(key=lambda v: (v.row, v.quantity != "reach", -v.share))
    return violations, largest(demanded)
