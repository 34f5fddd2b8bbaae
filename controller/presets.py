"""Named sets of gains, and which gains each law has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Final

from ..assets.franka import Seven
from .gains import ZERO, Gains

_NAMES: Final = [gain.name for gain in fields(Gains)]
# Gains that only the impedance law has, and that only the laws with servos have.
OF_IMPEDANCE: Final = frozenset(_NAMES[_NAMES.index("stiffness") :])
OF_SERVOS: Final = frozenset(_NAMES[_NAMES.index("kp") : _NAMES.index("limit_share")]) - {
    "base_ctrl", "posture",
}  # fmt: skip
DEFAULT: Final = Gains()

# Gains, base and order of terms of the published tutorial (Collimator, Panda pick and place).
TUTORIAL: Final = Gains(
    use_reference=False,
    kp=(10.0,) * 7,
    ki=(1.0,) * 7,
    kd=(0.01,) * 7,
    derivative_filter=0.0,
    integral_limit=(1e3,) * 7,  # no anti-windup
    ik_gain=0.0,
    ik_damping=0.0,
    singular_damping=0.0,
    singular_value=0.0,
    posture_gain=ZERO,
    servo_lag=ZERO,
    gravity_feedforward=ZERO,
    inertia_feedforward=ZERO,
    finger_speed=0.0,
)

# For noisy readings and elastic joints. Noise of the readings reaches the servos through kp, and
# through ik_gain as an acceleration, whose inertia force is fed forward: so the pose error is
# smoothed. docs/reference/mismatch.md has the margins beside those of other values.
ROBUST: Final = Gains(kp=(0.5,) * 7, ik_gain=5.0, error_filter=0.02)

PRESETS: Final[Mapping[str, Gains]] = {
    "default": DEFAULT,
    "robust": ROBUST,
    "tutorial": TUTORIAL,
    "impedance": Gains(impedance=True),
}


def preset(name: str, **changes: float | bool | str | Seven) -> Gains:
    """Return a named set of gains, with changes."""
    return replace(PRESETS[name], **changes)  # type: ignore[arg-type]
