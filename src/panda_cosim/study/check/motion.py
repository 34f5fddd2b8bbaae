"""A motion of the joints from a file: what the real robot would refuse of it, and new times.

A table, CSV or Parquet, has the columns `time` [s] and `q1` to `q7` [rad], and may have `qd1` to
`qd7` [rad/s], as planners give them; an MCAP file has JointTrajectory messages. Between the rows
the joints follow cubic splines: through all rows, at rest at both ends, or with the speeds that are
given. The arm is taken to follow exactly, so that torques are those of the rigid body.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time

from ...assets import STEP_SIZE
from ...assets.checks import ARMS, CHECKS
from ...assets.fields import Array
from ...assets.franka import JOINT_DAMPING
from ...controller.model import ArmModel
from ...controller.touch import ROTOR
from ...fmus.errors import InputError, excerpt, located
from ...result.judging.advice import refusals
from ...result.judging.preflight import preflight
from ...result.recording import Recording
from ...result.recording.logs import MCAP, TIME, messages, read_columns
from ...task.files import csv_text
from ...task.scenario import MAX_DURATION
from .diagnosis import Diagnostic

JOINTS: Final = tuple(f"q{joint}" for joint in range(1, 8))
SPEEDS: Final = tuple(f"qd{joint}" for joint in range(1, 8))
ROUNDS: Final = 12  # of `retimed`
ENOUGH: Final = 0.98  # of the share that may be used
OWN: Final = ("joint", "arm")  # interfaces whose limits are kept
FIXED: Final = {key for key, check in CHECKS.items() if check.remedy in ("elsewhere", "start")}
POWERS: Final = {"velocity": 1, "jerk": 3, "rate": 3}  # of the times; of all else, 2


@dataclass(frozen=True)
class Motion:
    """Joints over time: rows as they stand in a file."""

    times: Array  # (n,) [s]
    joints: Array  # (n, 7) [rad]
    speeds: Array  # (n, 7) [rad/s]; (n, 0): not given

    @classmethod
    def of(cls, columns: Mapping[str, Array]) -> Motion:
        """Make one of the columns of a table."""
        names = (TIME, *JOINTS, *(SPEEDS if columns.keys() & {*SPEEDS} else ()))
        if {*names} - columns.keys():
            listed = excerpt(",".join(columns))
            raise InputError(f"columns {listed}; must be time and q1 to q7, and may be qd1 to qd7")
        rows = np.column_stack([columns[name] for name in names])
        return cls(rows[:, 0], rows[:, 1:8], rows[:, 8:])

    def __post_init__(self) -> None:
        """Refuse what no robot could follow."""
        if len(self.times) < 2:
            raise InputError(f"{len(self.times)} rows; must be at least two")
        gaps = np.diff(self.times)
        for row in np.flatnonzero(~((gaps > 0.0) & (gaps <= MAX_DURATION))):
            raise InputError(f"row {row + 2}: time: must be after the row above")

    def stretched(self, factor: float) -> Motion:
        """Return the same motion, so many times as slow."""
        times = self.times[0] + factor * (self.times - self.times[0])
        return replace(self, times=times, speeds=self.speeds / factor)

    def sent(self) -> tuple[Array, Array]:
        """Return the instants (n,) [s] and joints (n, 7) [rad] that are sent each millisecond."""
        ticks = np.ceil((self.times[-1] - self.times[0]) / STEP_SIZE - 1e-6)
        times = self.times[0] + STEP_SIZE * np.arange(int(ticks) + 1)
        if not self.speeds.size:
            spline = scipy.interpolate.CubicSpline(self.times, self.joints, bc_type="clamped")
        else:
            spline = scipy.interpolate.CubicHermiteSpline(self.times, self.joints, self.speeds)
        return times, np.asarray(spline(np.minimum(times, self.times[-1])))


def motions(path: Path) -> list[Motion]:
    """Read a motion, or all of an MCAP file's JointTrajectory messages.

    Raises:
        InputError: There is none; the message names file, place and column.
    """
    if path.suffix != MCAP:
        tables = [read_columns(path, (TIME, *JOINTS, *SPEEDS))]
    else:
        tables = [_columns(each) for _, _, each in messages(path) if is_trajectory(each)]
    with located(path):
        if not tables:
            raise InputError("no message in it is a JointTrajectory")
        return [Motion.of(table) for table in tables]


def is_trajectory(content: Any) -> bool:
    """Whether a message is a JointTrajectory."""
    return isinstance(content, dict) and {"joint_names", "points"} <= content.keys()


def _columns(content: Any) -> dict[str, Array]:
    """Return a JointTrajectory as a table; joints are in the order of their names."""
    order = np.argsort(content["joint_names"])
    rows = []
    for point in content["points"]:
        after, speeds = point["time_from_start"], point["velocities"]
        values = [np.array(each, float)[order] for each in (point["positions"], speeds) if each]
        rows.append(np.concatenate(([after["sec"] + 1e-9 * after["nanosec"]], *values)))
    return dict(zip((TIME, *JOINTS, *SPEEDS), np.transpose(rows), strict=False))


def followed(motion: Motion, arm: str) -> Recording:
    """Return the recording of an arm, one of `ARMS`' values, that follows a motion exactly."""
    times, q = motion.sent()
    qd, qdd = np.zeros((2, *q.shape))
    qd[1:] = np.diff(q, axis=0) / STEP_SIZE
    qdd[1:] = np.diff(qd, axis=0) / STEP_SIZE
    model, rows = ArmModel(arm), []
    for angles, rate, change in zip(q, qd, qdd, strict=True):
        hand = model.hand(angles, rate)
        state = [*hand.position, *hand.orientation, *hand.jacobian.ravel(), *hand.bias]
        inertia = model.inertia_force(angles, change)
        force = inertia + state[-7:] + JOINT_DAMPING[arm] * rate + ROTOR * change
        rows.append([*state, *force])
    pose, turn, jac, bias, force = np.split(np.array(rows), np.cumsum((3, 4, 42, 7)), axis=1)
    signals = {
        "controller.qpos_ref": q, "controller.pos_cmd": pose, "controller.quat_cmd": turn,
        "plant.qpos": q, "plant.qvel": qd, "plant.actuator_force": force, "plant.qfrc_bias": bias,
        "plant.hand_xpos": pose, "plant.hand_xquat": turn,
    }  # fmt: skip
    columns = {
        f"{name}[{number}]": column
        for name, values in signals.items()
        for number, column in enumerate(values.T, 1)
    }
    columns |= {f"plant.jac[{i // 7 + 1},{i % 7 + 1}]": jac[:, i] for i in range(42)}
    metadata = {
        "row_times": motion.times.tolist(), "robot": arm, "step_size": STEP_SIZE,
        "parameters": {"controller": {}, "plant": {}},
    }  # fmt: skip
    return Recording.of_columns({TIME: times, **columns}, metadata)


def check_motion(path: Path, robot: str | None) -> Iterator[Diagnostic]:
    """Check the motions in a file for a robot, `fer` or `fr3`."""
    for motion in motions(path):
        found = _judged(motion, robot)
        apart = np.diff(motion.times).max()
        said = f"{path}: {motion.times[-1] - motion.times[0]:g} s, {len(motion.times)} rows"
        if apart > STEP_SIZE * 1.001:
            said += f", up to {apart:g} s apart, joined by splines"
        yield Diagnostic("good", said)
        yield from (Diagnostic(level, text) for level, text in refusals(found, complete=True))


def retimed(
    path: Path, robot: str | None, share: float, *, keep_times: bool
) -> tuple[Motion, float]:
    """Return a file's motion as fast as a share of a robot's limits allows, and by which factor.

    All of it becomes slower or faster by the same factor; with `keep_times`, no faster.

    Raises:
        InputError: It is too fast at any speed that is tried.
    """
    motion, *others = motions(path)
    if others:
        raise InputError(f"{path}: {1 + len(others)} motions; must be one")
    factor = 1.0
    for _ in range(ROUNDS):
        with located(path):
            needed = _needed(_used(motion.stretched(factor), robot), share)
        if needed < 1.0 and (needed > ENOUGH or (keep_times and factor == 1.0)):
            return motion.stretched(factor), factor
        factor *= needed * (1.0 + ENOUGH) / 2.0 / ENOUGH
    raise InputError(f"{path}: no times were found within {share:.0%} of the limits")


def _judged(motion: Motion, robot: str | None) -> dict[str, Any]:
    if robot is None:
        raise InputError("--robot: is missing; must be fer or fr3")
    return preflight(followed(motion, ARMS[robot]), robot)


def _used(motion: Motion, robot: str | None) -> dict[str, float]:
    """Return the largest shares of the limits of joints and arm."""
    found = _judged(motion, robot)
    own = (key for key, check in CHECKS.items() if check.interface in OWN and check.necessary)
    return {key: max(found[f"{key}_share"] or (0.0,)) for key in own}


def _needed(used: Mapping[str, float], share: float) -> float:
    """Return the factor of all times at which the limits are used up to a share."""
    factors = [0.0]
    for key, most in used.items():
        if key not in FIXED:
            factors.append((most / share) ** (1.0 / POWERS.get(key.rpartition("_")[2], 2)))
        elif most >= 1.0:
            raise InputError(f"{key}: is beyond its limit at any speed")
    return max(factors)


def motion_text(motion: Motion) -> str:
    """Return a motion as CSV."""
    rows = np.column_stack([motion.times, motion.joints, motion.speeds])
    return csv_text([[TIME, *JOINTS, *SPEEDS][: rows.shape[1]], *rows.tolist()])
