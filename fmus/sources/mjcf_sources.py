"""Finds the variables of an FMU in a MuJoCo model, by name.

A source is written as, for instance, `body hand xpos`, `joint elbow qpos`, `sensor gyro`, `ctrl`
or `body hand jacobian`. Looking it up in a model gives the form that the C backend reads (see
`fmus/README.md`), with the model's shape, units and start values.
"""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from itertools import chain, count, groupby, product
from pathlib import Path
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, did_you_mean, refuse
from ..interface.engine import COUNTED
from ..interface.variables import Causality, Part, Variable
from .mjcf_elements import FREE, Element, called, dof_units, elements, sensor_text

Array = NDArray[np.float64]
_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
OBJECTS: Final[Mapping[str, str]] = _TABLES["objects"]
CONTACTS: Final[Mapping[str, str]] = _TABLES["contacts"]
SCALED: Final[Mapping[str, str]] = _TABLES["scaled"]
CHANGEABLE: Final[Sequence[tuple[str, str]]] = _TABLES["changeable"]
FIRST_OF: Final = {"gain": ("gainprm", 1), "bias": ("biasprm", 3)}  # by length and by velocity, too
# Computed by the acceleration stage: these belong to the last step, not to the new instant.
HELD: Final = ("actuator_force", "qfrc_actuator", "qacc", "qfrc_constraint", "qfrc_inverse")
INPUT_FIELDS: Final = ("ctrl", "qfrc_applied", "xfrc_applied", "mocap_pos", "mocap_quat")
TUNABLE: Final = ("model", "body_mass")  # first word of the sources that may change between steps
OPTIONS: Final = ("gravity", "wind", "magnetic", "density", "viscosity")
# `KIND FIELD FIRST COUNT`: elements of any field.
RAW: Final[Mapping[Causality, Sequence[str]]] = _TABLES["raw"]
# Sources whose further words name objects, or say how a block starts.
LISTING: Final = ("mass_matrix", "jacobian", "free_xy", "free_yaw", *CONTACTS, *SCALED)

Units = tuple[str, ...]
_SHOWN = 30  # names of a model in a message
_LISTED = "`panda-cosim mjcf2fmu --help` lists the sources"


class Words(NamedTuple):
    """The words of a source, such as `body hand jacobian joint1`."""

    kind: str  # of the object; "": of the whole model
    i: int  # its id
    what: str
    more: Sequence[str] = ()


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
        row = replace(row, causality=causality, description=self._text(source, words))
        if causality in ("output", "local"):
            return replace(row, start=None, minimum=None, maximum=None)
        return replace(row, variability="fixed") if causality == "parameter" else row

    def _text(self, source: str, words: Sequence[str]) -> str:
        """What a source is, for people."""
        kind = words[0]
        if kind not in OBJECTS:
            return str(_TABLES["texts"].get(source, source))
        i = self.find_id(*words[:2])
        if kind == "sensor":
            return sensor_text(self.model, i)
        form = _TABLES["poses"].get(words[2], f"{{}} {' '.join(words[2:])}")
        return str(form).format(called(getattr(self.model, kind)(i), kind))

    def _found(self, causality: Causality, words: Sequence[str]) -> Variable | None:
        match words:
            case [kind, field, first, count] if kind in RAW.get(causality, ()):
                return self._raw(kind, field, first, count)
            case [kind, name, *rest] if kind in OBJECTS:
                what, *more = rest or [""]
                return self._of(causality, Words(kind, self.find_id(kind, name), what, more))
            case [what, *more] if what not in OBJECTS:
                return self._of(causality, Words("", -1, what, more))
        return None

    def _of(self, causality: Causality, words: Words) -> Variable | None:
        """A source of an object or of the whole model; as an output, whatever MuJoCo has."""
        find = _RULES.get((causality, words.kind, words.what))
        if words.more and (find is None or words.what not in LISTING):
            return None
        if find is None and causality == "output":
            find = Sources._whole
        return find and find(self, words)

    def _is_valid(self, causality: Causality, words: Sequence[str]) -> bool:
        with suppress(InputError):
            return self._found(causality, words) is not None
        return False

    def _hint(self, causality: Causality, words: Sequence[str]) -> str:
        """What is valid instead of a source that does not exist."""
        for other in RAW:
            if self._is_valid(other, words):
                return f"must be an {causality}; it is an {other}"
        if len(words) < 2 or words[0] not in OBJECTS:
            return f"no such {causality} of a MuJoCo model; {_LISTED}"
        kind, name, *rest = words
        views = (getattr(holder, kind, None) for holder in (self.model, self.data))
        shown = [dir(view(self.find_id(kind, name))) for view in views if view]
        known = {what for _, _, what in _RULES if what}.union(*shown)
        valid = [n for n in sorted(known) if self._is_valid(causality, [kind, name, n])]
        near = did_you_mean(" ".join(rest[:1]), valid)
        return f"valid: {causality} {kind} NAME {' | '.join(valid) or '...'}{near}"

    # Elements of fields.

    def _whole(self, words: Words) -> Variable | None:
        """A field of mjData, or what an object has of one."""
        if words.kind:
            return self._property("data", words.kind, words.i, words.what)
        return self._elements("held" if words.what in HELD else "data", words.what)

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
        values = getattr(holder, name, None)
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

    def _limited(self, words: Words) -> Variable | None:
        """Controls within their ranges, to which MuJoCo clamps them."""
        ctrl = self._whole(words)
        if ctrl is None:
            return None
        first = int(ctrl.source.split()[2])
        controls = slice(first, first + ctrl.size)
        is_clamped = not self.model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        limited = is_clamped & (self.model.actuator_ctrllimited[controls, None] == 1)
        low, high = np.where(limited, self.model.actuator_ctrlrange[controls], (-np.inf, np.inf)).T
        start = tuple(np.clip(np.asarray(ctrl.start), low, high).tolist())
        return replace(ctrl, start=start, minimum=tuple(low.tolist()), maximum=tuple(high.tolist()))

    def _at_start(self, words: Words) -> Variable | None:
        """Positions or velocities of the start, instead of those of an instant."""
        row = self._whole(words)
        return row and replace(row, source=row.source.removeprefix("data "), details=(), parts=())

    def _changed(self, words: Words) -> Variable | None:
        return self._property(
            "model", words.kind, words.i, *FIRST_OF.get(words.what, (words.what,))
        )

    # What is computed of the model or of objects.

    def _keyframe(self, words: Words) -> Variable:
        keys = (self.model.key(i).name or f"key_{i + 1}" for i in range(self.model.nkey))
        choices = ("qpos0", *keys)
        return replace(_values(words.what, [1.0], ""), start=choices[self.key + 1],
                       kind="Enumeration", choices=choices)  # fmt: skip

    def _mass_matrix(self, words: Words) -> Variable:
        dofs = self._dofs(words.more)
        return _matrix(_join(words.what, *dofs), (len(dofs), len(dofs)), ("",) * len(dofs) ** 2)

    def _contacts(self, words: Words) -> Variable:
        return _values(_join(words.what, *self._ids(CONTACTS[words.what], words.more)), [0.0], "N")

    def _scales(self, words: Words) -> Variable:
        ids = self._ids(SCALED[words.what], words.more)
        scales = _values(_join(words.what, *ids), np.ones(len(ids)), "1", is_vector=True)
        return replace(scales, minimum=(0.0,) * len(ids))

    def _sensor(self, words: Words) -> Variable | None:
        late = int(self.model.sensor_needstage[words.i]) == int(mujoco.mjtStage.mjSTAGE_ACC)
        return self._property("held" if late else "data", words.kind, words.i, "data")

    def _active(self, words: Words) -> Variable:
        return Variable("", (), "", "input", "discrete", "", bool(self.data.eq_active[words.i]),
                        kind="Boolean", source=f"eq_active {words.i}")  # fmt: skip

    def _push(self, words: Words) -> Variable:
        return self._elements("data", "xfrc_applied", 6 * words.i + 3 * (words.what == "torque"), 3)

    def _mocap(self, words: Words) -> Variable | None:
        mocap, width = int(self.model.body_mocapid[words.i]), 3 if words.what == "mocap_pos" else 4
        return self._elements("data", words.what, width * mocap, width) if mocap >= 0 else None

    def _mass(self, words: Words) -> Variable:
        mass = self._elements("model", "body_mass", words.i, 1)
        return replace(mass, source=f"body_mass {words.i}", minimum=(1e-12,))

    def _added_mass(self, words: Words) -> Variable:
        mass = self._elements("added", "body_mass", words.i, 1)
        return replace(mass, start=(0.0,), minimum=(0.0,))

    def _free(self, words: Words) -> Variable:
        joint = int(self.model.body_jntadr[words.i])
        if joint < 0 or int(self.model.jnt_type[joint]) != FREE:
            raise InputError(f"body {self.model.body(words.i).name!r}: has no free joint")
        if words.what == "free_yaw":
            return _values(f"free_yaw {words.i}", [0.0], "rad")
        source = _join(words.what, words.i, *self._start_rule(words.more))
        return _values(source, self.data.joint(joint).qpos[:2], "m")

    def _start_rule(self, flags: Sequence[str]) -> list[object]:
        """`[clear] [stand [GEOM...]]`, with the geoms' ids."""
        match flags:
            case ["clear", "stand", *ground] | ["stand", *ground]:
                return [*flags[: len(flags) - len(ground)], *self._ids("geom", ground)]
            case [] | ["clear"]:
                return [*flags]
        raise InputError(f"start rule {' '.join(flags)!r}; valid: [clear] [stand [GEOM...]]")

    def _jacobian(self, words: Words) -> Variable:
        dofs, by_dof = self._dofs(words.more), dof_units(self.model)
        linear = ["m/rad" if by_dof[dof] == "rad" else "1" for dof in dofs]
        angular = ["1" if by_dof[dof] == "rad" else "rad/m" for dof in dofs]
        units = (*linear * 3, *angular * 3)
        return _matrix(_join("jac", words.kind, words.i, *dofs), (6, len(dofs)), units)

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


# By causality, kind of object ("": the whole model) and word.
_RULES: Final[Mapping[tuple[Causality, str, str], Callable[[Sources, Words], Variable | None]]] = {
    # Actuators that are not motors ignore their torques.
    ("input", "", "motors"): lambda s, _: _values(
        "motors 0", np.zeros(s.model.nu), "N.m", is_vector=True
    ),
    **{("input", "", field): Sources._whole for field in INPUT_FIELDS},
    **{("input", kind, "ctrl"): Sources._limited for kind in ("", "actuator")},
    ("input", "equality", "active"): Sources._active,
    **{("input", "body", what): Sources._push for what in ("force", "torque")},
    **{("input", "body", what): Sources._mocap for what in ("mocap_pos", "mocap_quat")},
    ("output", "", "mass_matrix"): Sources._mass_matrix,
    **{("output", "", contacts): Sources._contacts for contacts in CONTACTS},
    **{("output", kind, "jacobian"): Sources._jacobian for kind in ("body", "geom", "site")},
    ("output", "sensor", ""): Sources._sensor,
    ("local", "", "warnings"): lambda *_: COUNTED,
    ("parameter", "", "scene"): lambda _, words: _values(words.what, [1.0], ""),
    ("parameter", "", "keyframe"): Sources._keyframe,
    **{("parameter", "", n): lambda s, words: s._elements("model", words.what) for n in OPTIONS},
    **{("parameter", *at): Sources._at_start for at in product(("", "joint"), ("qpos", "qvel"))},
    **{("parameter", "", scaled): Sources._scales for scaled in SCALED},
    **{("parameter", "body", what): Sources._free for what in ("free_xy", "free_yaw")},
    ("parameter", "body", "mass"): Sources._mass,
    ("parameter", "body", "added_mass"): Sources._added_mass,
    **{("parameter", *place): Sources._changed for place in CHANGEABLE},
}


def words_of(source: str) -> list[str]:
    """Split a source into words; a name with spaces stands in quotes."""
    try:
        return shlex.split(source)
    except ValueError as error:
        raise InputError(
            f"source {source!r}: a quotation mark or a character is missing"
        ) from error


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
