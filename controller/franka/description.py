"""What the robot tells a program about itself: its model as URDF, and its end effector."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np

from ...assets.fields import Vector
from ...assets.franka import ROBOTS
from ..model import FINGERTIPS, load_arm

ROBOT: Final = "fr3"
LIMITS: Final = ROBOTS[ROBOT]
_TEXTS: Final[dict[str, str]] = tomllib.loads(
    Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
)


class EndEffector(NamedTuple):
    """The hand with its fingers, seen from the flange, whose axes are those of link 7."""

    mass: float  # [kg]
    centre: Vector  # of mass (3,) [m]
    inertia: Vector  # about it (3, 3) [kg.m2]
    hand: Vector  # pose of the hand (4, 4)
    tips: Vector  # pose of the fingertips' centre (4, 4), the nominal end effector


@cache
def end_effector() -> EndEffector:
    """Return the end effector of the arm's model."""
    model = load_arm(robot=ROBOT)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    hand, axes = data.body("hand"), data.body("link7").xmat.reshape(3, 3)
    each = [model.body(name).id for name in ("hand", "left_finger", "right_finger")]
    masses, centres = model.body_mass[each], (data.xipos[each] - hand.xpos) @ axes
    centre, inertia = masses @ centres / masses.sum(), np.zeros((3, 3))
    for body, mass, away in zip(each, masses, centres - centre, strict=True):
        inertia += _turned(axes.T @ data.ximat[body].reshape(3, 3), model.body_inertia[body])
        inertia += mass * (away @ away * np.eye(3) - np.outer(away, away))
    pose = transform(axes.T @ hand.xmat.reshape(3, 3))
    return EndEffector(masses.sum(), centre, inertia, pose, pose @ transform(np.eye(3), FINGERTIPS))


def transform(rotation: Any, position: Any = (0.0, 0.0, 0.0)) -> Vector:
    """Return a pose as a matrix (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def rotation(quat: Vector) -> Vector:
    """Return the matrix (3, 3) of a quaternion (w, x, y, z)."""
    turned = np.empty(9)
    mujoco.mju_quat2Mat(turned, quat)
    return turned.reshape(3, 3)


def _turned(axes: Vector, inertia: Vector) -> Vector:
    """Return the matrix of principal inertias (3,) about axes (3, 3)."""
    return axes @ np.diag(inertia) @ axes.T


@cache
def urdf() -> bytes:
    """Return the arm's model without its hand, with the limits that libfranka reads."""
    bodies = [
        load_arm(robot=ROBOT).body(name) for name in (*(f"link{i}" for i in range(8)), "hand")
    ]
    parts = [_link(0, bodies[0])]
    for i in range(1, 8):
        ends = {name: values[i - 1] for name, values in LIMITS.approach.items()}
        limits = _TEXTS["limits"].format(
            torque=LIMITS.torque[i - 1], velocity=LIMITS.velocity[i - 1], **ends
        )
        turn = rotation(bodies[i].quat)
        parts += [_link(i, bodies[i]), _joint(i, "revolute", bodies[i].pos, turn, limits)]
    parts += [_TEXTS["flange"], _joint(8, "fixed", bodies[8].pos, np.eye(3), "")]
    return _TEXTS["document"].format(name=ROBOT, parts="".join(parts)).encode()


def _link(i: int, body: Any) -> str:
    inertia = _turned(rotation(body.iquat), body.inertia)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    return _TEXTS["link"].format(i=i, centre=_words(body.ipos), mass=body.mass[0], xx=xx, xy=xy,
                                 xz=xz, yy=yy, yz=yz, zz=zz)  # fmt: skip


def _joint(i: int, kind: str, position: Vector, turn: Vector, limits: str) -> str:
    pitch = np.arcsin(np.clip(-turn[2, 0], -1.0, 1.0))
    angles = np.arctan2(turn[2, 1], turn[2, 2]), pitch, np.arctan2(turn[1, 0], turn[0, 0])
    return _TEXTS["joint"].format(i=i, before=i - 1, kind=kind, position=_words(position),
                                  angles=_words(angles), limits=limits)  # fmt: skip


def _words(numbers: Iterable[float]) -> str:
    return " ".join(str(float(number)) for number in numbers)
