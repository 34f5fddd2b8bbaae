"""Finds the variables of an FMU in a MuJoCo model, by name.

A source is written as, for instance, `body hand xpos`, `joint elbow qpos`, `sensor gyro`, `ctrl`
or `body hand jacobian`. Looking it up in a model gives the form that the C backend reads (see
`fmus/native/README.md`), with the model's shape, units and start values.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass, replace
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..interface.variables import Causality
from ..messages import did_you_mean
from .mjcf_units import FREE, ModelUnits, Units, dof_count, position_count

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
# Parameters that scale properties, and their kind of object.
SCALED: Final = {"scaled_mass": "body", "scaled_servo": "actuator", "scaled_force": "actuator"}

_SHOWN = 30  # names of a model in a message
_LISTED = "`panda-cosim mjcf2fmu --help` lists the sources"


@dataclass(frozen=True)
class Found:
    """A source, looked up in a model.

    Attributes:
        words: The source in the C backend's form.
        shape: () for a scalar, else (n,) or (rows, columns).
        units: Unit of each element, "" if MuJoCo defines none.
        start: Start value of each element; None for outputs.
        low: Lower bound of each element, or None.
        high: Upper bound of each element, or None.
    """

    words: str
    shape: tuple[int, ...]
    units: Units
    start: tuple[float, ...] | None = None
    low: tuple[float, ...] | None = None
    high: tuple[float, ...] | None = None


class Sources:
    """The sources of a model.

    Args:
        model: The `mujoco.MjModel`.
        key: Index of the keyframe that the FMU starts from, or -1.
    """

    def __init__(self, model: Any, key: int = -1) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        if key >= 0:
            mujoco.mj_resetDataKeyframe(model, self.data, key)
        self._units = ModelUnits(model)

    def find(self, causality: Causality, source: str) -> Found:
        """Look a source up.

        Args:
            causality: Causality of the variable.
            source: The source; a name with spaces stands in quotes.

        Raises:
            InputError: There is no such source for this causality.
        """
        words = words_of(source)
        found = None
        if words and words[0] in OBJECTS:
            found = self._object(causality, words)
        elif words:
            found = getattr(self, f"_{causality}")(words)
        if found is None:
            raise InputError(f"source {source!r}: no such {causality} of a MuJoCo model; {_LISTED}")
        made: Found = found
        return made

    # Sources of the whole model.

    def _input(self, words: list[str]) -> Found | None:
        if words == ["motors"]:
            return self._motors()
        if words[0] not in INPUT_FIELDS or len(words) > 1:
            return self._raw("data", words)
        found = self._field("data", words[0])
        if words[0] != "ctrl":
            return found
        limits = [self._limits(i) for i in range(self.model.nu)]
        low, high = zip(*limits, strict=True) if limits else ((), ())
        return Found(found.words, found.shape, found.units, found.start, low, high)

    def _motors(self) -> Found:
        """Torques of all actuators; those that are not motors ignore theirs."""
        count = int(self.model.nu)
        return Found("motors 0", (count,), ("N.m",) * count, (0.0,) * count)

    def _output(self, words: list[str]) -> Found | None:
        name, *rest = words
        if name == "mass_matrix":
            dofs = self._dofs(rest)
            return Found(_join(name, *dofs), (len(dofs), len(dofs)), ("",) * len(dofs) ** 2)
        if name == "contact_sensors":
            ids = [self.find_id("sensor", sensor) for sensor in rest]
            return Found(_join(name, *ids), (), ("N",))
        if name in ("contact_bodies", "unwanted_contacts", "support_contacts"):
            ids = [self.find_id("body", body) for body in rest]
            return Found(_join(name, *ids), (), ("N",))
        if name in ("data", "held", "model"):
            found = self._raw(name, words)
            return found and Found(found.words, found.shape, found.units)
        found = self._field("held" if name in HELD else "data", name) if not rest else None
        return found and Found(found.words, found.shape, found.units)

    def _parameter(self, words: list[str]) -> Found | None:
        name, *rest = words
        if words == ["scene"]:
            return Found("scene", (), ("",), (1.0,))
        if name in OPTIONS and not rest:
            values = np.atleast_1d(getattr(self.model.opt, name))
            return _found(f"model {name} 0", values, (OPTIONS[name],) * values.size)
        if name in ("qpos", "qvel") and not rest:
            field = self._field("data", name)
            return Found(f"{name} 0", field.shape, field.units, field.start)
        if name in SCALED and rest:
            ids = [self.find_id(SCALED[name], one) for one in rest]
            ones = (1.0,) * len(ids)
            return Found(_join(name, *ids), (len(ids),), ("1",) * len(ids), ones, (0.0,) * len(ids))
        if name == "added":
            found = self._raw(name, words)
            return found and replace(found, start=(0.0,) * len(found.units))
        return self._raw("model", words)

    def _raw(self, kind: str, words: list[str]) -> Found | None:
        """`data FIELD FIRST COUNT`, or `model` or `added` in place of `data`."""
        numbers = "".join(words[2:])
        if len(words) != 4 or words[0] != kind or not (numbers.isascii() and numbers.isdigit()):
            return None
        holder = self.data if kind == "data" else self.model
        values = np.ravel(self._array(holder, words[1]))
        first, count = int(words[2]), int(words[3])
        if not 1 <= count <= values.size - first:
            raise InputError(f"source {' '.join(words)!r}: {words[1]} has {values.size} elements")
        return _found(_join(*words[:3]), values[first : first + count], ("",) * count)

    def _field(self, kind: str, name: str) -> Found:
        values = np.ravel(self._array(self.data, name))
        if not values.size:
            raise InputError(f"source {name!r}: this model has no {name}")
        return _found(f"{kind} {name} 0", values, self._units.field(name, values.size))

    def _array(self, holder: Any, name: str) -> Array:
        values = getattr(holder, name, None) if name.isidentifier() else None
        if not isinstance(values, np.ndarray) or values.dtype != np.float64:
            kind = type(holder).__name__.lstrip("_")
            near = did_you_mean(name, [n for n in dir(holder) if not n.startswith("_")])
            raise InputError(f"source {name!r}: no field of {kind}{near or f'; {_LISTED}'}")
        return values

    # Sources of one object.

    def _object(self, causality: Causality, words: list[str]) -> Found | None:
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

    def _object_output(self, kind: str, i: int, what: str, more: list[str]) -> Found | None:
        if what == "jacobian" and kind in ("body", "geom", "site"):
            return self._jacobian(kind, i, more)
        if more:
            return None
        if (kind, what) in POSES:
            field, width, unit = POSES[kind, what]
            return Found(f"data {field} {width * i}", (width,), (unit,) * width)
        if kind == "joint" and what in ("qpos", "qvel"):
            found = self._joint(i, what)
            return Found(found.words, found.shape, found.units)
        if kind == "actuator" and what == "force":
            return Found(f"held actuator_force {i}", (), ("",))
        return None

    def _object_input(self, kind: str, i: int, what: str) -> Found | None:
        if kind == "body" and what in ("force", "torque"):
            unit = "N" if what == "force" else "N.m"
            first = 6 * i + 3 * (what == "torque")
            return _found(f"data xfrc_applied {first}", np.zeros(3), (unit,) * 3)
        mocap = int(self.model.body_mocapid[i]) if kind == "body" else -1
        if what in ("mocap_pos", "mocap_quat") and mocap >= 0:
            values = getattr(self.data, what)[mocap]
            units = ("m" if what == "mocap_pos" else "1",) * values.size
            return _found(f"data {what} {values.size * mocap}", values, units)
        if kind == "actuator" and what == "ctrl":
            low, high = self._limits(i)
            start = (float(self.data.ctrl[i]),)
            return Found(f"data ctrl {i}", (), ("",), start, (low,), (high,))
        return None

    def _object_parameter(self, kind: str, i: int, what: str, more: list[str]) -> Found | None:
        model = self.model
        if kind == "body" and what in ("mass", "added_mass"):
            added = what == "added_mass"
            words = f"added body_mass {i}" if added else f"body_mass {i}"
            start, low = (0.0, 0.0) if added else (float(model.body_mass[i]), 1e-12)
            return Found(words, (), ("kg",), (start,), (low,))
        if kind == "body" and what in ("free_xy", "free_yaw"):
            return self._free(i, what, more)
        if kind == "geom" and what == "friction":
            return _found(f"model geom_friction {3 * i}", model.geom_friction[i], ("1",) * 3)
        if kind == "joint" and what in ("qpos", "qvel"):
            found = self._joint(i, what)
            return Found(found.words.removeprefix("data "), found.shape, found.units, found.start)
        if kind == "joint" and what in ("damping", "armature", "frictionloss"):
            first, values = int(model.jnt_dofadr[i]), getattr(model, f"dof_{what}")
            count = dof_count(int(model.jnt_type[i]))
            values = values[first : first + count]
            return _found(f"model dof_{what} {first}", values, ("",) * count)
        return None

    def _free(self, body: int, what: str, flags: list[str]) -> Found:
        model, joint = self.model, int(self.model.body_jntadr[body])
        if joint < 0 or int(model.jnt_type[joint]) != FREE:
            raise InputError(f"body {model.body(body).name!r}: has no free joint")
        if what == "free_yaw":
            return Found(f"free_yaw {body}", (), ("rad",), (0.0,))
        first = int(model.jnt_qposadr[joint])
        words = _join(what, body, *self._start_rule(flags))
        return _found(words, self.data.qpos[first : first + 2], ("m", "m"))

    def _start_rule(self, flags: list[str]) -> list[object]:
        """`[clear] [stand [GEOM...]]`, with the geoms' ids."""
        clear = flags[:1] == ["clear"]
        rule, ground = flags[clear : clear + 1], flags[clear + 1 :]
        if rule not in ([], ["stand"]):
            raise InputError(f"start rule {' '.join(flags)!r}; valid: [clear] [stand [GEOM...]]")
        return [*flags[: clear + len(rule)], *(self.find_id("geom", name) for name in ground)]

    def _joint(self, i: int, what: str) -> Found:
        addresses = self.model.jnt_qposadr if what == "qpos" else self.model.jnt_dofadr
        units = self._units.field(what, 0)
        first, kind = int(addresses[i]), int(self.model.jnt_type[i])
        count = position_count(kind) if what == "qpos" else dof_count(kind)
        values = getattr(self.data, what)[first : first + count]
        return _found(f"data {what} {first}", values, units[first : first + count])

    def _sensor(self, i: int) -> Found:
        model = self.model
        late = int(model.sensor_needstage[i]) == int(mujoco.mjtStage.mjSTAGE_ACC)
        size, first = int(model.sensor_dim[i]), int(model.sensor_adr[i])
        words = f"{'held' if late else 'data'} sensordata {first}"
        return Found(words, (size,) if size > 1 else (), (self._units.sensor(i),) * size)

    def _jacobian(self, kind: str, i: int, joints: list[str]) -> Found:
        dofs = self._dofs(joints)
        columns = [self._units.dof[dof] for dof in dofs]
        linear = ["m/rad" if unit == "rad" else "1" for unit in columns]
        angular = ["1" if unit == "rad" else "rad/m" for unit in columns]
        units = (*linear * 3, *angular * 3)
        return Found(_join("jac", kind, i, *dofs), (6, len(dofs)), units)

    def _dofs(self, joints: list[str]) -> list[int]:
        """Degrees of freedom of the named joints; of all joints if none is named."""
        if not joints:
            return list(range(self.model.nv))
        dofs: list[int] = []
        for name in joints:
            i = self.find_id("joint", name)
            first = int(self.model.jnt_dofadr[i])
            dofs += range(first, first + dof_count(int(self.model.jnt_type[i])))
        return dofs

    def _limits(self, actuator: int) -> tuple[float, float]:
        if not self.model.actuator_ctrllimited[actuator]:
            return -np.inf, np.inf
        low, high = self.model.actuator_ctrlrange[actuator]
        return float(low), float(high)

    def find_id(self, kind: str, name: str) -> int:
        """Return the id of an object of the model.

        Raises:
            InputError: There is none of this name.
        """
        found = int(mujoco.mj_name2id(self.model, OBJECTS[kind], name))
        if found < 0:
            valid = self.names(kind)
            near = did_you_mean(name, valid) or f"; valid: {', '.join(valid[:_SHOWN]) or 'none'}"
            raise InputError(f"{kind} {name!r}: not in the model{near}")
        return found

    def free_bodies(self) -> list[str]:
        """Names of the bodies with a free joint that have one."""
        free = self.model.jnt_bodyid[self.model.jnt_type == FREE]
        names = (mujoco.mj_id2name(self.model, OBJECTS["body"], int(i)) for i in free)
        return [name for name in names if name]

    def names(self, kind: str) -> list[str]:
        """Names of all objects of a kind that have a name."""
        counts = {"body": "nbody", "joint": "njnt", "actuator": "nu", "sensor": "nsensor"}
        count = getattr(self.model, counts.get(kind, f"n{kind}"))
        found = (mujoco.mj_id2name(self.model, OBJECTS[kind], i) for i in range(count))
        return [name for name in found if name]


def words_of(source: str) -> list[str]:
    """Split a source into words; a name with spaces stands in quotes.

    Raises:
        InputError: A quotation mark is missing.
    """
    try:
        return shlex.split(source)
    except ValueError as error:
        raise InputError(
            f"source {source!r}: a quotation mark or a character is missing"
        ) from error


def _found(words: str, values: Any, units: Units) -> Found:
    """Values of the model as a vector, or as a scalar if there is only one."""
    start = tuple(float(value) for value in values)
    return Found(words, (len(start),) if len(start) > 1 else (), units, start)


def _join(*words: object) -> str:
    return " ".join(map(str, words))
