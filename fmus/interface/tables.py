"""All interfaces, and which output feeds which input."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from .controller import COMMANDS, CONTROLLER
from .plant import PLANT
from .sensors import MEASURED, SENSORS
from .trajectory import TRAJECTORY

__all__ = ["ALL_INTERFACES", "COMMANDS", "CONNECTIONS", "INTERFACES", "Connection"]

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
