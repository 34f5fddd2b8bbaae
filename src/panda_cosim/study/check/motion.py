"""A motion of the joints from a CSV file: what the real robot would refuse of it.

The file has the columns `time` [s] and `q1` to `q7` [rad], and may have `qd1` to `qd7` [rad/s], as
planners and JointTrajectory messages give them. Between its rows the joints follow cubic splines:
through all rows, at rest at both ends, or with the speeds that it gives. The arm is taken to follow
exactly, so that torques are those of the rigid body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.checks import ARMS
from ...assets.franka import JOINT_DAMPING
from ...controller.model import ArmModel
from ...controller.touch import ROTOR
from ...fmus.errors import InputError, excerpt, located
from ...fmus.reading import finite_number
from ...result.judging.advice import refusals
from ...result.judging.preflight import preflight
from ...result.recording import Column, Recording
from ...result.recording.storage import Source, in_one_block
from ...task.files import MAX_BYTES, parse_csv, read_text
from ...task.scenario import MAX_DURATION
from .diagnosis import Diagnostic

Array = NDArray[np.float64]

MOTION: Final = ".csv"
JOINTS: Final = tuple(f"q{joint}" for joint in range(1, 8))
SPEEDS: Final = tuple(f"qd{joint}" for joint in range(1, 8))


@dataclass(frozen=True)
class Motion:
    """Joints over time: rows as they stand in a file."""

    times: Array  # (n,) [s]
    joints: Array  # (n, 7) [rad]
    speeds: Array | None  # (n, 7) [rad/s]; None: not given

    @classmethod
    def read(cls, path: Path) -> Motion:
        """Read a file.

        Raises:
            InputError: It is no motion; the message names file, line and column.
        """
        text = read_text(path, MAX_BYTES)
        with located(path):
            table = parse_csv(text, _check_names)
            rows = [
                [_number(line, *cell) for cell in zip(table.names, cells, strict=True)]
                for line, cells in table.rows.items()
            ]
            if len(rows) < 2:
                raise InputError(f"{len(rows)} rows; must be at least two")
            columns = dict(zip(table.names, np.array(rows).T, strict=True))
            times = columns["time"]
            for line, gap in zip(list(table.rows)[1:], np.diff(times), strict=True):
                if not 0.0 < gap <= MAX_DURATION:
                    raise InputError(f"line {line}: time: must be after the row above")
        speeds = _stacked(columns, SPEEDS) if SPEEDS[0] in columns else None
        return cls(times, _stacked(columns, JOINTS), speeds)

    def sent(self) -> tuple[Array, Array]:
        """Return the instants (n,) [s] and joints (n, 7) [rad] that are sent each millisecond."""
        ticks = np.ceil((self.times[-1] - self.times[0]) / STEP_SIZE - 1e-6)
        times = self.times[0] + STEP_SIZE * np.arange(int(ticks) + 1)
        if self.speeds is None:
            spline = scipy.interpolate.CubicSpline(self.times, self.joints, bc_type="clamped")
        else:
            spline = scipy.interpolate.CubicHermiteSpline(self.times, self.joints, self.speeds)
        return times, np.asarray(spline(np.minimum(times, self.times[-1])))


def _check_names(names: Sequence[str]) -> None:
    """Refuse names of columns that are no motion's."""
    allowed = ({"time", *JOINTS}, {"time", *JOINTS, *SPEEDS})
    if set(names) not in allowed:
        listed = excerpt(",".join(names))
        raise InputError(f"columns {listed}; must be time and q1 to q7, and may be qd1 to qd7")


def _number(line: int, name: str, text: str) -> float:
    number = finite_number(text)
    if number is None:
        raise InputError(f"line {line}: {name}: value {excerpt(text)}; must be a finite number")
    return number


def _stacked(columns: dict[str, Array], names: Sequence[str]) -> Array:
    return np.stack([columns[name] for name in names], axis=1)


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
    listed = (Column("time", "s"), *map(Column, columns))
    values = {"time": times, **columns}
    return Recording(Path(), Source(listed, metadata, len(times), in_one_block(values.__getitem__)))


def check_motion(path: Path, robot: str) -> list[Diagnostic]:
    """Check a motion for a robot, `fer` or `fr3`."""
    motion = Motion.read(path)
    found = preflight(followed(motion, ARMS[robot]), robot)
    apart = np.diff(motion.times).max()
    joined = "" if apart <= STEP_SIZE * 1.001 else f", up to {apart:g} s apart, joined by splines"
    about = f"{path}: {motion.times[-1] - motion.times[0]:g} s, {len(motion.times)} rows{joined}"
    told = [Diagnostic(level, text) for level, text in refusals(found, complete=True)]
    return [Diagnostic("good", about), *told]
