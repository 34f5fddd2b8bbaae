"""What the robot reads and writes in a tick, and how it is set up; needs no MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass

from ...assets import STEP_SIZE
from ...assets.fields import bounded, layouts, switch

INPUTS, OUTPUTS = layouts(__file__)


@dataclass(frozen=True)
class Settings:
    """Where the robot listens, and the line between it and the program.

    `fmus/interface/franka.toml` says what each of them is.
    """

    address: str = switch("127.0.0.1")
    port: float = bounded(1337.0, "1", 1.0, 65535.0, 1.0)
    gripper_port: float = bounded(1338.0, "1", 1.0, 65535.0, 1.0)
    connection_timeout: float = bounded(0.0, "s", 0.0, 1e6)
    delay: float = bounded(0.0, "s", 0.0, 0.1, STEP_SIZE)
    dropout: float = bounded(0.0, "1", 0.0, 1.0)
    seed: float = bounded(0.0, "1", 0.0, 2.0**32 - 1, 1.0)
