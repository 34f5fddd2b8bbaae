"""What the FMU of a model tells of its engine: how often it has warned."""

from __future__ import annotations

from typing import Final

from .variables import Variable

WARNINGS: Final = {  # MuJoCo's names of the kinds that do not end a simulation
    "INERTIA": "inertia matrix is too close to singular",
    "CONTACTFULL": "contacts left out, for want of memory",
    "CNSTRFULL": "constraints left out, for want of memory",
}
COUNTED: Final = Variable(
    "mujoco_warnings", (len(WARNINGS),), "1", "local", "discrete",
    "Warnings of the engine since the start", source="warnings",
    details=tuple(f"{name}: {text}; steps since the start" for name, text in WARNINGS.items()),
)  # fmt: skip
