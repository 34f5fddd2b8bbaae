"""Tolerances of a run against its reference: a tube around each signal, in value and in time.

The defaults suit an arm that touches nothing. Changing one start value by 1e-10 moves a run by a
thousandth of them; a proportional gain that is 5 % too low moves it by ten times their size, most
visibly in `controller.dq`, the joint error. Grasping and releasing amplify rounding; `scale` widens
all tubes of such a scenario.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from ...assets import STEP_SIZE
from ...fmus.errors import InputError, did_you_mean, excerpt
from ..fields import Quantity

TIME: Final = STEP_SIZE  # [s] an event may fall into the next tick by rounding
_TIME = Quantity(0.0, 1.0, "s")  # a wider tube would hide real differences
_SCALE = Quantity(1e-3, 1e6)
_VALUE = Quantity(1e-15, 1e6)  # in any unit

# Half-width of the tube of each compared signal, by unit. Signals that follow from these (Jacobian,
# bias force, top of the block, hand and joint velocities) are not compared.
COMPARED: Final[Mapping[str, Mapping[str, float]]] = {
    "controller.pos_cmd": {"m": 1e-6},
    "controller.quat_cmd": {"1": 1e-6},
    "controller.vel_cmd": {"m/s": 1e-5},
    "controller.omega_cmd": {"rad/s": 1e-5},
    "controller.grip_cmd": {"m": 1e-6},
    "controller.ctrl": {"rad": 1e-5, "1": 0.1},  # joints; gripper, 0 to 255
    "controller.dq": {"rad": 3e-7},
    "controller.qvel_ref": {"rad/s": 5e-5},
    "controller.singular": {"1": 0.5},
    "controller.limit": {"1": 0.5},
    "plant.hand_xpos": {"m": 1e-6},
    "plant.hand_xquat": {"1": 1e-6},
    "plant.actuator_force": {"N.m": 0.1, "N": 0.3},
    "plant.contact_force": {"N": 1.0},
}
# qpos holds quantities of several kinds, by index.
_JOINTS, _FINGERS, _BLOCK_CENTRE, _BLOCK_QUATERNION = 5e-6, 5e-6, 2e-5, 2e-4  # rad, m, m, 1
_QPOS: Final = (_JOINTS,) * 7 + (_FINGERS,) * 2 + (_BLOCK_CENTRE,) * 3 + (_BLOCK_QUATERNION,) * 4

SIGNALS: Final = (*COMPARED, "plant.qpos")
# Half-width for the signals of FMUs that are not ours, all of which are compared, in any unit.
OTHERS: Final = 1e-6
_OURS: Final = ("plant", "controller", "sensors")
_OWN: Final = ("time", "scale")
_ELEMENT = re.compile(r"(?P<signal>.+?)(\[(?P<index>[1-9]\d?)\])?", re.A)


@dataclass(frozen=True)
class Tolerances:
    """A scenario's section [regression]."""

    time: float = TIME  # half-width of all tubes in time [s]
    scale: float = 1.0  # factor on the defaults [1]
    # Half-widths in value that replace the defaults, by signal (`plant.hand_xpos`) or element
    # (`plant.qpos[10]`), in the signal's own unit.
    values: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", _TIME.check("[regression] time", self.time))
        object.__setattr__(self, "scale", _SCALE.check("[regression] scale", self.scale))
        for name in self.values:
            if not is_compared(name):
                raise InputError(
                    f"[regression] key {excerpt(name)} is unknown; valid: {', '.join(_OWN)}, "
                    f"{', '.join(SIGNALS)}, or an element such as plant.qpos[10]"
                    f"{did_you_mean(name, (*_OWN, *SIGNALS))}"
                )
        checked = {n: _VALUE.check(f"[regression] {n}", value) for n, value in self.values.items()}
        object.__setattr__(self, "values", checked)

    @classmethod
    def of(cls, section: object) -> Tolerances:
        """Make them from a scenario file's section: `time`, `scale`, and the values by name."""
        if isinstance(section, cls):
            return section
        if not isinstance(section, Mapping):
            raise InputError("key regression: must be a section [regression]")
        values: dict[str, Any] = {}
        for name, value in section.items():
            if isinstance(value, Mapping):  # plant.hand_xpos without quotes
                values |= {f"{name}.{signal}": inner for signal, inner in value.items()}
            elif name not in _OWN:
                values[name] = value
        own: dict[str, Any] = {name: section[name] for name in _OWN if name in section}
        return cls(**own, values=values)

    def value(self, column: str, unit: str) -> float:
        """Return the half-width of a column's tube, in its unit."""
        signal, index = split(column)
        for name in (column, signal):
            if name in self.values:
                return self.values[name]
        if signal not in SIGNALS:
            return self.scale * OTHERS
        if signal == "plant.qpos":  # without an index, that of a model with a single joint
            return self.scale * _QPOS[min(index or 1, len(_QPOS)) - 1]
        by_unit = COMPARED[signal]
        return self.scale * by_unit.get(unit, min(by_unit.values()))


def split(column: str) -> tuple[str, int | None]:
    """Return a column's signal and its index, from 1; None if it does not have exactly one."""
    match = _ELEMENT.fullmatch(column)
    if match is None or match["index"] is None:
        return column, None
    return match["signal"], int(match["index"])


def is_compared(column: str) -> bool:
    """Whether a recording's column is compared with the reference."""
    instance, dot, _ = column.partition(".")
    return split(column)[0] in SIGNALS or (bool(dot) and instance not in _OURS)
