"""All interfaces, and which output feeds which input.

PandaSensors is connected between plant and controller; PandaTrajectory gives the controller's
commands. The other two have a module each.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Final

from ...controller.sensor_errors import SensorErrors
from .controller import COMMANDS, CONTROLLER, parameter_of
from .plant import PLANT
from .variables import Interface, Numbers, Variable, input_, output

# Measured signals: inputs of the controller, and outputs of the plant of the same names.
MEASURED: Final = ("qpos", "qvel", "hand_xpos", "hand_xquat", "jac", "qfrc_bias")
SEEN: Final = ("target_xpos", "target_xmat")
INERTIA: Final = "mass_matrix"  # which the robot's own model tells
_FIXED: Final = (  # errors, from the start on
    "seed", "delay", "hand_pose_source", "block_position_error", "block_yaw_error", "robot",
)  # fmt: skip
_STARTS: Final[dict[str, Numbers]] = {
    "target_xpos": (0.4, -0.2, 0.1),
    "target_xmat": (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
}
_WORDS: Final = {
    "qpos": "positions of the joints",
    "qvel": "velocities of the joints",
    "hand_xpos": "position of the hand body's origin, world frame",
    "hand_xquat": "orientation of the hand body, world frame, (w, x, y, z)",
    "jac": "Jacobian of the hand body's origin with respect to the arm's joints, as the plant's",
    "qfrc_bias": "gravity, Coriolis and centrifugal forces of the arm",
    "target_xpos": "centre of the block's top face, world frame",
    "target_xmat": "rotation matrix of the block, row by row, world frame",
}


def measurement_of(name: str) -> str:
    """Return the name of the output with the measurement of a plant's output."""
    return f"{name}_measured"


def _signal(name: str) -> tuple[Variable, Variable]:
    """The true signal, an input, and its measurement, an output."""
    like = PLANT.variable(name) if name in SEEN else CONTROLLER.variable(name)
    start, words = _STARTS.get(name, like.start), _WORDS[name]
    assert isinstance(start, (float, tuple))
    parts = tuple((measurement_of(part), n, f"Measured: {text}") for part, n, text in like.parts)
    return (
        input_(name, like.shape, like.unit, f"True {words}", start, parts=like.parts),
        output(measurement_of(name), like.shape, like.unit, f"Measured {words}", parts=parts),
    )


_TRUTHS, _READINGS = zip(*map(_signal, (*MEASURED, *SEEN)), strict=True)


SENSORS = Interface(
    "PandaSensors",
    "Measurements of arm and block, with errors of encoders, camera and transmission",
    (
        *_TRUTHS,
        *_READINGS,
        output(measurement_of(INERTIA), (7, 7), "kg.m2", "Joint-space inertia matrix of the arm, "
               "rotor inertia included, by the robot's own model at the measured joints",
               on_request=True),
        *(parameter_of(error, _FIXED) for error in fields(SensorErrors)),
    ),
)  # fmt: skip


TABLE_FILE: Final = "table.bin"  # float64, little-endian, one row of 14 per millisecond
TRAJECTORY = Interface(
    "PandaTrajectory",
    "Plays a scenario's commands for PandaController, one row per millisecond",
    (
        *(output(v.name, v.shape, v.unit, v.description)
          for v in CONTROLLER.of("input") if v.name in COMMANDS),
        Variable("table", (), "", "parameter", "fixed", "CSV file to play instead of the built-in "
                 "table, as `panda-cosim inputs` writes it; empty: the built-in one. Only FMUs "
                 "that run Python read it", "", kind="String"),
    ),
    {"command": COMMANDS},
)  # fmt: skip


INTERFACES = MappingProxyType({"plant": PLANT, "controller": CONTROLLER})


@dataclass(frozen=True)
class Connection:
    """One scalar output that feeds one scalar input, with factor * value + offset."""

    source: tuple[str, str]  # instance and output, such as ("plant", "jac[1,2]")
    target: tuple[str, str]  # instance and input
    factor: float = 1.0
    offset: float = 0.0  # in the target's unit
    converts_units: bool = True  # first, if the FMUs declare different ones
    converts_types: bool = False  # also where that rounds, or makes a number of a Boolean

    def __str__(self) -> str:
        return f"connection from {'.'.join(self.source)} to {'.'.join(self.target)}"


CONNECTIONS = (
    *(Connection(("plant", name), ("controller", name))
      for v in CONTROLLER.of("input") if v.name in MEASURED for name in v.names()),
    *(Connection(("controller", name), ("plant", name)) for name in PLANT.variable("ctrl").names()),
)  # fmt: skip
