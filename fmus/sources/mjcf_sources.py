"""Finds the variables of an FMU in a MuJoCo model, by name.

A source is written as, for instance, `body hand xpos`, `joint elbow qpos`, `sensor gyro`, `ctrl`
or `body hand jacobian`. Looking it up in a model gives the form that the C backend reads (see
`fmus/native/README.md`), with the model's shape, units and start values.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, did_you_mean
from ..interface.variables import Causality, Variable
from .mjcf_elements import DOF, FREE, QPOS, descriptions, units

Array = NDArray[np.float64]
# Kinds of objects: MuJoCo's number of the kind, and the model's field with their number.
OBJECTS: Final = {
    "body": (mujoco.mjtObj.mjOBJ_BODY, "nbody"),
    "joint": (mujoco.mjtObj.mjOBJ_JOINT, "njnt"),
    "geom": (mujoco.mjtObj.mjOBJ_GEOM, "ngeom"),
    "site": (mujoco.mjtObj.mjOBJ_SITE, "nsite"),
    "sensor": (mujoco.mjtObj.mjOBJ_SENSOR, "nsensor"),
    "actuator": (mujoco.mjtObj.mjOBJ_ACTUATOR, "nu"),
    "equality": (mujoco.mjtObj.mjOBJ_EQUALITY, "neq"),
}
# An object's properties: the field that has them, with the numbers per object and their unit.
PROPERTIES: Final = {
    ("output", "body", "xpos"): ("data xpos", 3, "m"),
    ("output", "body", "xquat"): ("data xquat", 4, "1"),
    ("output", "body", "xmat"): ("data xmat", 9, "1"),
    ("output", "body", "xipos"): ("data xipos", 3, "m"),
    ("output", "body", "subtree_com"): ("data subtree_com", 3, "m"),
    ("output", "geom", "xpos"): ("data geom_xpos", 3, "m"),
    ("output", "geom", "xmat"): ("data geom_xmat", 9, "1"),
    ("output", "site", "xpos"): ("data site_xpos", 3, "m"),
    ("output", "site", "xmat"): ("data site_xmat", 9, "1"),
    ("parameter", "geom", "friction"): ("model geom_friction", 3, "1"),
    ("parameter", "equality", "solref"): ("model eq_solref", 2, ""),
    ("parameter", "equality", "solimp"): ("model eq_solimp", 5, ""),
    ("parameter", "equality", "data"): ("model eq_data", 11, ""),
}
# A joint's, with one number for each degree of freedom, or element of qpos.
JOINT_PROPERTIES: Final = {
    ("output", "qpos"): "data qpos", ("output", "qvel"): "data qvel",
    ("parameter", "qpos"): "qpos", ("parameter", "qvel"): "qvel",
    ("parameter", "damping"): "model dof_damping",
    ("parameter", "armature"): "model dof_armature",
    ("parameter", "frictionloss"): "model dof_frictionloss",
}  # fmt: skip
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
_SENSORS: Final = {
    "touch": "N", "accelerometer": "m/s2", "velocimeter": "m/s", "gyro": "rad/s", "force": "N",
    "torque": "N.m", "rangefinder": "m", "tendonpos": "m", "tendonvel": "m/s", "ballquat": "1",
    "ballangvel": "rad/s", "framepos": "m", "framequat": "1", "framexaxis": "1",
    "frameyaxis": "1", "framezaxis": "1", "framelinvel": "m/s", "frameangvel": "rad/s",
    "framelinacc": "m/s2", "frameangacc": "rad/s2", "subtreecom": "m", "subtreelinvel": "m/s",
}  # fmt: skip

_TEXTS: Final = {  # descriptions of sources whose own words say too little
    "gravity": "Acceleration of gravity",
    "keyframe": "Keyframe that positions and velocities start at",
}
_SHOWN = 30  # names of a model in a message
_LISTED = "`panda-cosim mjcf2fmu --help` lists the sources"


class Sources:
    """The sources of a `mujoco.MjModel` at a keyframe, or at qpos0 if it is ""."""

    def __init__(self, model: Any, keyframe: str = "") -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.key = -1  # index of the keyframe
        if keyframe:
            names = [model.key(i).name for i in range(model.nkey)]
            if keyframe not in names:
                valid = ", ".join(filter(None, names)) or "none"
                raise InputError(f"no keyframe {keyframe!r}; valid: {valid}")
            self.key = names.index(keyframe)
            mujoco.mj_resetDataKeyframe(model, self.data, self.key)

    def find(self, causality: Causality, source: str) -> Variable:
        """Look a source up; a name with spaces stands in quotes."""
        words = words_of(source)
        row = None
        if words and words[0] in OBJECTS:
            row = self._object(causality, *words) if len(words) > 1 else None
        elif words:
            row = getattr(self, f"_{causality}")(words)
        if row is None:
            raise InputError(f"source {source!r}: no such {causality} of a MuJoCo model; {_LISTED}")
        text, details = _TEXTS.get(source, source), self._details(row)
        row = replace(row, causality=causality, description=text, details=details)
        if causality == "output":
            return replace(row, start=None, minimum=None, maximum=None)
        return replace(row, variability="fixed") if causality == "parameter" else row

    def _details(self, row: Variable) -> tuple[str, ...]:
        """Descriptions of the elements, if these are of joints or actuators."""
        words = row.source.split()
        if words[0] not in ("data", "held"):
            return ()
        first = int(words[2])
        return descriptions(self.model, words[1])[first : first + row.size]

    # Sources of the whole model.

    def _input(self, words: list[str]) -> Variable | None:
        if words == ["motors"]:  # actuators that are not motors ignore their torques
            return _values("motors 0", np.zeros(self.model.nu), "N.m", is_vector=True)
        if words[0] not in INPUT_FIELDS or len(words) > 1:
            return self._raw("data", words)
        field = self._field("data", words[0])
        return self._limited(field, 0) if words[0] == "ctrl" else field

    def _output(self, words: list[str]) -> Variable | None:
        name, *rest = words
        if name == "mass_matrix":
            dofs = self._dofs(rest)
            return _matrix(_join(name, *dofs), (len(dofs), len(dofs)), ("",) * len(dofs) ** 2)
        if name in CONTACTS:
            return _values(_join(name, *self._ids(CONTACTS[name], rest)), [0.0], "N")
        if name in ("data", "held", "model"):
            return self._raw(name, words)
        return self._field("held" if name in HELD else "data", name) if not rest else None

    def _parameter(self, words: list[str]) -> Variable | None:
        name, *rest = words
        if words in (["scene"], ["keyframe"]):
            return self._choice(name)
        if name in OPTIONS and not rest:
            values = np.atleast_1d(getattr(self.model.opt, name))
            return _values(f"model {name} 0", values, OPTIONS[name])
        if name in ("qpos", "qvel") and not rest:
            return replace(self._field("data", name), source=f"{name} 0")
        if name in SCALED and rest:
            ids = self._ids(SCALED[name], rest)
            scales = _values(_join(name, *ids), np.ones(len(ids)), "1", is_vector=True)
            return replace(scales, minimum=(0.0,) * len(ids))
        if name == "added":
            row = self._raw(name, words)
            return row and replace(row, start=(0.0,) * row.size)
        return self._raw("model", words)

    def _choice(self, name: str) -> Variable | None:
        """An enumeration: the scene, or the keyframe to start from."""
        row, count = _values(name, [1.0], ""), self.model.nkey
        if name == "scene":
            return row
        names = ("qpos0", *(self.model.key(i).name or f"key_{i + 1}" for i in range(count)))
        return replace(row, start=names[self.key + 1], kind="Enumeration", choices=names)

    def _raw(self, kind: str, words: list[str]) -> Variable | None:
        """`data FIELD FIRST COUNT`, or `model` or `added` in place of `data`."""
        numbers = "".join(words[2:])
        if len(words) != 4 or words[0] != kind or not (numbers.isascii() and numbers.isdigit()):
            return None
        values = self._array(self.data if kind == "data" else self.model, words[1])
        first, count = int(words[2]), int(words[3])
        if not 1 <= count <= values.size - first:
            raise InputError(f"source {' '.join(words)!r}: {words[1]} has {values.size} elements")
        return _values(_join(*words[:3]), values[first : first + count], "")

    def _field(self, kind: str, name: str) -> Variable:
        values = self._array(self.data, name)
        if not values.size:
            raise InputError(f"source {name!r}: this model has no {name}")
        return _values(f"{kind} {name} 0", values, units(self.model, name))

    def _array(self, holder: Any, name: str) -> Array:
        values = getattr(holder, name, None) if name.isidentifier() else None
        if not isinstance(values, np.ndarray) or values.dtype != np.float64:
            kind = type(holder).__name__.lstrip("_")
            near = did_you_mean(name, [n for n in dir(holder) if not n.startswith("_")])
            raise InputError(f"source {name!r}: no field of {kind}{near or f'; {_LISTED}'}")
        return np.ravel(values)

    # Sources of one object.

    def _object(
        self, causality: Causality, kind: str, name: str, what: str = "", *more: str
    ) -> Variable | None:
        i, row = self.find_id(kind, name), None
        match causality, kind, what, *more:
            case "output", "body" | "geom" | "site", "jacobian", *joints:
                row = self._jacobian(kind, i, joints)
            case "parameter", "body", "free_xy" | "free_yaw", *flags:
                row = self._free(i, what, flags)
            case "output" | "parameter", "joint", _ if (causality, what) in JOINT_PROPERTIES:
                row = self._joint(i, JOINT_PROPERTIES[causality, what])
            case "output", "sensor", "":
                row = self._sensor(i)
            case "input", "body", "force":
                row = _values(f"data xfrc_applied {6 * i}", np.zeros(3), "N")
            case "input", "body", "torque":
                row = _values(f"data xfrc_applied {6 * i + 3}", np.zeros(3), "N.m")
            case "input", "body", "mocap_pos" | "mocap_quat" if self.model.body_mocapid[i] >= 0:
                width = 3 if what == "mocap_pos" else 4
                first = width * int(self.model.body_mocapid[i])
                row = self._elements(f"data {what}", first, width, units(self.model, what))
            case _, "actuator", _:
                row = self._actuator(causality, i, what)
            case "parameter", "body", "mass":
                mass = _values(f"body_mass {i}", [self.model.body_mass[i]], "kg")
                row = replace(mass, minimum=(1e-12,))
            case "parameter", "body", "added_mass":
                row = replace(_values(f"added body_mass {i}", [0.0], "kg"), minimum=(0.0,))
            case (*key,) if tuple(key) in PROPERTIES:
                field, width, unit = PROPERTIES[causality, kind, what]
                row = self._elements(field, width * i, width, unit)
        return row

    def _actuator(self, causality: Causality, i: int, what: str) -> Variable | None:
        match causality, what:
            case "input", "ctrl":
                unit = units(self.model, "ctrl")[i]
                return self._limited(self._elements("data ctrl", i, 1, unit), i)
            case "output", "force":
                unit = units(self.model, "actuator_force")[i]
                return self._elements("held actuator_force", i, 1, unit)
            case "parameter", "gain":
                return self._elements("model actuator_gainprm", mujoco.mjNGAIN * i, 1, "")
            case "parameter", "bias":  # constant, by length and by velocity
                return self._elements("model actuator_biasprm", mujoco.mjNBIAS * i, 3, "")
        return None

    def _elements(self, source: str, first: int, count: int, units: str | Units) -> Variable:
        """Elements of a field, whose name is the last word of the source."""
        holder = self.model if source.startswith("model") else self.data
        values = np.ravel(getattr(holder, source.rsplit(maxsplit=1)[-1]))[first : first + count]
        return _values(f"{source} {first}", values, units)

    def _joint(self, i: int, source: str) -> Variable:
        field, kind = source.rsplit(maxsplit=1)[-1], int(self.model.jnt_type[i])
        addresses = self.model.jnt_qposadr if field == "qpos" else self.model.jnt_dofadr
        first, count = int(addresses[i]), len((QPOS if field == "qpos" else DOF)[kind])
        whole = units(self.model, field)
        return self._elements(source, first, count, whole and whole[first : first + count])

    def _free(self, body: int, what: str, flags: Sequence[str]) -> Variable:
        model, joint = self.model, int(self.model.body_jntadr[body])
        if joint < 0 or int(model.jnt_type[joint]) != FREE:
            raise InputError(f"body {model.body(body).name!r}: has no free joint")
        if what == "free_yaw":
            return _values(f"free_yaw {body}", [0.0], "rad")
        first = int(model.jnt_qposadr[joint])
        words = _join(what, body, *self._start_rule(flags))
        return _values(words, self.data.qpos[first : first + 2], "m")

    def _start_rule(self, flags: Sequence[str]) -> list[object]:
        """`[clear] [stand [GEOM...]]`, with the geoms' ids."""
        clear = list(flags[:1]) == ["clear"]
        rule, ground = flags[clear : clear + 1], flags[clear + 1 :]
        if list(rule) not in ([], ["stand"]):
            raise InputError(f"start rule {' '.join(flags)!r}; valid: [clear] [stand [GEOM...]]")
        return [*flags[: clear + len(rule)], *self._ids("geom", ground)]

    def _sensor(self, i: int) -> Variable:
        model = self.model
        late = int(model.sensor_needstage[i]) == int(mujoco.mjtStage.mjSTAGE_ACC)
        kind: str = mujoco.mjtSensor(int(model.sensor_type[i])).name[7:].lower()
        unit = _SENSORS.get(kind, "")
        if kind in ("jointpos", "jointvel"):  # of a hinge or a slide
            unit = DOF[int(model.jnt_type[model.sensor_objid[i]])][0] + "/s" * (kind == "jointvel")
        source, first = f"{'held' if late else 'data'} sensordata", int(model.sensor_adr[i])
        return self._elements(source, first, int(model.sensor_dim[i]), unit)

    def _jacobian(self, kind: str, i: int, joints: Sequence[str]) -> Variable:
        dofs = self._dofs(joints)
        by_dof = [unit for kind in self.model.jnt_type for unit in DOF[int(kind)]]
        linear = ["m/rad" if by_dof[dof] == "rad" else "1" for dof in dofs]
        angular = ["1" if by_dof[dof] == "rad" else "rad/m" for dof in dofs]
        units = (*linear * 3, *angular * 3)
        return _matrix(_join("jac", kind, i, *dofs), (6, len(dofs)), units)

    def _dofs(self, joints: Sequence[str]) -> list[int]:
        """Degrees of freedom of the named joints; of all joints if none is named."""
        if not joints:
            return list(range(self.model.nv))
        dofs: list[int] = []
        for i in self._ids("joint", joints):
            first = int(self.model.jnt_dofadr[i])
            dofs += range(first, first + len(DOF[int(self.model.jnt_type[i])]))
        return dofs

    def _limited(self, ctrl: Variable, first: int) -> Variable:
        """Controls within their ranges, to which MuJoCo clamps them."""
        actuators = slice(first, first + ctrl.size)
        is_clamped = not self.model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        limited = is_clamped & (self.model.actuator_ctrllimited[actuators] == 1)
        low, high = self.model.actuator_ctrlrange[actuators].T
        low, high = np.where(limited, low, -np.inf), np.where(limited, high, np.inf)
        start, least, most = (
            tuple(values.tolist())
            for values in (np.clip(np.asarray(ctrl.start), low, high), low, high)
        )
        return replace(ctrl, start=start, minimum=least, maximum=most)

    def _ids(self, kind: str, names: Sequence[str]) -> list[int]:
        return [self.find_id(kind, name) for name in names]

    def find_id(self, kind: str, name: str) -> int:
        """Return the id of an object of the model; refused if there is none of this name."""
        i = int(mujoco.mj_name2id(self.model, OBJECTS[kind][0], name))
        if i < 0:
            valid = self.names(kind)
            near = did_you_mean(name, valid) or f"; valid: {', '.join(valid[:_SHOWN]) or 'none'}"
            raise InputError(f"{kind} {name!r}: not in the model{near}")
        return i

    def free_bodies(self) -> list[str]:
        """Names of the bodies with a free joint that have one."""
        free = self.model.jnt_bodyid[self.model.jnt_type == FREE]
        return [name for name in (self.model.body(int(i)).name for i in free) if name]

    def names(self, kind: str) -> list[str]:
        """Names of all objects of a kind that have a name."""
        number, count = OBJECTS[kind]
        ids = range(getattr(self.model, count))
        return [name for i in ids if (name := mujoco.mj_id2name(self.model, number, i))]


def words_of(source: str) -> list[str]:
    """Split a source into words; a name with spaces stands in quotes."""
    try:
        return shlex.split(source)
    except ValueError as error:
        raise InputError(
            f"source {source!r}: a quotation mark or a character is missing"
        ) from error


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
