"""Gains of the control laws: ranges, defaults and presets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Final

from ..assets.franka import (
    BLOCK_WIDTH,
    DEFAULT_ROBOT,
    GRIP_FORCE_MAX,
    GRIP_STIFFNESS,
    HOME_Q,
    OPENING_MAX,
    ROBOTS,
    SERVO_LAG,
    SERVO_STIFFNESS,
    Seven,
)

Six = tuple[float, float, float, float, float, float]


def _seven(value: float) -> Seven:
    return (value,) * 7


_ZERO, _ONE = _seven(0.0), _seven(1.0)
KP: Final = _seven(8.0)  # [1]
INTEGRAL_LIMIT: Final = _seven(0.05)  # [rad]
# Joint 3 is pulled to its home, 0. This keeps the arm in one vertical plane, where moves up, down
# and outwards need joints 2, 4 and 6 only, and the elbow on its side. Joint 4 hardly moves in the
# null space; near singularities its pull keeps the stretched arm from folding the wrong way.
POSTURE_GAIN: Final = (0.0, 0.0, 4.0, 1.0, 0.0, 0.0, 0.0)  # [1/s]

# Of the hand: the most that libfranka documents for `setCartesianImpedance`.
STIFFNESS: Final[Six] = (3000.0, 3000.0, 3000.0, 300.0, 300.0, 300.0)  # [N/m, N.m/rad]
OFFSET_LIMIT: Final[Six] = (20.0, 20.0, 20.0, 5.0, 5.0, 5.0)  # [N, N.m]

# External torques at which a contact and a collision begin. A calibrated robot that sets a block
# down too low presses with up to 18 N.m on joint 2.
CONTACT_TORQUE: Final[Seven] = (10.0, 10.0, 10.0, 10.0, 4.0, 4.0, 4.0)  # [N.m]
COLLISION_TORQUE: Final[Seven] = (20.0, 20.0, 20.0, 20.0, 8.0, 8.0, 8.0)  # [N.m]


# Lowest and highest allowed value of each: wide, but narrow enough to keep all sums finite.
RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "kp": (0.0, 1e4),
    "ki": (0.0, 1e6),
    "kd": (0.0, 1e3),
    "derivative_filter": (0.0, 1e3),
    "integral_limit": (0.0, 1e3),
    "base_ctrl": (-10.0, 10.0),
    "ik_gain": (0.0, 1e4),
    "error_filter": (0.0, 1e3),
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
    "stiffness": (1.0, 1e5),
    "spring_force": (0.0, 1e4),
    "spring_torque": (0.0, 1e4),
    "damping_ratio": (0.0, 10.0),
    "offset_rate": (0.0, 100.0),
    "offset_limit": (0.0, 1e3),
    "posture_stiffness": (0.0, 1e4),
    "posture_damping": (0.0, 1e3),
    "reading_delay": (0.0, 0.02),
    "posture_follow_gain": (0.0, 1e4),
    "observer_gain": (0.0, 1e4),
    "lower_torque_threshold": (0.0, 1e6),
    "upper_torque_threshold": (0.0, 1e6),
}
REACTIONS: Final = ("none", "stop", "yield")


@dataclass(frozen=True)
class Gains:
    """Gains and switches of the controller; a ValueError refuses what is outside its `RANGES`."""

    # True: a joint reference is integrated from the commanded velocity, and the PID acts on
    # reference minus measured. False: the PID acts on the joint error that the pseudo-inverse
    # gives, about `base_ctrl` (the tutorial's law).
    use_reference: bool = True
    kp: Seven = KP  # [1] proportional gain of each joint's PID
    ki: Seven = _ZERO  # [1/s] integral gain
    kd: Seven = _ZERO  # [s] derivative gain
    derivative_filter: float = 0.005  # [s] time constant of the derivative's low-pass; 0: none
    integral_limit: Seven = INTEGRAL_LIMIT  # [rad] largest magnitude of the integral part
    base_ctrl: Seven = HOME_Q  # [rad] that the PID's output is added to, without reference
    ik_gain: float = 50.0  # [1/s] rate at which a pose error is driven to zero
    error_filter: float = 0.0  # [s] time constant of the pose error's low-pass; 0: none
    ik_damping: float = 5e-3  # [1] of the least squares where joint limits bind
    singular_damping: float = 0.04  # [1] at a singularity
    singular_value: float = 0.06  # [1] smallest one of the Jacobian below which damping grows
    linear_correction: float = 0.3  # [m/s] largest speed of the correction of a position error
    linear_braking: float = 1.0  # [m/s^2] deceleration as the position error goes to zero
    angular_correction: float = 1.0  # [rad/s] largest correction of an orientation error
    angular_braking: float = 3.0  # [rad/s^2] deceleration as the orientation error goes to zero
    posture: Seven = HOME_Q  # [rad] joint positions that the null space is pulled to
    posture_gain: Seven = POSTURE_GAIN  # [1/s] rate of that pull
    servo_lag: Seven = SERVO_LAG  # [s] of each servo behind a ramp, fed forward
    servo_stiffness: Seven = SERVO_STIFFNESS  # [N.m/rad] scales forces to angles
    gravity_feedforward: Seven = _ONE  # [1] share of the bias force that is fed forward
    inertia_feedforward: Seven = _ONE  # [1] share of the inertia force that is fed forward
    limit_share: float = 0.99  # [1] of the robot's limits that the joint reference may use
    reference_lead: float = 0.01  # [rad] how far the reference may run ahead of a blocked joint
    finger_speed: float = 0.047  # [m/s] of each finger's command; 0: unlimited
    # [N] of each finger on what is held, wherever the commanded opening is less than `grip_width`;
    # 0: the fingers go to the opening.
    grip_force: float = 0.0
    grip_width: float = BLOCK_WIDTH  # [m] of what is held
    grip_stiffness: float = GRIP_STIFFNESS  # [N/m] of a finger's servo: an opening is a force
    # [s] age of the readings. They are compared with the command and the reference of their time.
    reading_delay: float = 0.0
    # True: the null space follows the commanded posture, instead of the pulls to `posture` and away
    # from the joints' ends.
    follow_posture: bool = False
    posture_follow_gain: float = 20.0  # [1/s] rate at which an error of that posture goes to zero
    observer: bool = False  # observe external torques, also without a reaction
    observer_gain: float = 500.0  # [1/s] inverse of its time constant
    lower_torque_threshold: Seven = CONTACT_TORQUE  # [N.m] external torque that is a contact
    upper_torque_threshold: Seven = COLLISION_TORQUE  # [N.m] that is a collision
    reaction: str = "none"  # to a collision, one of `REACTIONS`
    robot: str = DEFAULT_ROBOT  # whose arm and limits it is, one of `franka.ROBOTS`
    impedance: bool = False  # torques of `ImpedanceLaw` for motors, instead of servo targets
    stiffness: Six = STIFFNESS  # [N/m, N.m/rad] of the hand, along and about the world's axes
    spring_force: float = 60.0  # [N] largest force of these springs
    spring_torque: float = 10.0  # [N.m] largest torque
    damping_ratio: float = 1.0  # [1] of each mode of the hand on these springs
    offset_rate: float = 4.0  # [1/s] at which the wrench that the model lacks is found
    offset_limit: Six = OFFSET_LIMIT  # [N, N.m] largest such wrench
    posture_stiffness: float = 20.0  # [N.m/rad] of each joint in the null space
    posture_damping: float = 4.0  # [N.m.s/rad] the same

    @property
    def law(self) -> str:
        """Name of the control law, see `controller.LAWS`."""
        if self.impedance:
            return "impedance"
        return "reference" if self.use_reference else "tutorial"

    def __post_init__(self) -> None:
        for name, names in (("reaction", REACTIONS), ("robot", ROBOTS)):
            if (choice := getattr(self, name)) not in names:
                raise ValueError(f"{name}: {choice!r} is not one of {', '.join(names)}")
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            start = getattr(Gains, name)
            is_vector = isinstance(start, tuple)
            if isinstance(value, tuple) != is_vector or (is_vector and len(value) != len(start)):
                form = f"a tuple of {len(start)} numbers" if is_vector else "a number"
                raise ValueError(f"{name}: {value!r}; must be {form}")
            for i, number in enumerate(value if is_vector else (value,), start=1):
                if not low <= number <= high:
                    place = f"{name}[{i}]" if is_vector else name
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

# For noisy readings and elastic joints. Noise of the readings reaches the servos through kp, and
# through ik_gain as an acceleration, whose inertia force is fed forward: so the pose error is
# smoothed. docs/reference/mismatch.md has the margins beside those of other values.
ROBUST: Final = Gains(kp=_seven(0.5), ik_gain=5.0, error_filter=0.02)

PRESETS: Final[Mapping[str, Gains]] = {
    "default": DEFAULT,
    "robust": ROBUST,
    "tutorial": TUTORIAL,
    "impedance": Gains(impedance=True),
}


def preset(name: str, **changes: float | bool | str | Seven) -> Gains:
    """Return a named set of gains, with changes."""
    if name not in PRESETS:
        near = get_close_matches(name, PRESETS, n=1, cutoff=0.0)[0]
        raise ValueError(f"gains: {name!r} is not one of {', '.join(PRESETS)} (nearest: {near!r})")
    return replace(PRESETS[name], **changes)  # type: ignore[arg-type]
