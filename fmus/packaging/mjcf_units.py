"""Units of a MuJoCo model's quantities; "" where MuJoCo defines none."""

from __future__ import annotations

from typing import Any, Final

import mujoco

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


class ModelUnits:
    """The units in a model.

    Args:
        model: The `mujoco.MjModel`.

    Attributes:
        qpos: Of each position (nq,).
        dof: Of each degree of freedom (nv,): that of its velocity, times a second.
    """

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


def position_count(kind: int) -> int:
    """Return how many positions a joint of a kind has (`mjtJoint`)."""
    return len(_QPOS[kind])


def dof_count(kind: int) -> int:
    """Return how many degrees of freedom a joint of a kind has (`mjtJoint`)."""
    return len(_DOF[kind])
