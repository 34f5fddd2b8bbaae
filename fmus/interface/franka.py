"""The interface of FrankaInterface; `franka.toml` says what its variables are."""

from __future__ import annotations

from typing import Final

from ...assets.franka import HOME_Q, HOME_XPOS, HOME_XQUAT, OPENING_MAX
from ...controller.franka.signals import INPUTS, OUTPUTS, Settings
from .own import Values, parameters, read_table, signals
from .variables import Interface

_TABLE: Final = read_table("franka")
_VALUES: Final[dict[str, Values]] = {
    "qpos": ((*HOME_Q, OPENING_MAX / 2, OPENING_MAX / 2), None, None),
    "hand_xpos": (HOME_XPOS, None, None),
    "hand_xquat": (HOME_XQUAT, None, None),
}
FRANKA: Final = Interface(
    "FrankaInterface",
    _TABLE["description"],
    (
        *signals(_TABLE["input"], INPUTS, "input", _VALUES),
        *signals(_TABLE["output"], OUTPUTS, "output", variability="discrete"),
        *parameters(_TABLE["parameter"], Settings, fixed=_TABLE["parameter"]),
    ),
)
