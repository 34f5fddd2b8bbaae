"""The interface of PandaSensors, between plant and controller; `sensors.toml` has the words."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from ...controller.sensor_errors import SensorErrors
from .controller import CONTROLLER
from .own import parameters, read_table
from .plant import PLANT
from .variables import Interface, Variable

# Measured signals: inputs of the controller, and outputs of the plant of the same names.
MEASURED: Final = ("qpos", "qvel", "hand_xpos", "hand_xquat", "jac", "qfrc_bias")
SEEN: Final = ("target_xpos", "target_xmat")
INERTIA: Final = "mass_matrix"  # which the robot's own model tells
_TABLE: Final = read_table("sensors")


def measurement_of(name: str) -> str:
    """Return the name of the output with the measurement of a plant's output."""
    return f"{name}_measured"


def _truth(name: str) -> Variable:
    """Return the input of a true signal, which is like the controller's, or the plant's output."""
    like = PLANT.variable(name) if name in SEEN else CONTROLLER.variable(name)
    text = f"True {_TABLE['signal'][name]}"
    start = tuple(_TABLE["start"][name]) if name in SEEN else like.start
    return replace(like, causality="input", description=text, start=start, source="")


def _reading(name: str) -> Variable:
    """Return the output of a signal's measurement."""
    like = PLANT.variable(name) if name == INERTIA else _truth(name)
    text = f"Measured {_TABLE['signal'][name]}"
    parts = tuple((measurement_of(part), n, f"Measured: {text}") for part, n, text in like.parts)
    return replace(like, name=measurement_of(name), causality="output", description=text,
                   start=None, parts=parts, source="")  # fmt: skip


SENSORS = Interface(
    "PandaSensors",
    _TABLE["description"],
    (
        *map(_truth, (*MEASURED, *SEEN)),
        *map(_reading, (*MEASURED, *SEEN, INERTIA)),
        *parameters(_TABLE["parameter"], SensorErrors, _TABLE["fixed"]),
    ),
)
