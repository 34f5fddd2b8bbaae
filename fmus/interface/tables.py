"""Which output of plant and controller feeds which input, and PandaTrajectory, which commands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

from .controller import COMMANDS, CONTROLLER
from .own import read_table
from .plant import PLANT
from .sensors import MEASURED
from .variables import Interface, Variable

TABLE_FILE: Final = "table.bin"  # float64, little-endian, one row of 14 per millisecond
_TABLE: Final = read_table("tables")
TRAJECTORY = Interface(
    "PandaTrajectory",
    _TABLE["description"],
    (
        *(replace(v, causality="output", start=None, minimum=None, maximum=None)
          for v in CONTROLLER.of("input") if v.name in COMMANDS),
        Variable("table", (), "", "parameter", "fixed", _TABLE["table"], "", kind="String"),
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
