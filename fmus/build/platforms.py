"""The platforms that FMUs are built for."""

from __future__ import annotations

import platform as host
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ..errors import CosimError

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
    rows = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    return {name: Platform(**row) for name, row in rows.items()}


PLATFORMS: Final = {name: platform for name, platform in targets().items() if name != PAGE}


def this_platform() -> str:
    """Key in `PLATFORMS` of this machine."""
    here = [host.system(), host.machine()]
    if names := [name for name, each in PLATFORMS.items() if each.host == here]:
        return names[0]
    raise CosimError(f"cannot build FMUs for {' '.join(here)}; known: {', '.join(PLATFORMS)}")
