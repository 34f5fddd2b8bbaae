"""What the FMU of a model tells of its engine: how often it has warned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from .own import read_table
from .variables import Variable

WARNINGS: Final[Mapping[str, str]] = read_table("engine")  # by MuJoCo's names of their kinds
COUNTED: Final = Variable(
    "mujoco_warnings", (len(WARNINGS),), "1", "local", "discrete",
    "Warnings of the engine since the start", source="warnings",
    details=tuple(f"{name}: {text}; steps since the start" for name, text in WARNINGS.items()),
)  # fmt: skip
