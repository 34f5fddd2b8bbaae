"""Finds the variables of an FMU in a MuJoCo model, by name.

A source is written as, for instance, `body hand xpos`, `joint elbow qpos`, `sensor gyro`, `ctrl`
or `body hand jacobian`. Looking it up in a model gives the form that the C backend reads (see
`fmus/native/README.md`), with the model's shape, units and start values.
"""

from __future__ import annotations

import shlex
from dataclasses import replace
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..interface.variables import Causality, Variable
from ..messages import did_you_mean

Array = NDArray[np.float64]
OBJECTS: Final = {
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "sensor": mujoco.mjtObj.mjOBJ_SENSOR,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
}
# Fields of mjData by an object's property, with the numbers per object and their unit.
POSES: Final = {
    ("body", "xpos"): ("xpos", 3, "m"),
    ("body", "xquat"): ("xquat", 4, "1"),
    ("body", "xmat"): ("xmat", 9, "1"),
    ("body", "xipos"): ("xipos", 3, "m"),
    ("body", "subtree_com"): ("subtree_com", 3, "m"),
    ("geom", "xpos"): ("geom_xpos", 3, "m"),
    ("geom", "xmat"): ("geom_xmat", 9, "1"),
    ("site", "xpos"): ("site_xpos", 3, "m"),
    ("site", "xmat"): ("site_xmat", 9, "1"),
}
# Computed by the acceleration stage: these belong to the last step, not to the new instant.
HELD: Final = ("actuator_force", "qfrc_actuator", "qacc", "qfrc_constraint", "qfrc_inverse")
INPUT_FIELDS: Final = ("ctrl", "qfrc_applied", "xfrc_applied", "mocap_pos", "mocap_quat")
TUNABLE: Final = ("model", "body_mass")  # first word of the sources that may change between steps
OPTIONS: Final = {"gravity": "m/s2", "wind": "m/s", "magnetic": "", "density": "", "viscosity": ""}
# Outputs of contact forces, and their kind of object.
CONTACTS: Final = {"contact_sensors": "sensor", "contact_bodies": "body",
                   "unwanted_contacts": "body", "support_contacts": "body"}  # fmt: skip
# Parameters that scale properties, and their kind of object.
SCALED: Final = {"scaled_mass": "body", "scaled_servo": "actuator", "scaled_force": "actuator"}

Units = tuple[str, ...]
FREE: Final = 0  # mjtJoint
_HINGE, _SLIDE, _BALL = 3, 2, 1
_QPOS: Final = {_HINGE: ("rad",), _SLIDE: ("m",), _BALL: ("1",) * 4, FREE: (*"mmm", *"1111")}
_DOF: Final = {_HINGE: ("rad",), _SLIDE: ("m",), _BALL: ("rad",) * 3, FREE: (*"mmm", *["rad"] * 3)}
_FORCE: Final = {"rad": "N.m", "m": "N"}
_FIELDS: Final = {"mocap_pos": "m", "mocap_quat": "1", "xpos": "m", "xquat": "1", "site_xpos": "m"}
_SENSORS: Final = {
    "touch": "N", "accelerometer": "m/s2", "velocimeter": "m/s", "gyro": "rad/s", "force": "N",
    "torque": "N.m", "rangefinder": "m", "tendonpos": "m", "tendonvel": "m/s", "ballquat": "1",
    "ballangvel": "rad/s", "framepos": "m", "framequat": "1", "framexaxis": "1",
    "frameyaxis": "1", "framezaxis": "1", "framelinvel": "m/s", "frameangvel": "rad/s",
    "framelinacc": "m/s2", "frameangacc": "rad/s2", "subtreecom": "m", "subtreelinvel": "m/s",
}  # fmt: skip

_SHOWN = 30  # names of a model in a message
_LISTED = "`panda-cosim mjcf2fmu --help` lists the sources"


class Sources:
    """The sources of a `mujoco.MjModel`, at the index of a keyframe, or -1."""

    def __init__(self, model: Any, key: int = -1) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        if key >= 0:
            mujoco.mj_resetDataKeyframe(model, self.data, key)
        self._units = ModelUnits(model)

    def find(self, causality: Causality, source: str) -> Variable:
        """Look a source up; a name with spaces stands in quotes."""
        words = words_of(source)
        row = None
        if words and words[0] in OBJECTS:
            row = self._object(causality, words)
        elif words:
            row = getattr(self, f"_{causality}")(words)
        if row is None:
            raise InputError(f"source {source!r}: no such {causality} of a MuJoCo model; {_LISTED}")
        row = replace(row, causality=causality, description=source)
        if causality == "output":
            return replace(row, start=None, minimum=None, maximum=None)
        return replace(row, variability="fixed") if causality == "parameter" else row

    # Sources of the whole model.

    def _input(self, words: list[str]) -> Variable | None:
        if words == ["motors"]:
            return self._motors()
        if words[0] not in INPUT_FIELDS or len(words) > 1:
            return self._raw("data", words)
        field = self._field("data", words[0])
        if words[0] != "ctrl":
            return field
        low, high = zip(*map(self._limits, range(self.model.nu)), strict=True)
        return replace(field, minimum=low, maximum=high)

    def _motors(self) -> Variable:
        """Torques of all actuators; those that are not motors ignore theirs."""
        count = int(self.model.nu)
        return _row("motors 0", (count,), ("N.m",) * count, (0.0,) * count)

    def _output(self, words: list[str]) -> Variable | None:
        name, *rest = words
        if name == "mass_matrix":
            dofs = self._dofs(rest)
            return _row(_join(name, *dofs), (len(dofs), len(dofs)), ("",) * len(dofs) ** 2)
        if name in CONTACTS:
            ids = [self.find_id(CONTACTS[name], one) for one in rest]
            return _row(_join(name, *ids), (), ("N",))
        if name in ("data", "held", "model"):
            return self._raw(name, words)
        return self._field("held" if name in HELD else "data", name) if not rest else None

    def _parameter(self, words: list[str]) -> Variable | None:
        name, *rest = words
        if words == ["scene"]:
            return _row("scene", (), ("",), (1.0,))
        if name in OPTIONS and not rest:
            values = np.atleast_1d(getattr(self.model.opt, name))
            return _values(f"model {name} 0", values, (OPTIONS[name],) * values.size)
        if name in ("qpos", "qvel") and not rest:
            return replace(self._field("data", name), source=f"{name} 0")
        if name in SCALED and rest:
            ids = [self.find_id(SCALED[name], one) for one in rest]
            ones = (1.0,) * len(ids)
            return _row(_join(name, *ids), (len(ids),), ("1",) * len(ids), ones, (0.0,) * len(ids))
        if name == "added":
            row = self._raw(name, words)
            return row and replace(row, start=(0.0,) * row.size)
        return self._raw("model", words)

    def _raw(self, kind: str, words: list[str]) -> Variable | None:
        """`data FIELD FIRST COUNT`, or `model` or `added` in place of `data`."""
        numbers = "".join(words[2:])
        if len(words) != 4 or words[0] != kind or not (numbers.isascii() and numbers.isdigit()):
            return None
        holder = self.data if kind == "data" else self.model
        values = np.ravel(self._array(holder, words[1]))
        first, count = int(words[2]), int(words[3])
        if not 1 <= count <= values.size - first:
            raise InputError(f"source {' '.join(words)!r}: {words[1]} has {values.size} elements")
        return _values(_join(*words[:3]), values[first : first + count], ("",) * count)

    def _field(self, kind: str, name: str) -> Variable:
        values = np.ravel(self._array(self.data, name))
        if not values.size:
            raise InputError(f"source {name!r}: this model has no {name}")
        return _values(f"{kind} {name} 0", values, self._units.field(name, values.size))

    def _array(self, holder: Any, name: str) -> Array:
        values = getattr(holder, name, None) if name.isidentifier() else None
        if not isinstance(values, np.ndarray) or values.dtype != np.float64:
            kind = type(holder).__name__.lstrip("_")
            near = did_you_mean(name, [n for n in dir(holder) if not n.startswith("_")])
            raise InputError(f"source {name!r}: no field of {kind}{near or f'; {_LISTED}'}")
        return values

    # Sources of one object.

    def _object(self, causality: Causality, words: list[str]) -> Variable | None:
        kind, *rest = words
        if not rest:
            return None
        i = self.find_id(kind, rest[0])
        what, *more = rest[1:] or [""]
        if kind == "sensor" and causality == "output" and not what:
            return self._sensor(i)
        if causality == "output":
            return self._object_output(kind, i, what, more)
        if causality == "input" and not more:
            return self._object_input(kind, i, what)
        return self._object_parameter(kind, i, what, more) if causality == "parameter" else None

    def _object_output(self, kind: str, i: int, what: str, more: list[str]) -> Variable | None:
        if what == "jacobian" and kind in ("body", "geom", "site"):
            return self._jacobian(kind, i, more)
        if more:
            return None
        if (kind, what) in POSES:
            field, width, unit = POSES[kind, what]
            return _row(f"data {field} {width * i}", (width,), (unit,) * width)
        if kind == "joint" and what in ("qpos", "qvel"):
            return self._joint(i, what)
        if kind == "actuator" and what == "force":
            return _row(f"held actuator_force {i}", (), ("",))
        return None

    def _object_input(self, kind: str, i: int, what: str) -> Variable | None:
        if kind == "body" and what in ("force", "torque"):
            unit = "N" if what == "force" else "N.m"
            first = 6 * i + 3 * (what == "torque")
            return _values(f"data xfrc_applied {first}", np.zeros(3), (unit,) * 3)
        mocap = int(self.model.body_mocapid[i]) if kind == "body" else -1
        if what in ("mocap_pos", "mocap_quat") and mocap >= 0:
            values = getattr(self.data, what)[mocap]
            units = ("m" if what == "mocap_pos" else "1",) * values.size
            return _values(f"data {what} {values.size * mocap}", values, units)
        if kind == "actuator" and what == "ctrl":
            low, high = self._limits(i)
            start = (float(self.data.ctrl[i]),)
            return _row(f"data ctrl {i}", (), ("",), start, (low,), (high,))
        return None

    def _object_parameter(self, kind: str, i: int, what: str, more: list[str]) -> Variable | None:
        model = self.model
        if kind == "body" and what in ("mass", "added_mass"):
            added = what == "added_mass"
            words = f"added body_mass {i}" if added else f"body_mass {i}"
            start, low = (0.0, 0.0) if added else (float(model.body_mass[i]), 1e-12)
            return _row(words, (), ("kg",), (start,), (low,))
        if kind == "body" and what in ("free_xy", "free_yaw"):
            return self._free(i, what, more)
        if kind == "geom" and what == "friction":
            return _values(f"model geom_friction {3 * i}", model.geom_friction[i], ("1",) * 3)
        if kind == "joint" and what in ("qpos", "qvel"):
            row = self._joint(i, what)
            return replace(row, source=row.source.removeprefix("data "))
        if kind == "joint" and what in ("damping", "armature", "frictionloss"):
            first, values = int(model.jnt_dofadr[i]), getattr(model, f"dof_{what}")
            count = len(_DOF[int(model.jnt_type[i])])
            values = values[first : first + count]
            return _values(f"model dof_{what} {first}", values, ("",) * count)
        return None

    def _free(self, body: int, what: str, flags: list[str]) -> Variable:
        model, joint = self.model, int(self.model.body_jntadr[body])
        if joint < 0 or int(model.jnt_type[joint]) != FREE:
            raise InputError(f"body {model.body(body).name!r}: has no free joint")
        if what == "free_yaw":
            return _row(f"free_yaw {body}", (), ("rad",), (0.0,))
        first = int(model.jnt_qposadr[joint])
        words = _join(what, body, *self._start_rule(flags))
        return _values(words, self.data.qpos[first : first + 2], ("m", "m"))

    def _start_rule(self, flags: list[str]) -> list[object]:
        """`[clear] [stand [GEOM...]]`, with the geoms' ids."""
        clear = flags[:1] == ["clear"]
        rule, ground = flags[clear : clear + 1], flags[clear + 1 :]
        if rule not in ([], ["stand"]):
            raise InputError(f"start rule {' '.join(flags)!r}; valid: [clear] [stand [GEOM...]]")
        return [*flags[: clear + len(rule)], *(self.find_id("geom", name) for name in ground)]

    def _joint(self, i: int, what: str) -> Variable:
        addresses = self.model.jnt_qposadr if what == "qpos" else self.model.jnt_dofadr
        units = self._units.field(what, 0)
        first, kind = int(addresses[i]), int(self.model.jnt_type[i])
        count = len(_QPOS[kind]) if what == "qpos" else len(_DOF[kind])
        values = getattr(self.data, what)[first : first + count]
        return _values(f"data {what} {first}", values, units[first : first + count])

    def _sensor(self, i: int) -> Variable:
        model = self.model
        late = int(model.sensor_needstage[i]) == int(mujoco.mjtStage.mjSTAGE_ACC)
        size, first = int(model.sensor_dim[i]), int(model.sensor_adr[i])
        words = f"{'held' if late else 'data'} sensordata {first}"
        return _row(words, (size,) if size > 1 else (), (self._units.sensor(i),) * size)

    def _jacobian(self, kind: str, i: int, joints: list[str]) -> Variable:
        dofs = self._dofs(joints)
        columns = [self._units.dof[dof] for dof in dofs]
        linear = ["m/rad" if unit == "rad" else "1" for unit in columns]
        angular = ["1" if unit == "rad" else "rad/m" for unit in columns]
        units = (*linear * 3, *angular * 3)
        return _row(_join("jac", kind, i, *dofs), (6, len(dofs)), units)

    def _dofs(self, joints: list[str]) -> list[int]:
        """Degrees of freedom of the named joints; of all joints if none is named."""
        if not joints:
            return list(range(self.model.nv))
        dofs: list[int] = []
        for name in joints:
            i = self.find_id("joint", name)
            first = int(self.model.jnt_dofadr[i])
            dofs += range(first, first + len(_DOF[int(self.model.jnt_type[i])]))
        return dofs

    def _limits(self, actuator: int) -> tuple[float, float]:
        if not self.model.actuator_ctrllimited[actuator]:
            return -np.inf, np.inf
        low, high = self.model.actuator_ctrlrange[actuator]
        return float(low), float(high)

    def find_id(self, kind: str, name: str) -> int:
        """Return the id of an object of the model; refused if there is none of this name."""
        i = int(mujoco.mj_name2id(self.model, OBJECTS[kind], name))
        if i < 0:
            valid = self.names(kind)
            near = did_you_mean(name, valid) or f"; valid: {', '.join(valid[:_SHOWN]) or 'none'}"
            raise InputError(f"{kind} {name!r}: not in the model{near}")
        return i

    def free_bodies(self) -> list[str]:
        """Names of the bodies with a free joint that have one."""
        free = self.model.jnt_bodyid[self.model.jnt_type == FREE]
        names = (mujoco.mj_id2name(self.model, OBJECTS["body"], int(i)) for i in free)
        return [name for name in names if name]

    def names(self, kind: str) -> list[str]:
        """Names of all objects of a kind that have a name."""
        counts = {"body": "nbody", "joint": "njnt", "actuator": "nu", "sensor": "nsensor"}
        count = getattr(self.model, counts.get(kind, f"n{kind}"))
        names = (mujoco.mj_id2name(self.model, OBJECTS[kind], i) for i in range(count))
        return [name for name in names if name]


def words_of(source: str) -> list[str]:
    """Split a source into words; a name with spaces stands in quotes."""
    try:
        return shlex.split(source)
    except ValueError as error:
        raise InputError(
            f"source {source!r}: a quotation mark or a character is missing"
        ) from error


def _row(  # noqa: PLR0913 - what a row of a table has
    words: str,
    shape: tuple[int, ...],
    units: Units,
    start: tuple[float, ...] | None = None,
    low: tuple[float, ...] | None = None,
    high: tuple[float, ...] | None = None,
) -> Variable:
    return Variable("", shape, units, "output", "continuous", "", start, low, high, source=words)


def _values(words: str, values: Any, units: Units) -> Variable:
    """Values of the model as a vector, or as a scalar if there is only one."""
    start = tuple(float(value) for value in values)
    return _row(words, (len(start),) if len(start) > 1 else (), units, start)


def _join(*words: object) -> str:
    return " ".join(map(str, words))


class ModelUnits:
    """The units in a model: `qpos` (nq,), and `dof` (nv,), that of each velocity times a second."""

    def __init__(self, model: Any) -> None:
        self._model = model
        joints = [int(kind) for kind in model.jnt_type]
        self.qpos: Units = tuple(unit for kind in joints for unit in _QPOS[kind])
        self.dof: Units = tuple(unit for kind in joints for unit in _DOF[kind])

    def field(self, name: str, size: int) -> Units:
        """Return the units of a field of mjData with a number of elements."""
        if name == "qpos":
            return self.qpos
        if name in ("qvel", "qacc"):
            return tuple(f"{unit}/s{'2' * (name == 'qacc')}" for unit in self.dof)
        if name.startswith("qfrc_"):
            return tuple(_FORCE[unit] for unit in self.dof)
        return (_FIELDS.get(name, ""),) * size

    def sensor(self, i: int) -> str:
        """Return the unit of a sensor's readings."""
        model = self._model
        kind: str = mujoco.mjtSensor(int(model.sensor_type[i])).name[7:].lower()
        if kind in ("jointpos", "jointvel"):  # of a hinge or a slide
            unit = _DOF[int(model.jnt_type[model.sensor_objid[i]])][0]
            return f"{unit}/s" if kind == "jointvel" else unit
        return _SENSORS.get(kind, "")
