"""Gains of the control laws: ranges, defaults and presets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from typing import Final

from ..assets.franka import (
    BLOCK_WIDTH,
    GRIP_FORCE_MAX,
    GRIP_STIFFNESS,
    HOME_Q,
    OPENING_MAX,
    SERVO_LAG,
    SERVO_STIFFNESS,
    Seven,
)


def _seven(value: float) -> Seven:
    return (value,) * 7


_ZERO, _ONE = _seven(0.0), _seven(1.0)
KP: Final = _seven(8.0)  # [1]
INTEGRAL_LIMIT: Final = _seven(0.05)  # [rad]
# Joint 3 is pulled to its home, 0. This keeps the arm in one vertical plane, where moves up, down
# and outwards need joints 2, 4 and 6 only, and the elbow on its side. Joint 4 hardly moves in the
# null space; near singularities its pull keeps the stretched arm from folding the wrong way.
POSTURE_GAIN: Final = (0.0, 0.0, 4.0, 1.0, 0.0, 0.0, 0.0)  # [1/s]


# Lowest and highest allowed value of each: wide, but narrow enough to keep all sums finite.
RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "kp": (0.0, 1e4),
    "ki": (0.0, 1e6),
    "kd": (0.0, 1e3),
    "derivative_filter": (0.0, 1e3),
    "integral_limit": (0.0, 1e3),
    "base_ctrl": (-10.0, 10.0),
    "ik_gain": (0.0, 1e4),
    "ik_damping": (0.0, 10.0),
    "singular_damping": (0.0, 10.0),
    "singular_value": (0.0, 10.0),
    "linear_correction": (0.0, 1e3),
    "linear_braking": (0.0, 1e4),
    "angular_correction": (0.0, 1e3),
    "angular_braking": (0.0, 1e4),
    "posture": (-10.0, 10.0),
    "posture_gain": (0.0, 1e4),
    "servo_lag": (0.0, 10.0),
    "servo_stiffness": (1.0, 1e9),
    "gravity_feedforward": (0.0, 10.0),
    "inertia_feedforward": (0.0, 10.0),
    "limit_share": (1e-3, 100.0),  # above 1: shows what a command would need without limits
    "reference_lead": (1e-6, 10.0),
    "finger_speed": (0.0, 10.0),
    "grip_force": (0.0, GRIP_FORCE_MAX),
    "grip_width": (0.0, OPENING_MAX),
    "grip_stiffness": (1.0, 1e6),
}


@dataclass(frozen=True)
class Gains:
    """Gains and switches of the controller.

    Attributes:
        use_reference: True: a joint reference is integrated from the commanded velocity, and
            the PID acts on reference minus measured. False: the PID acts on the joint error
            that the pseudo-inverse gives, about `base_ctrl` (the tutorial's law).
        kp: Proportional gain of each joint's PID [1].
        ki: Integral gain [1/s].
        kd: Derivative gain [s].
        derivative_filter: Time constant of the derivative's low-pass [s]; 0: none.
        integral_limit: Largest magnitude of the PID's integral part [rad]; anti-windup.
        base_ctrl: Servo targets that the PID's output is added to [rad]; used without
            reference.
        ik_gain: Rate at which a pose error is driven to zero [1/s].
        ik_damping: Damping of the least squares where joint limits bind [1].
        singular_damping: Damping at a singularity [1].
        singular_value: Smallest singular value of the Jacobian below which damping grows [1].
        linear_correction: Largest speed of the correction of a position error [m/s].
        linear_braking: Deceleration as the position error goes to zero [m/s^2].
        angular_correction: Largest speed of the correction of an orientation error [rad/s].
        angular_braking: Deceleration as the orientation error goes to zero [rad/s^2].
        posture: Joint positions that the null space is pulled to [rad].
        posture_gain: Rate of that pull, per joint [1/s].
        servo_lag: Lag of each servo behind a ramp, fed forward [s].
        servo_stiffness: Stiffness of each servo, which scales forces to angles [N.m/rad].
        gravity_feedforward: Share of the bias force that is fed forward [1].
        inertia_feedforward: Share of the inertia force that is fed forward [1].
        limit_share: Share of the robot's limits that the joint reference may use [1].
        reference_lead: How far the joint reference may run ahead of a blocked joint [rad].
        finger_speed: Speed of each finger's command [m/s]; 0: unlimited.
        grip_force: Force of each finger on what is held, wherever the commanded opening is less
            than `grip_width` [N]; 0: the fingers go to the opening.
        grip_width: Width of what is held [m].
        grip_stiffness: Stiffness of each finger's servo, which makes an opening of a force [N/m].

    Raises:
        ValueError: A value is out of its range, see `RANGES`.
    """

    use_reference: bool = True
    kp: Seven = KP
    ki: Seven = _ZERO
    kd: Seven = _ZERO
    derivative_filter: float = 0.005
    integral_limit: Seven = INTEGRAL_LIMIT
    base_ctrl: Seven = HOME_Q
    ik_gain: float = 50.0
    ik_damping: float = 5e-3
    singular_damping: float = 0.04
    singular_value: float = 0.06
    linear_correction: float = 0.3
    linear_braking: float = 1.0
    angular_correction: float = 1.0
    angular_braking: float = 3.0
    posture: Seven = HOME_Q
    posture_gain: Seven = POSTURE_GAIN
    servo_lag: Seven = SERVO_LAG
    servo_stiffness: Seven = SERVO_STIFFNESS
    gravity_feedforward: Seven = _ONE
    inertia_feedforward: Seven = _ONE
    limit_share: float = 0.99
    reference_lead: float = 0.01
    finger_speed: float = 0.047
    grip_force: float = 0.0
    grip_width: float = BLOCK_WIDTH
    grip_stiffness: float = GRIP_STIFFNESS

    @property
    def law(self) -> str:
        """Name of the control law, see `controller.LAWS`."""
        return "reference" if self.use_reference else "tutorial"

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "use_reference":
                continue
            is_vector = isinstance(field.default, tuple)
            if isinstance(value, tuple) != is_vector:
                wanted = "a tuple of 7 numbers, one per joint" if is_vector else "a number"
                raise ValueError(f"{field.name}: {value!r}; must be {wanted}")
            numbers = value if is_vector else (value,)
            if is_vector and len(numbers) != 7:
                raise ValueError(f"{field.name}: {len(numbers)} values; must be 7, one per joint")
            low, high = RANGES[field.name]
            for i, number in enumerate(numbers, start=1):
                if not low <= number <= high:
                    place = f"{field.name}[{i}]" if is_vector else field.name
                    raise ValueError(
                        f"{place}: {number!r} is out of range; must be between {low:g} and {high:g}"
                    )


DEFAULT: Final = Gains()

# Gains, base and order of terms of the published tutorial (Collimator, Panda pick and place).
TUTORIAL: Final = Gains(
    use_reference=False,
    kp=_seven(10.0),
    ki=_seven(1.0),
    kd=_seven(0.01),
    derivative_filter=0.0,
    integral_limit=_seven(1e3),  # no anti-windup
    ik_gain=0.0,
    ik_damping=0.0,
    singular_damping=0.0,
    singular_value=0.0,
    posture_gain=_ZERO,
    servo_lag=_seven(0.0),
    gravity_feedforward=_seven(0.0),
    inertia_feedforward=_seven(0.0),
    finger_speed=0.0,
)

PRESETS: Final[Mapping[str, Gains]] = {"default": DEFAULT, "tutorial": TUTORIAL}


def preset(name: str, **changes: float | bool | Seven) -> Gains:
    """Return a named set of gains, with changes.

    Args:
        name: One of `PRESETS`.
        **changes: Fields of `Gains` with other values.

    Raises:
        ValueError: There is no such set, or a value is out of its range.
    """
    if name not in PRESETS:
        near = get_close_matches(name, PRESETS, n=1, cutoff=0.0)[0]
        raise ValueError(f"gains: {name!r} is not one of {', '.join(PRESETS)} (nearest: {near!r})")
    return replace(PRESETS[name], **changes)  # type: ignore[arg-type]
