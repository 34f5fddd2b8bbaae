"""What each element of MuJoCo's fields is: a part of which object, and in which unit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import mujoco

FREE, BALL, SLIDE, HINGE = range(4)  # mjtJoint
_POSE: Final = (*((f"position {axis}", "m") for axis in "xyz"),
                *((f"quaternion {part}", "1") for part in "wxyz"))  # fmt: skip
_LINEAR: Final = tuple((f"along {axis}", "m") for axis in "xyz")
_TURNS: Final = tuple((f"about {axis}", "rad") for axis in "xyz")
# Parts of a joint's position and of its motion, with their units, by its kind.
_POSITIONS: Final = {HINGE: (("angle", "rad"),), SLIDE: (("position", "m"),),
                     BALL: _POSE[3:], FREE: _POSE}  # fmt: skip
_MOTIONS: Final = {HINGE: (("", "rad"),), SLIDE: (("", "m"),), BALL: _TURNS,
                   FREE: (*_LINEAR, *_TURNS)}  # fmt: skip
_FORCES: Final = {"rad": "N.m", "m": "N", "": ""}
_OF_MOTIONS: Final = {
    "qvel": "velocity", "qacc": "acceleration",
    "qfrc_bias": "bias force", "qfrc_applied": "applied force",
    "qfrc_actuator": "actuator force", "qfrc_passive": "passive force",
    "qfrc_constraint": "constraint force",
}  # fmt: skip
_OF_ACTUATORS: Final = {"ctrl": "control", "actuator_force": "force"}
# Units of fields whose elements all have the same, or a pattern that repeats.
_UNITS: Final = {
    "xpos": ("m",), "xipos": ("m",), "subtree_com": ("m",), "geom_xpos": ("m",),
    "site_xpos": ("m",), "mocap_pos": ("m",), "xquat": ("1",), "mocap_quat": ("1",),
    "xmat": ("1",), "geom_xmat": ("1",), "site_xmat": ("1",), "geom_friction": ("1",),
    "xfrc_applied": ("N", "N", "N", "N.m", "N.m", "N.m"), "body_mass": ("kg",),
    "gravity": ("m/s2",), "wind": ("m/s",),
}  # fmt: skip
_SENSORS: Final = {
    "touch": "N", "accelerometer": "m/s2", "velocimeter": "m/s", "gyro": "rad/s", "force": "N",
    "torque": "N.m", "rangefinder": "m", "tendonpos": "m", "tendonvel": "m/s", "ballquat": "1",
    "ballangvel": "rad/s", "framepos": "m", "framequat": "1", "framexaxis": "1",
    "frameyaxis": "1", "framezaxis": "1", "framelinvel": "m/s", "frameangvel": "rad/s",
    "framelinacc": "m/s2", "frameangacc": "rad/s2", "subtreecom": "m", "subtreelinvel": "m/s",
}  # fmt: skip
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


class Element(NamedTuple):
    """One number of a field; `text` is "" where its variable's own description says it."""

    unit: str  # "" if it is not known
    text: str = ""


def elements(model: Any, field: str, size: int) -> tuple[Element, ...]:
    """What the elements of a field of mjData or mjModel are."""
    if field == "qpos" or field in _OF_MOTIONS:
        return tuple(_of_joints(model, field))
    if field in _OF_ACTUATORS:
        return tuple(_of_actuator(model, i, field) for i in range(model.nu))
    if field == "sensordata":
        units = (u for i in range(model.nsensor) for u in _of_sensor(model, i))
        return tuple(map(Element, units))
    pattern = _UNITS.get(field, ("",))
    return tuple(Element(pattern[i % len(pattern)]) for i in range(size))


def dof_units(model: Any) -> list[str]:
    """Unit of the motion of each degree of freedom."""
    return [unit for kind in model.jnt_type for _, unit in _MOTIONS[int(kind)]]


def _of_joints(model: Any, field: str) -> Iterator[Element]:
    parts, word = (_POSITIONS, "") if field == "qpos" else (_MOTIONS, _OF_MOTIONS[field])
    for joint, kind in enumerate(map(int, model.jnt_type)):
        name = _name(model.joint(joint), "joint")
        for part, unit in parts[kind]:
            text = f"{word} {part}".strip()
            given = {"qpos": unit, "qvel": f"{unit}/s", "qacc": f"{unit}/s2"}.get(field)
            yield Element(given or _FORCES[unit], f"{text[0].upper()}{text[1:]} of {name}")


def _of_actuator(model: Any, actuator: int, field: str) -> Element:
    """What the control or the force of an actuator is; one without a name has its joint's."""
    view, name = model.actuator(actuator), _name(model.actuator(actuator), "actuator")
    transmission, target = int(model.actuator_trntype[actuator]), model.actuator_trnid[actuator, 0]
    length = "m" if transmission == _TENDON else ""
    if transmission in _ON_JOINTS:
        length = {HINGE: "rad", SLIDE: "m"}.get(int(model.jnt_type[target]), "")
        name += "" if view.name else f" on {_name(model.joint(target), 'joint')}"
    unit = _unit_of_control(model, actuator, length) if field == "ctrl" else _FORCES[length]
    return Element(unit, f"{_OF_ACTUATORS[field].capitalize()} of {name}")


def _unit_of_control(model: Any, actuator: int, length: str) -> str:
    """Unit of a motor's force, or of a servo's position or velocity; "" of anything else."""
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    follows = model.actuator_dyntype[actuator] in _FOLLOWING
    if not (length and follows and model.actuator_gaintype[actuator] == _FIXED):
        return ""
    if model.actuator_biastype[actuator] == _NO_BIAS:
        return _FORCES[length] if gain[0] == 1.0 else ""
    if bias[0] == 0.0 and bias[1] == -gain[0]:
        return length
    return f"{length}/s" if not bias[:2].any() and bias[2] == -gain[0] else ""


def _of_sensor(model: Any, sensor: int) -> tuple[str, ...]:
    kind: str = mujoco.mjtSensor(int(model.sensor_type[sensor])).name[7:].lower()
    unit = _SENSORS.get(kind, "")
    if kind in ("jointpos", "jointvel"):  # of a hinge or a slide
        joint = int(model.jnt_type[model.sensor_objid[sensor]])
        unit = _MOTIONS[joint][0][1] + "/s" * (kind == "jointvel")
    return (unit,) * int(model.sensor_dim[sensor])


def _name(view: Any, kind: str) -> str:
    return f"{kind} {view.name or view.id + 1}"
