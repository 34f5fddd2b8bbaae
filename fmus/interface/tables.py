"""All interfaces, and which output feeds which input.

PandaSensors is connected between plant and controller; PandaTrajectory gives the controller's
commands. The other two have a module each.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from ...assets import STEP_SIZE
from ...assets.franka import ROBOTS
from ...controller.sensor_errors import HAND_POSE_SOURCES, SensorErrors
from .controller import COMMANDS, CONTROLLER
from .plant import PLANT
from .variables import Interface, Numbers, Variable, input_, output

DELAY_MAX: Final = 0.1  # [s]
# Measured signals: inputs of the controller, and outputs of the plant of the same names.
MEASURED: Final = ("qpos", "qvel", "hand_xpos", "hand_xquat", "jac", "qfrc_bias")
SEEN: Final = ("target_xpos", "target_xmat")
_DEFAULTS = SensorErrors()
_STARTS: Final[dict[str, Numbers]] = {
    "target_xpos": (0.4, -0.2, 0.1),
    "target_xmat": (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
}
_WORDS: Final = {
    "qpos": "positions of the joints",
    "qvel": "velocities of the joints",
    "hand_xpos": "position of the hand body's origin, world frame",
    "hand_xquat": "orientation of the hand body, world frame, (w, x, y, z)",
    "jac": "Jacobian of the hand body's origin by the arm's joints, as the plant's",
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


def _error(  # noqa: PLR0913 - a row has this many columns
    name: str, size: int, unit: str, bounds: tuple[float, float], words: str, *, fixed: bool = False
) -> Variable:
    start = getattr(_DEFAULTS, name)
    shape = (size,) if size > 1 else ()
    variability = "fixed" if fixed else "tunable"
    return Variable(name, shape, unit, "parameter", variability, words, start, *bounds)  # type: ignore[arg-type]


SENSORS = Interface(
    "PandaSensors",
    "Measurements of arm and block, with errors of encoders, camera and transmission",
    (
        *_TRUTHS,
        *_READINGS,
        Variable("seed", (), "1", "parameter", "fixed", "Seed of the random numbers, a whole "
                 "number", 0.0, 0.0, 2.0**32 - 1, multiple_of=1.0),
        _error("joint_offset", 7, "rad", (-0.5, 0.5), "Offset of each encoder"),
        _error("joint_noise", 7, "rad", (0.0, 0.1), "Noise of each encoder, root mean square"),
        _error("joint_quantisation", 7, "rad", (0.0, 0.1), "Resolution of each encoder; 0: exact"),
        _error("velocity_noise", 7, "rad/s", (0.0, 10.0), "Noise of each joint velocity, root "
               "mean square"),
        Variable("delay", (), "s", "parameter", "fixed", "Delay of the measurements", 0.0, 0.0,
                 DELAY_MAX, multiple_of=STEP_SIZE),
        _error("dropout", 1, "1", (0.0, 1.0), "Share of ticks whose measurement is lost; the "
               "last one is held"),
        Variable("hand_pose_source", (), "", "parameter", "fixed", "Where the hand's pose, its "
                 "Jacobian and the bias force come from: the plant, or the robot's own model at "
                 "the measured joints", _DEFAULTS.hand_pose_source, kind="Enumeration",
                 choices=HAND_POSE_SOURCES),
        _error("block_position_error", 3, "m", (-0.5, 0.5), "Error of the block's measured "
               "position, world frame", fixed=True),
        _error("block_yaw_error", 1, "rad", (-3.2, 3.2), "Error of the block's measured yaw "
               "about the world's z axis", fixed=True),
        Variable("robot", (), "", "parameter", "fixed", "Arm whose model gives the hand's pose: "
                 "panda (Franka Emika Panda) or fr3 (Franka Research 3)", _DEFAULTS.robot,
                 kind="Enumeration", choices=tuple(ROBOTS)),
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
                 "table, as `panda-cosim inputs` writes it; empty: the built-in one. Only FMUs of "
                 "kind python read it", "", kind="String"),
    ),
    {"command": COMMANDS},
)  # fmt: skip


INTERFACES = MappingProxyType({"plant": PLANT, "controller": CONTROLLER})
ALL_INTERFACES = (PLANT, CONTROLLER, TRAJECTORY, SENSORS)


@dataclass(frozen=True)
class Connection:
    """One scalar output that feeds one scalar input, with factor * value + offset."""

    source: tuple[str, str]  # instance and output, such as ("plant", "jac[1,2]")
    target: tuple[str, str]  # instance and input
    factor: float = 1.0
    offset: float = 0.0  # in the target's unit
    converts_units: bool = True  # first, if the FMUs declare different ones
    converts_types: bool = False  # also where that rounds, or makes a number of a Boolean


def _measured() -> list[Connection]:
    """Connect the controller's measured inputs to the plant's outputs of the same names."""
    return [
        Connection(("plant", name), ("controller", name))
        for variable in CONTROLLER.of("input")
        if variable.name in MEASURED
        for name in variable.names()
    ]


CONNECTIONS = (
    *_measured(),
    *(Connection(("controller", name), ("plant", name)) for name in PLANT.variable("ctrl").names()),
)
