"""What the robot tells a program about itself: its model as URDF, and its end effector."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from functools import cache
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np

from ...assets.franka import ROBOTS
from ..model import FINGERTIPS, Vector, load_arm

ROBOT: Final = "fr3"
LIMITS: Final = ROBOTS[ROBOT]


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
    hand, flange = data.body("hand"), data.body("link7").xmat.reshape(3, 3)
    each = [model.body(name).id for name in ("hand", "left_finger", "right_finger")]
    masses, centres = model.body_mass[each], (data.xipos[each] - hand.xpos) @ flange
    centre = masses @ centres / masses.sum()
    inertia = np.zeros((3, 3))
    for body, mass, away in zip(each, masses, centres - centre, strict=True):
        inertia += _turned(flange.T @ data.ximat[body].reshape(3, 3), model.body_inertia[body])
        inertia += mass * (away @ away * np.eye(3) - np.outer(away, away))
    pose = transform(flange.T @ hand.xmat.reshape(3, 3))
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
    turned: Vector = axes @ np.diag(inertia) @ axes.T
    return turned


@cache
def urdf() -> bytes:
    """Return the arm's model without its hand, with the limits that libfranka reads."""
    model, root = load_arm(robot=ROBOT), ET.Element("robot", name=ROBOT)
    for i in range(8):
        body = model.body(f"link{i}")
        _add_link(root, f"link{i}", body)
        if i > 0:
            joint = _add_joint(root, i, "revolute", body.pos, rotation(body.quat))
            _add_limits(joint, i - 1)
    _add_joint(root, 8, "fixed", model.body("hand").pos, np.eye(3))
    ET.SubElement(root, "link", name="link8")
    return b'<?xml version="1.0"?>' + ET.tostring(root)


def _add_link(root: ET.Element, name: str, body: Any) -> None:
    inertial = ET.SubElement(ET.SubElement(root, "link", name=name), "inertial")
    ET.SubElement(inertial, "origin", xyz=_words(body.ipos), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=_words(body.mass))
    matrix = _turned(rotation(body.iquat), body.inertia)
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2),
              "izz": (2, 2)}  # fmt: skip
    ET.SubElement(inertial, "inertia", {n: _words([matrix[at]]) for n, at in places.items()})


def _add_joint(root: ET.Element, i: int, kind: str, position: Vector, turn: Vector) -> ET.Element:
    joint = ET.SubElement(root, "joint", name=f"joint{i}", type=kind)
    pitch = np.arcsin(np.clip(-turn[2, 0], -1.0, 1.0))
    angles = np.arctan2(turn[2, 1], turn[2, 2]), pitch, np.arctan2(turn[1, 0], turn[0, 0])
    ET.SubElement(joint, "origin", xyz=_words(position), rpy=_words(angles))
    ET.SubElement(joint, "parent", link=f"link{i - 1}")
    ET.SubElement(joint, "child", link=f"link{i}")
    ET.SubElement(joint, "axis", xyz="0 0 1")
    return joint


def _add_limits(joint: ET.Element, i: int) -> None:
    ends = {name: _words([value[i]]) for name, value in LIMITS.approach.items()}
    effort, velocity = _words([LIMITS.torque[i]]), _words([LIMITS.velocity[i]])
    ET.SubElement(joint, "limit", lower=ends["low"], upper=ends["high"], effort=effort,
                  velocity=velocity)  # fmt: skip
    ET.SubElement(joint, "position_based_velocity_limits", deceleration_limit=ends["braking"],
                  velocity_offset=ends["offset"])  # fmt: skip


def _words(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
