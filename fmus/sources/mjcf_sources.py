"""Finds the variables of an FMU in a MuJoCo model, by name.

A source is written as, for instance, `body hand xpos`, `joint elbow qpos`, `sensor gyro`, `ctrl`
or `body hand jacobian`. Looking it up in a model gives the form that the C backend reads (see
`fmus/README.md`), with the model's shape, units and start values.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import chain, count, groupby
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, did_you_mean, refuse
from ..interface.engine import COUNTED
from ..interface.variables import Causality, Part, Variable
from .mjcf_elements import FREE, Element, called, dof_units, elements, sensor_text

Array = NDArray[np.float64]
# Kinds of objects, and the model's field that has a number for each of them.
OBJECTS: Final = {
    "body": "body_parentid", "joint": "jnt_type", "geom": "geom_type", "site": "site_type",
    "sensor": "sensor_type", "actuator": "actuator_trntype", "equality": "eq_type",
    "tendon": "tendon_num", "key": "key_time",
}  # fmt: skip
# Properties of an object that may be changed, as MuJoCo's Python names them. MuJoCo derives nothing
# from them while it compiles.
CHANGEABLE: Final = {
    "joint": ("damping", "armature", "frictionloss"), "geom": ("friction",),
    "actuator": ("gain", "bias"), "equality": ("solref", "solimp", "data"),
}  # fmt: skip
FIRST_OF: Final = {"gain": ("gainprm", 1), "bias": ("biasprm", 3)}  # by length and by velocity, too
# Computed by the acceleration stage: these belong to the last step, not to the new instant.
HELD: Final = ("actuator_force", "qfrc_actuator", "qacc", "qfrc_constraint", "qfrc_inverse")
INPUT_FIELDS: Final = ("ctrl", "qfrc_applied", "xfrc_applied", "mocap_pos", "mocap_quat")
TUNABLE: Final = ("model", "body_mass")  # first word of the sources that may change between steps
OPTIONS: Final = ("gravity", "wind", "magnetic", "density", "viscosity")
# `KIND FIELD FIRST COUNT`: elements of any field.
RAW: Final[Mapping[Causality, Sequence[str]]] = {
    "input": ("data",), "output": ("data", "held", "model"), "parameter": ("model", "added"),
}  # fmt: skip
# Properties of objects that MuJoCo's Python does not name so.
SPECIAL: Final = ("force", "torque", "mocap_pos", "mocap_quat", "active", "jacobian", "mass",
                  "added_mass", "free_xy", "free_yaw", "gain", "bias")  # fmt: skip
# Sums of contact forces, and scales of properties, with their kind of object.
CONTACTS: Final = {"contact_sensors": "sensor", "contact_bodies": "body",
                   "unwanted_contacts": "body", "support_contacts": "body"}  # fmt: skip
SCALED: Final = {"scaled_mass": "body", "scaled_servo": "actuator", "scaled_force": "actuator"}

Units = tuple[str, ...]
_TEXTS: Final = {  # descriptions of sources whose own words say too little
    "gravity": "Acceleration of gravity",
    "keyframe": "Keyframe to start at; controls and poses that are not set are its, too",
}
_POSES: Final = {
    "xpos": "Origin of {}, world frame",
    "xquat": "Orientation of {}, world frame, (w, x, y, z)",
    "xmat": "Rotation matrix of {}, row by row, world frame",
}
_SHOWN = 30  # names of a model in a message
_LISTED = "`panda-cosim mjcf2fmu --help` lists the sources"


class Sources:
    """The sources of a `mujoco.MjModel` at a keyframe, or at qpos0 if it is "".

    Made by who needs variables of a model by their sources; the backend in C reads what `find`
    returns, so nothing here is for a running simulation.
    """

    def __init__(self, model: Any, keyframe: str = "") -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self._elements_of = cache(partial(elements, model))
        self.key = -1  # index of the keyframe
        if keyframe:
            self.key = self.find_id("key", keyframe)
            mujoco.mj_resetDataKeyframe(model, self.data, self.key)

    def find(self, causality: Causality, source: str) -> Variable:
        """Look a source up; a name with spaces stands in quotes."""
        words = words_of(source)
        row = self._found(causality, words)
        if row is None:
            refuse("source", source, self._hint(causality, words))
        text = _TEXTS.get(source, source)
        if words[0] == "sensor":
            text = sensor_text(self.model, self.find_id(*words))
        elif words[0] in OBJECTS:
            owner = called(getattr(self.model, words[0])(self.find_id(*words[:2])), words[0])
            text = _POSES.get(words[2], f"{{}} {' '.join(words[2:])}").format(owner)
        row = replace(row, causality=causality, description=text)
        if causality in ("output", "local"):
            return replace(row, start=None, minimum=None, maximum=None)
        return replace(row, variability="fixed") if causality == "parameter" else row

    def _found(self, causality: Causality, words: Sequence[str]) -> Variable | None:
        match words:
            case [kind, name, *rest] if kind in OBJECTS:
                return self._of_object(causality, kind, self.find_id(kind, name), *rest)
            case [kind, field, first, count] if kind in RAW.get(causality, ()):
                return self._raw(kind, field, first, count)
            case [name, *rest] if name not in OBJECTS:
                return self._of_model(causality, name, *rest)
        return None

    def _is_valid(self, causality: Causality, words: Sequence[str]) -> bool:
        try:
            return self._found(causality, words) is not None
        except InputError:
            return False

    def _hint(self, causality: Causality, words: Sequence[str]) -> str:
        """What is valid instead of a source that does not exist."""
        for other in RAW:
            if self._is_valid(other, words):
                return f"must be an {causality}; it is an {other}"
        match words:
            case [kind, name, *rest] if kind in OBJECTS:
                views = [
                    getattr(holder, kind)(self.find_id(kind, name))
                    for holder in (self.model, self.data)
                    if hasattr(holder, kind)
                ]
                known = {*SPECIAL, *(attribute for view in views for attribute in dir(view))}
                valid = [n for n in sorted(known) if self._is_valid(causality, [kind, name, n])]
                near = did_you_mean(" ".join(rest[:1]), valid)
                return f"valid: {causality} {kind} NAME {' | '.join(valid) or '...'}{near}"
        return f"no such {causality} of a MuJoCo model; {_LISTED}"

    def _of_model(self, causality: Causality, name: str, *names: str) -> Variable | None:
        row: Variable | None = None
        match causality, name, *names:
            case "input", "motors":  # actuators that are not motors ignore their torques
                row = _values("motors 0", np.zeros(self.model.nu), "N.m", is_vector=True)
            case "input", "ctrl":
                row = self._limited(self._elements("data", name))
            case "input", _ if name in INPUT_FIELDS:
                row = self._elements("data", name)
            case "output", "mass_matrix", *joints:
                dofs = self._dofs(joints)
                row = _matrix(_join(name, *dofs), (len(dofs), len(dofs)), ("",) * len(dofs) ** 2)
            case "output", _, *_ if name in CONTACTS:
                row = _values(_join(name, *self._ids(CONTACTS[name], names)), [0.0], "N")
            case "output", _:
                row = self._elements("held" if name in HELD else "data", name)
            case "local", "warnings":
                row = COUNTED
            case "parameter", "scene":
                row = _values(name, [1.0], "")
            case "parameter", "keyframe":
                keys = (self.model.key(i).name or f"key_{i + 1}" for i in range(self.model.nkey))
                choices = ("qpos0", *keys)
                row = replace(_values(name, [1.0], ""), start=choices[self.key + 1],
                               kind="Enumeration", choices=choices)  # fmt: skip
            case "parameter", _ if name in OPTIONS:
                row = self._elements("model", name)
            case "parameter", "qpos" | "qvel":
                row = _at_start(self._elements("data", name))
            case "parameter", _, *_ if name in SCALED:
                ids = self._ids(SCALED[name], names)
                scales = _values(_join(name, *ids), np.ones(len(ids)), "1", is_vector=True)
                row = replace(scales, minimum=(0.0,) * len(ids))
        return row

    def _of_object(
        self, causality: Causality, kind: str, i: int, what: str = "", *more: str
    ) -> Variable | None:
        row: Variable | None = None
        match causality, kind, what, *more:
            case "output", "body" | "geom" | "site", "jacobian", *joints:
                row = self._jacobian(kind, i, joints)
            case "output", "sensor", "":
                late = int(self.model.sensor_needstage[i]) == int(mujoco.mjtStage.mjSTAGE_ACC)
                row = self._property("held" if late else "data", kind, i, "data")
            case "output", _, _:
                row = self._property("data", kind, i, what)
            case "input", "actuator", "ctrl":
                row = self._property("data", kind, i, what)
                row = row and self._limited(row)
            case "input", "equality", "active":
                is_active = bool(self.data.eq_active[i])
                row = Variable("", (), "", "input", "discrete", "", is_active, kind="Boolean",
                               source=f"eq_active {i}")  # fmt: skip
            case "input", "body", "force" | "torque":
                row = self._elements("data", "xfrc_applied", 6 * i + 3 * (what == "torque"), 3)
            case "input", "body", "mocap_pos" | "mocap_quat" if self.model.body_mocapid[i] >= 0:
                width = 3 if what == "mocap_pos" else 4
                row = self._elements("data", what, width * self.model.body_mocapid[i], width)
            case "parameter", "body", "free_xy" | "free_yaw", *flags:
                row = self._free(i, what, flags)
            case "parameter", "body", "mass":
                mass = self._elements("model", "body_mass", i, 1)
                row = replace(mass, source=f"body_mass {i}", minimum=(1e-12,))
            case "parameter", "body", "added_mass":
                mass = self._elements("added", "body_mass", i, 1)
                row = replace(mass, start=(0.0,), minimum=(0.0,))
            case "parameter", "joint", "qpos" | "qvel":
                row = self._property("data", kind, i, what)
                row = row and _at_start(row)
            case "parameter", _, _ if what in CHANGEABLE.get(kind, ()):
                row = self._property("model", kind, i, *FIRST_OF.get(what, (what,)))
        return row

    # Elements of fields.

    def _elements(
        self, kind: str, field: str, first: int = 0, count: int | None = None
    ) -> Variable:
        """Elements of a field; all from the first on, if there is no count."""
        values = self._array(kind, field)
        if not values.size:
            raise InputError(f"source {field!r}: this model has no {field}")
        part = slice(first, None if count is None else first + count)
        whole = self._elements_of(field, values.size)[part]  # all at once, each time the same
        texts = tuple(element.text for element in whole)
        row = _values(f"{kind} {field} {first}", values[part], tuple(e.unit for e in whole))
        return replace(row, details=texts if any(texts) else (), parts=_parts(whole))

    def _property(
        self, kind: str, of: str, i: int, what: str, count: int | None = None
    ) -> Variable | None:
        """A property of an object, which MuJoCo's Python shows as a view of a field."""
        holder = self.model if kind == "model" else self.data
        view = getattr(getattr(holder, of)(i), what, None) if hasattr(holder, of) else None
        if not isinstance(view, np.ndarray):
            return None
        for field in dir(holder):
            whole = getattr(holder, field)
            if isinstance(whole, np.ndarray) and np.may_share_memory(whole, view):
                first = (view.ctypes.data - whole.ctypes.data) // whole.itemsize
                kind = "held" if field in HELD else kind
                return self._elements(kind, field, first, count or view.size)
        return None

    def _array(self, kind: str, name: str) -> Array:
        holder = self.data if kind in ("data", "held") else self.model
        if name in OPTIONS and holder is self.model:
            return np.atleast_1d(getattr(self.model.opt, name))
        values = getattr(holder, name, None) if name.isidentifier() else None
        if not isinstance(values, np.ndarray) or values.dtype != np.float64:
            kind = type(holder).__name__.lstrip("_")
            must = f"must be a field of {kind}, of float64; {_LISTED}"
            refuse("source", name, must, [n for n in dir(holder) if not n.startswith("_")])
        return np.ravel(values)

    def _raw(self, kind: str, field: str, first: str, count: str) -> Variable | None:
        if not (first + count).isdecimal() or not (first + count).isascii():
            return None
        size = self._array(kind, field).size
        if not 1 <= int(count) <= size - int(first):
            words = _join(kind, field, first, count)
            raise InputError(f"source {words!r}: {field} has {size} elements")
        row = self._elements(kind, field, int(first), int(count))
        return replace(row, start=(0.0,) * row.size) if kind == "added" else row

    def _limited(self, ctrl: Variable) -> Variable:
        """Controls within their ranges, to which MuJoCo clamps them."""
        first = int(ctrl.source.split()[2])
        controls = slice(first, first + ctrl.size)
        is_clamped = not self.model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        limited = is_clamped & (self.model.actuator_ctrllimited[controls, None] == 1)
        low, high = np.where(limited, self.model.actuator_ctrlrange[controls], (-np.inf, np.inf)).T
        start = tuple(np.clip(np.asarray(ctrl.start), low, high).tolist())
        return replace(ctrl, start=start, minimum=tuple(low.tolist()), maximum=tuple(high.tolist()))

    # What is computed of objects.

    def _free(self, body: int, what: str, flags: Sequence[str]) -> Variable:
        joint = int(self.model.body_jntadr[body])
        if joint < 0 or int(self.model.jnt_type[joint]) != FREE:
            raise InputError(f"body {self.model.body(body).name!r}: has no free joint")
        if what == "free_yaw":
            return _values(f"free_yaw {body}", [0.0], "rad")
        words = _join(what, body, *self._start_rule(flags))
        return _values(words, self.data.joint(joint).qpos[:2], "m")

    def _start_rule(self, flags: Sequence[str]) -> list[object]:
        """`[clear] [stand [GEOM...]]`, with the geoms' ids."""
        match flags:
            case ["clear", "stand", *ground] | ["stand", *ground]:
                return [*flags[: len(flags) - len(ground)], *self._ids("geom", ground)]
            case [] | ["clear"]:
                return [*flags]
        raise InputError(f"start rule {' '.join(flags)!r}; valid: [clear] [stand [GEOM...]]")

    def _jacobian(self, kind: str, i: int, joints: Sequence[str]) -> Variable:
        dofs, by_dof = self._dofs(joints), dof_units(self.model)
        linear = ["m/rad" if by_dof[dof] == "rad" else "1" for dof in dofs]
        angular = ["1" if by_dof[dof] == "rad" else "rad/m" for dof in dofs]
        units = (*linear * 3, *angular * 3)
        return _matrix(_join("jac", kind, i, *dofs), (6, len(dofs)), units)

    def _dofs(self, joints: Sequence[str]) -> list[int]:
        """Degrees of freedom of the named joints; of all joints if none is named."""
        if not joints:
            return list(range(self.model.nv))
        views = [self.model.joint(i) for i in self._ids("joint", joints)]
        return [int(view.dofadr[0]) + k for view in views for k in range(view.damping.size)]

    # Names.

    def _ids(self, kind: str, names: Sequence[str]) -> list[int]:
        return [self.find_id(kind, name) for name in names]

    def find_id(self, kind: str, name: str) -> int:
        """Return the id of an object by its name, or as `#2` by its number."""
        number = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
        i = int(mujoco.mj_name2id(self.model, number, name))
        if i >= 0:
            return i
        numbers = [f"#{n + 1}" for n in range(len(getattr(self.model, OBJECTS[kind])))]
        if name not in numbers:
            valid = self.names(kind)
            listed = ", ".join(valid[:_SHOWN]) or "none"
            refuse("keyframe" if kind == "key" else kind, name, f"the model has {listed}", valid)
        return numbers.index(name)

    def free_bodies(self) -> list[str]:
        """Names of the bodies with a free joint that have one."""
        free = self.model.jnt_bodyid[self.model.jnt_type == FREE]
        return [name for name in (self.model.body(int(i)).name for i in free) if name]

    def names(self, kind: str) -> list[str]:
        """Names of all objects of a kind that have a name."""
        ids = range(len(getattr(self.model, OBJECTS[kind])))
        return [name for i in ids if (name := getattr(self.model, kind)(i).name)]


def words_of(source: str) -> list[str]:
    """Split a source into words; a name with spaces stands in quotes."""
    try:
        return shlex.split(source)
    except ValueError as error:
        raise InputError(
            f"source {source!r}: a quotation mark or a character is missing"
        ) from error


def _at_start(row: Variable) -> Variable:
    """Positions or velocities of the start, instead of those of an instant."""
    return replace(row, source=row.source.removeprefix("data "), details=(), parts=())


def _parts(whole: Sequence[Element]) -> tuple[Part, ...]:
    """Arrays of one unit each, by joint or actuator, to be named after the variable."""
    if len({element.unit for element in whole}) == 1 or not all(each.group for each in whole):
        return ()
    parts: dict[str, Part] = {}
    for group, each in groupby(whole, lambda element: element.group):
        name = unique(parts, re.sub(r"\W+", "_", group, flags=re.A))
        parts[name] = (name, len(list(each)), "")
    return tuple(parts.values())


def unique(taken: Collection[str], *names: str) -> str:
    """The first of these names that is not taken; if all are, one with a number."""
    numbered = (f"{names[0]}_{i}" for i in count(2))
    return next(name for name in chain(names, numbered) if name not in taken)


def _matrix(source: str, shape: tuple[int, ...], units: Units) -> Variable:
    return Variable("", shape, units, "output", "continuous", "", source=source)


def _values(source: str, values: Any, units: str | Units, *, is_vector: bool = False) -> Variable:
    """Values of the model as a vector, or as a scalar if there is only one."""
    start = tuple(float(value) for value in values)
    each = (units,) * len(start) if isinstance(units, str) else units
    shape = (len(start),) if is_vector or len(start) > 1 else ()
    return Variable("", shape, each, "output", "continuous", "", start, source=source)


def _join(*words: object) -> str:
    return " ".join(map(str, words))
