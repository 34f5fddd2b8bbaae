"""The platforms that FMUs are built for."""

from __future__ import annotations

import platform as host
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ..errors import CosimError

_FILE: Final = Path(__file__).with_suffix(".toml")

PAGE: Final = "wasm32"  # no platform of FMUs, but where pages simulate


@dataclass(frozen=True)
class Platform:
    """A platform that FMUs are built for; platforms.toml says what each field is."""

    host: list[str]
    target: str
    fmi2: str
    fmi3: str
    wheel: str
    suffix: str
    mujoco: str
    in_wheel: str
    flags: list[str]


def targets() -> dict[str, Platform]:
    """Return all that libraries are compiled for: platforms, and pages."""
    rows = tomllib.loads(_FILE.read_text(encoding="utf-8"))
    return {name: Platform(**row) for name, row in rows.items()}


PLATFORMS: Final = {name: platform for name, platform in targets().items() if name != PAGE}


def this_platform() -> str:
    """Key in `PLATFORMS` of this machine."""
    here = [host.system(), host.machine()]
    for name, platform in PLATFORMS.items():
        if platform.host == here:
            return name
    raise CosimError(f"cannot build FMUs for {' '.join(here)}; known: {', '.join(PLATFORMS)}")
