"""Named sets of gains, those of presets.toml, and which gains each law has."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

from ..assets.franka import Seven
from .gains import Gains

_NAMES: Final = [gain.name for gain in fields(Gains)]

# Gains that only the impedance law has, and that only the laws with servos have.
OF_IMPEDANCE: Final = frozenset(
    _NAMES[_NAMES.index("stiffness") : _NAMES.index("posture_damping") + 1]
)
OF_SERVOS: Final = frozenset(
    _NAMES[_NAMES.index("kp") : _NAMES.index("inertia_feedforward") + 1]
) - {"base_ctrl", "posture"}
DEFAULT: Final = Gains()
_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def _gains(table: Mapping[str, Any]) -> Gains:
    values: Any = {name: tuple(v) if isinstance(v, list) else v for name, v in table.items()}
    return replace(DEFAULT, **values)


PRESETS: Final[Mapping[str, Gains]] = {name: _gains(table) for name, table in _TABLES.items()}


def preset(name: str, **changes: float | bool | str | Seven) -> Gains:
    """Return a named set of gains, with changes."""
    return replace(PRESETS[name], **changes)  # type: ignore[arg-type]
