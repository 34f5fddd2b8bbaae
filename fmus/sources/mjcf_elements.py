"""What each element of MuJoCo's fields is: a part of which object, and in which unit."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import mujoco

Part = tuple[str, str, str]  # of a joint's position or motion: words, unit, and the short name
FREE, BALL, SLIDE, HINGE = range(4)  # mjtJoint
_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_POSITIONS: Final[Sequence[Sequence[Part]]] = list(_TABLES["positions"].values())
_MOTIONS: Final[Sequence[Sequence[Part]]] = list(_TABLES["motions"].values())
_OF_JOINTS: Final[Mapping[str, tuple[str, str]]] = {"qpos": ("", "pos")} | _TABLES["joints"]
_GROUPS: Final = {"quaternion": "quat", "about": "rot"}  # by a part's first word
# Sensors of what moves, such as `jointpos`, `tendonlimitvel` or `actuatorfrc`.
_OF_MOVED: Final = re.compile(r"(joint|tendon|actuator)(?:limit|act)?(pos|vel|frc)")
# MuJoCo's numbers of the kinds of actuators; older versions lack some.
_ON_JOINTS: Final = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_ON_BALL: Final = int(getattr(mujoco.mjtTrn, "mjTRN_SO3", -1))
_SERVOS: Final = tuple(int(getattr(mujoco.mjtGain, f"mjGAIN_{n}", -1)) for n in ("PID", "DCMOTOR"))
# Those whose force follows the control, perhaps filtered.
_FOLLOWING: Final = [int(getattr(mujoco.mjtDyn, f"mjDYN_{name}"))
                     for name in ("NONE", "FILTER", "FILTEREXACT")]  # fmt: skip


class Element(NamedTuple):
    """One number of a field."""

    unit: str  # "" if it is not known
    text: str = ""  # what it is; "": its variable's own description says it
    group: str = ""  # of elements of one unit: the name of the joint, actuator or tendon


def elements(model: Any, field: str, size: int) -> Sequence[Element]:
    """What the elements of a field of mjData or mjModel are."""
    if field in _OF_JOINTS:
        return list(_of_joints(model, field))
    if field in _TABLES["actuators"]:
        return list(_of_actuators(model, field))
    if field in _TABLES["tendons"]:
        return [_of_tendon(model, field, tendon) for tendon in range(size)]
    if field == "sensordata":
        return [Element(unit) for i in range(model.nsensor) for unit in _of_sensor(model, i)]
    pattern = _TABLES["fields"].get(field, ("",))
    return [Element(pattern[i % len(pattern)]) for i in range(size)]


def dof_units(model: Any) -> list[str]:
    """Unit of the motion of each degree of freedom."""
    return [unit for kind in model.jnt_type for _, unit, _ in _MOTIONS[int(kind)]]


def called(view: Any, kind: str) -> str:
    """An object's kind and name, or number, which counts from 1."""
    return f"{kind} {view.name or view.id + 1}"


def _derived(what: str, unit: str) -> str:
    """Unit of what is derived from a length or an angle, such as `vel`; "" if it is not known."""
    return str(_TABLES["derived"].get(unit, {}).get(what, ""))


def _element(  # noqa: PLR0913 - what a text and names are made of
    unit: str, what: str, view: Any, kind: str, more: str = "", group: str = "", address: str = ""
) -> Element:
    text = f"{what.strip()} of {called(view, kind)}{more}"
    text += f" ({address})" if address[:1] not in ("", ".") else ""
    words = filter(None, (view.name or called(view, kind), group))
    return Element(unit, f"{text[0].upper()}{text[1:]}", "_".join(words))


def _of_joints(model: Any, field: str) -> Iterator[Element]:
    word, derived = _OF_JOINTS[field]
    for joint, kind in enumerate(map(int, model.jnt_type)):
        view = model.joint(joint)
        name = model.body(int(view.bodyid[0])).name if kind == FREE else view.name
        for part, unit, short in (_MOTIONS if word else _POSITIONS)[kind]:
            known = _derived(derived, unit) if word else unit
            address = f"{name}.{short}" if field in ("qpos", "qvel") else ""
            group = _GROUPS.get(part.split(" ")[0], "")
            yield _element(known, f"{word} {part}", view, "joint", "", group, address)


def _of_tendon(model: Any, field: str, tendon: int) -> Element:
    (what, derived), view = _TABLES["tendons"][field], model.tendon(tendon)
    unit = _derived(derived, _tendon_unit(model, tendon))
    return _element(unit, what, view, "tendon", address=f"{view.name}.{what}")


def _of_actuators(model: Any, field: str) -> Iterator[Element]:
    """Controls, forces, lengths of actuators; one without a name has its joint's."""
    word, derived = _TABLES["actuators"][field]
    number = "actuator_actnum" if field == "act" else "actuator_outnum"
    counts = getattr(model, number, [1] * len(model.actuator_trntype))
    for i, transmission in enumerate(map(int, model.actuator_trntype)):
        view, length, more = model.actuator(i), _actuator_unit(model, i), ""
        if transmission in _ON_JOINTS and not view.name:
            more = f" on {called(model.joint(int(model.actuator_trnid[i, 0])), 'joint')}"
        parts = [("", _derived(derived, length))] * int(counts[i])
        for part, unit in _controls(model, i, length) if field == "ctrl" else parts:
            group = part.split(" ")[0]
            short = "_".join(filter(None, (field.rpartition("_")[2], group)))
            address = f"{view.name}.{short}"
            yield _element(unit, f"{part} {word}", view, "actuator", more, group, address)


def _controls(model: Any, actuator: int, length: str) -> Sequence[tuple[str, str]]:
    """What the controls of an actuator are, and their units; most have one."""
    gain = int(model.actuator_gaintype[actuator])
    if gain in _SERVOS:  # each kind of control is a bit: mjtCtrlInput
        signature = int(model.actuator_ctrlspec[actuator])
        kinds = (("position", length), ("velocity", _derived("vel", length)),
                 ("feedforward", _derived("frc", length)), ("voltage", "V"))  # fmt: skip
        return [kind for bit, kind in enumerate(kinds) if signature & 1 << bit]
    if int(model.actuator_trntype[actuator]) == _ON_BALL:
        turns = int(model.actuator_ctrlnum[actuator]) == len(_MOTIONS[BALL])
        return [(words, unit) for words, unit, _ in (_MOTIONS if turns else _POSITIONS)[BALL]]
    return [("", _unit_of_control(model, actuator, length))]


def _unit_of_control(model: Any, actuator: int, length: str) -> str:
    """Unit of a motor's force, or of a servo's position or velocity; "" of anything else."""
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    follows = model.actuator_dyntype[actuator] in _FOLLOWING
    is_fixed = int(model.actuator_gaintype[actuator]) == mujoco.mjtGain.mjGAIN_FIXED
    if not (length and follows and is_fixed):
        return ""
    if int(model.actuator_biastype[actuator]) == mujoco.mjtBias.mjBIAS_NONE:
        return _derived("frc", length) if gain[0] == 1.0 else ""
    if bias[0] == 0.0 and bias[1] == -gain[0]:
        return length
    return _derived("vel", length) if not bias[:2].any() and bias[2] == -gain[0] else ""


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
    return _tendon_unit(model, int(target)) if transmission == mujoco.mjtTrn.mjTRN_TENDON else ""


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
    size, unit = int(model.sensor_dim[sensor]), str(_TABLES["sensors"].get(kind, ""))
    if moved := _OF_MOVED.fullmatch(kind):
        length = _MOVED[moved[1]](model, int(model.sensor_objid[sensor]))
        unit = _derived(moved[2], length)
    return [unit if kind != "rangefinder" or size == 1 else ""] * size
