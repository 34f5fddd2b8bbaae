"""What each element of MuJoCo's fields is: a part of which object, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import mujoco

FREE, BALL, SLIDE, HINGE = range(4)  # mjtJoint
_POSE: Final = (*((f"position {axis}", "m", axis) for axis in "xyz"),
                *((f"quaternion {part}", "1", f"q{part}") for part in "wxyz"))  # fmt: skip
_LINEAR: Final = tuple((f"along {axis}", "m", f"v{axis}") for axis in "xyz")
_TURNS: Final = tuple((f"about {axis}", "rad", f"w{axis}") for axis in "xyz")
# Parts of a joint's position and of its motion, by its kind: words, unit, and the short name of the
# position or velocity.
_POSITIONS: Final = {HINGE: (("angle", "rad", "pos"),), SLIDE: (("position", "m", "pos"),),
                     BALL: _POSE[3:], FREE: _POSE}  # fmt: skip
_MOTIONS: Final = {HINGE: (("", "rad", "vel"),), SLIDE: (("", "m", "vel"),), BALL: _TURNS,
                   FREE: (*_LINEAR, *_TURNS)}  # fmt: skip
_FORCES: Final = {"rad": "N.m", "m": "N"}
# Units of what is derived from a length or an angle; that of an unknown unit is unknown.
_DERIVED: Final[dict[str, Callable[[str], str]]] = {
    "pos": lambda unit: unit,
    "vel": lambda unit: unit and f"{unit}/s",
    "acc": lambda unit: unit and f"{unit}/s2",
    "frc": lambda unit: _FORCES.get(unit, ""),
}
_OF_MOTIONS: Final = {  # by field
    "qvel": ("velocity", "vel"), "qacc": ("acceleration", "acc"),
    "qfrc_bias": ("bias force", "frc"), "qfrc_applied": ("applied force", "frc"),
    "qfrc_actuator": ("actuator force", "frc"), "qfrc_passive": ("passive force", "frc"),
    "qfrc_constraint": ("constraint force", "frc"),
}  # fmt: skip
_OF_TENDONS: Final = {"ten_length": ("length", "pos"), "ten_velocity": ("velocity", "vel")}
_OF_ACTUATORS: Final = {
    "ctrl": ("control", ""), "act": ("activation", ""), "actuator_force": ("force", "frc"),
    "actuator_length": ("length", "pos"), "actuator_velocity": ("velocity", "vel"),
}  # fmt: skip
# Units of fields whose elements all have the same, or a pattern that repeats.
_UNITS: Final = {
    "xpos": ("m",), "xipos": ("m",), "subtree_com": ("m",), "geom_xpos": ("m",),
    "site_xpos": ("m",), "mocap_pos": ("m",), "xquat": ("1",), "mocap_quat": ("1",),
    "xmat": ("1",), "geom_xmat": ("1",), "site_xmat": ("1",), "geom_friction": ("1",),
    "xfrc_applied": ("N", "N", "N", "N.m", "N.m", "N.m"), "body_mass": ("kg",),
    "gravity": ("m/s2",), "wind": ("m/s",), "energy": ("J",),
}  # fmt: skip
_SENSORS: Final = {
    "touch": "N", "accelerometer": "m/s2", "velocimeter": "m/s", "gyro": "rad/s", "force": "N",
    "torque": "N.m", "rangefinder": "m", "ballquat": "1", "ballangvel": "rad/s",
    "framepos": "m", "framequat": "1", "framexaxis": "1", "frameyaxis": "1", "framezaxis": "1",
    "framelinvel": "m/s", "frameangvel": "rad/s", "framelinacc": "m/s2", "frameangacc": "rad/s2",
    "subtreecom": "m", "subtreelinvel": "m/s", "subtreeangmom": "kg.m2/s", "clock": "s",
    "e_potential": "J", "e_kinetic": "J", "geomdist": "m", "geomnormal": "1", "geomfromto": "m",
}  # fmt: skip
# Sensors of what moves, such as `jointpos`, `tendonlimitvel` or `actuatorfrc`.
_OF_MOVED: Final = re.compile(r"(joint|tendon|actuator)(?:limit|act)?(pos|vel|frc)")
# MuJoCo's numbers of the kinds of actuators; older versions lack some.
_ON_JOINTS: Final = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_TENDON: Final = int(mujoco.mjtTrn.mjTRN_TENDON)
_ON_BALL: Final = int(getattr(mujoco.mjtTrn, "mjTRN_SO3", -1))
_FIXED: Final = int(mujoco.mjtGain.mjGAIN_FIXED)
_SERVOS: Final = tuple(int(getattr(mujoco.mjtGain, f"mjGAIN_{n}", -1)) for n in ("PID", "DCMOTOR"))
_NO_BIAS: Final = int(mujoco.mjtBias.mjBIAS_NONE)
_FOLLOWING: Final = (  # whose force follows the control, perhaps filtered
    int(mujoco.mjtDyn.mjDYN_NONE),
    int(mujoco.mjtDyn.mjDYN_FILTER),
    int(mujoco.mjtDyn.mjDYN_FILTEREXACT),
)


class Element(NamedTuple):
    """One number of a field."""

    unit: str  # "" if it is not known
    text: str = ""  # what it is; "": its variable's own description says it
    group: str = ""  # of elements of one unit: the name of the joint, actuator or tendon


def elements(model: Any, field: str, size: int) -> Sequence[Element]:
    """What the elements of a field of mjData or mjModel are."""
    if field == "qpos" or field in _OF_MOTIONS:
        return list(_of_joints(model, field))
    if field in _OF_ACTUATORS:
        return list(_of_actuators(model, field))
    if field in _OF_TENDONS:
        what, derived = _OF_TENDONS[field]
        units = [_DERIVED[derived](_tendon_unit(model, i)) for i in range(size)]
        views = [model.tendon(i) for i in range(size)]
        return [
            _element(unit, what, view, "tendon", address=f"{view.name}.{what}")
            for unit, view in zip(units, views, strict=True)
        ]
    if field == "sensordata":
        return [Element(unit) for i in range(model.nsensor) for unit in _of_sensor(model, i)]
    pattern = _UNITS.get(field, ("",))
    return [Element(pattern[i % len(pattern)]) for i in range(size)]


def dof_units(model: Any) -> list[str]:
    """Unit of the motion of each degree of freedom."""
    return [unit for kind in model.jnt_type for _, unit, _ in _MOTIONS[int(kind)]]


def called(view: Any, kind: str) -> str:
    """An object's kind and name, or number, which counts from 1."""
    return f"{kind} {view.name or view.id + 1}"


def _element(  # noqa: PLR0913 - what a text and names are made of
    unit: str, what: str, view: Any, kind: str, more: str = "", group: str = "", address: str = ""
) -> Element:
    text = f"{what.strip()} of {called(view, kind)}{more}"
    text += f" ({address})" if address[:1] not in ("", ".") else ""
    words = filter(None, (view.name or called(view, kind), group))
    return Element(unit, f"{text[0].upper()}{text[1:]}", "_".join(words))


def _of_joints(model: Any, field: str) -> Iterator[Element]:
    word, derived = _OF_MOTIONS.get(field, ("", "pos"))
    for joint, kind in enumerate(map(int, model.jnt_type)):
        view = model.joint(joint)
        name = model.body(int(view.bodyid[0])).name if kind == FREE else view.name
        for part, unit, short in (_MOTIONS if word else _POSITIONS)[kind]:
            known = _DERIVED[derived](unit) if word else unit
            group = {"quaternion": "quat", "about": "rot"}.get(part.split(" ")[0], "")
            address = f"{name}.{short}" if field in ("qpos", "qvel") else ""
            yield _element(known, f"{word} {part}", view, "joint", "", group, address)


def _of_actuators(model: Any, field: str) -> Iterator[Element]:
    """Controls, forces, lengths of actuators; one without a name has its joint's."""
    word, derived = _OF_ACTUATORS[field]
    number = "actuator_actnum" if field == "act" else "actuator_outnum"
    counts = getattr(model, number, [1] * len(model.actuator_trntype))
    for i, transmission in enumerate(map(int, model.actuator_trntype)):
        view, length, more = model.actuator(i), _actuator_unit(model, i), ""
        if transmission in _ON_JOINTS and not view.name:
            more = f" on {called(model.joint(int(model.actuator_trnid[i, 0])), 'joint')}"
        parts = [("", _DERIVED[derived](length) if derived else "")] * int(counts[i])
        for part, unit, *_ in _controls(model, i, length) if field == "ctrl" else parts:
            group = part.split(" ")[0]
            address = (
                f"{view.name}.{'_'.join(filter(None, (field.rsplit('_', maxsplit=1)[-1], group)))}"
            )
            yield _element(unit, f"{part} {word}", view, "actuator", more, group, address)


def _controls(model: Any, actuator: int, length: str) -> Sequence[tuple[str, ...]]:
    """What the controls of an actuator are, and their units; most have one."""
    gain = int(model.actuator_gaintype[actuator])
    if gain in _SERVOS:  # each kind of control is a bit: mjtCtrlInput
        signature = int(model.actuator_ctrlspec[actuator])
        kinds = (("position", length), ("velocity", _DERIVED["vel"](length)),
                 ("feedforward", _FORCES.get(length, "")), ("voltage", "V"))  # fmt: skip
        return [kind for bit, kind in enumerate(kinds) if signature & 1 << bit]
    if int(model.actuator_trntype[actuator]) == _ON_BALL:
        return _TURNS if int(model.actuator_ctrlnum[actuator]) == len(_TURNS) else _POSE[3:]
    return [("", _unit_of_control(model, actuator, length))]


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


def _joint_unit(model: Any, joint: int) -> str:
    return {HINGE: "rad", SLIDE: "m"}.get(int(model.jnt_type[joint]), "")


def _tendon_unit(model: Any, tendon: int) -> str:
    """Unit of a tendon's length: of one that couples joints, theirs."""
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    if int(model.wrap_type[first]) != int(mujoco.mjtWrap.mjWRAP_JOINT):
        return "m"
    units = {_joint_unit(model, int(i)) for i in model.wrap_objid[first : first + count]}
    return units.pop() if len(units) == 1 else ""


def _actuator_unit(model: Any, actuator: int) -> str:
    """Unit of an actuator's length, by what it acts on; a gear makes it another quantity."""
    transmission, target = int(model.actuator_trntype[actuator]), model.actuator_trnid[actuator, 0]
    if transmission == _ON_BALL:
        return "rad"
    if abs(model.actuator(actuator).gear.flat[0]) != 1.0:
        return ""
    if transmission in _ON_JOINTS:
        return _joint_unit(model, int(target))
    return _tendon_unit(model, int(target)) if transmission == _TENDON else ""


_MOVED: Final = {"joint": _joint_unit, "tendon": _tendon_unit, "actuator": _actuator_unit}


def _kind_of(model: Any, sensor: int) -> str:
    return str(mujoco.mjtSensor(int(model.sensor_type[sensor])).name[7:].lower())


def sensor_text(model: Any, sensor: int) -> str:
    """What a sensor is, and of what: `sensor gyro: gyro of site hand`."""
    kind, i = int(model.sensor_objtype[sensor]), int(model.sensor_objid[sensor])
    name = mujoco.mj_id2name(model, kind, i) if i >= 0 else ""
    of = f" of {mujoco.mju_type2Str(kind)} {name or i + 1}" if i >= 0 else ""
    return f"{called(model.sensor(sensor), 'sensor')}: {_kind_of(model, sensor)}{of}"


def _of_sensor(model: Any, sensor: int) -> list[str]:
    kind = _kind_of(model, sensor)
    size, unit = int(model.sensor_dim[sensor]), _SENSORS.get(kind, "")
    if moved := _OF_MOVED.fullmatch(kind):
        length = _MOVED[moved[1]](model, int(model.sensor_objid[sensor]))
        unit = _DERIVED[moved[2]](length)
    return [unit if kind != "rangefinder" or size == 1 else ""] * size
