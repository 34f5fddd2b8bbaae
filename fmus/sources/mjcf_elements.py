"""Units and descriptions of the elements of MuJoCo's fields, from joints and actuators."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import mujoco

FREE: Final = 0  # mjtJoint
HINGE, SLIDE, BALL = 3, 2, 1
QPOS: Final = {HINGE: ("rad",), SLIDE: ("m",), BALL: ("1",) * 4, FREE: (*"mmm", *"1111")}
DOF: Final = {HINGE: ("rad",), SLIDE: ("m",), BALL: ("rad",) * 3, FREE: (*"mmm", *["rad"] * 3)}
_FORCE: Final = {"rad": "N.m", "m": "N"}
_FIELDS: Final = {"mocap_pos": "m", "mocap_quat": "1", "xpos": "m", "xquat": "1", "site_xpos": "m"}
_POSE: Final = (*(f"position {axis}" for axis in "xyz"), *(f"quaternion {part}" for part in "wxyz"))
# What the elements of a joint are called.
_POSITIONS: Final = {HINGE: ("angle",), SLIDE: ("position",), BALL: _POSE[3:], FREE: _POSE}
_TURNS: Final = ("about x", "about y", "about z")
_MOTIONS: Final = {
    HINGE: ("",),
    SLIDE: ("",),
    BALL: _TURNS,
    FREE: ("along x", "along y", "along z", *_TURNS),
}
_OF_MOTIONS: Final = {
    "qvel": "velocity", "qacc": "acceleration",
    "qfrc_bias": "bias force", "qfrc_applied": "applied force",
    "qfrc_actuator": "actuator force", "qfrc_passive": "passive force",
    "qfrc_constraint": "constraint force",
}  # fmt: skip
_OF_ACTUATORS: Final = {"ctrl": "control", "actuator_force": "force"}
# MuJoCo's numbers of the kinds of actuators.
_ON_JOINTS: Final = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_TENDON: Final = int(mujoco.mjtTrn.mjTRN_TENDON)
_FIXED: Final = int(mujoco.mjtGain.mjGAIN_FIXED)
_NO_BIAS: Final = int(mujoco.mjtBias.mjBIAS_NONE)
_FOLLOWING: Final = (  # whose force follows the control, perhaps filtered
    int(mujoco.mjtDyn.mjDYN_NONE),
    int(mujoco.mjtDyn.mjDYN_FILTER),
    int(mujoco.mjtDyn.mjDYN_FILTEREXACT),
)


def units(model: Any, field: str) -> str | tuple[str, ...]:
    """Units of the elements of a field of mjData, or of all of them; "" if they are not known."""
    dofs = [unit for kind in model.jnt_type for unit in DOF[int(kind)]]
    match field:
        case "qpos":
            return tuple(unit for kind in model.jnt_type for unit in QPOS[int(kind)])
        case "qvel" | "qacc":
            return tuple(f"{unit}/s{'2' * (field == 'qacc')}" for unit in dofs)
        case "ctrl":
            return tuple(_unit_of_control(model, i) for i in range(model.nu))
        case "actuator_force":
            return tuple(_FORCE.get(_joint_unit(model, i), "") for i in range(model.nu))
    if field.startswith("qfrc_"):
        return tuple(_FORCE[unit] for unit in dofs)
    return _FIELDS.get(field, "")


def _joint_unit(model: Any, actuator: int) -> str:
    """Unit of the length of an actuator, by what it acts on."""
    transmission, target = int(model.actuator_trntype[actuator]), model.actuator_trnid[actuator, 0]
    if transmission in _ON_JOINTS:
        return {HINGE: "rad", SLIDE: "m"}.get(int(model.jnt_type[target]), "")
    return "m" if transmission == _TENDON else ""


def _unit_of_control(model: Any, actuator: int) -> str:
    """Unit of a motor's force, or of a servo's position or velocity; "" of anything else."""
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    unit, follows = _joint_unit(model, actuator), model.actuator_dyntype[actuator] in _FOLLOWING
    if not (unit and follows and model.actuator_gaintype[actuator] == _FIXED):
        return ""
    if model.actuator_biastype[actuator] == _NO_BIAS:
        return _FORCE[unit] if gain[0] == 1.0 else ""
    if bias[0] == 0.0 and bias[1] == -gain[0]:
        return unit
    return f"{unit}/s" if not bias[:2].any() and bias[2] == -gain[0] else ""


def descriptions(model: Any, field: str) -> tuple[str, ...]:
    """Descriptions of the elements of a field of mjData; of joints and actuators only."""
    if field in _OF_ACTUATORS:
        names = (_actuator(model, i) for i in range(model.nu))
        return tuple(f"{_OF_ACTUATORS[field].capitalize()} of {name}" for name in names)
    return tuple(_of_joints(model, field)) if field == "qpos" or field in _OF_MOTIONS else ()


def _of_joints(model: Any, field: str) -> Iterator[str]:
    for joint, kind in enumerate(map(int, model.jnt_type)):
        name = _name(model.joint(joint), "joint")
        for part in (_POSITIONS if field == "qpos" else _MOTIONS)[kind]:
            words = " ".join(filter(None, (_OF_MOTIONS.get(field), part)))
            yield f"{words[0].upper()}{words[1:]} of {name}"


def _actuator(model: Any, actuator: int) -> str:
    """Name of an actuator; of one without a name, with its joint."""
    view, target = model.actuator(actuator), int(model.actuator_trnid[actuator, 0])
    is_on_joint = not view.name and int(model.actuator_trntype[actuator]) in _ON_JOINTS
    on_joint = f" on {_name(model.joint(target), 'joint')}" if is_on_joint else ""
    return _name(view, "actuator") + on_joint


def _name(view: Any, kind: str) -> str:
    return f"{kind} {view.name or view.id + 1}"
