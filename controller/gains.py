"""Gains of the control laws: ranges, defaults and presets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

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

# External torques at which a contact and a collision begin. 1 in 100 calibrated robots sets the
# block down so low, with 48 N or more, that joint 2 counts as collided.
CONTACT_TORQUE: Final[Seven] = (10.0, 10.0, 10.0, 10.0, 4.0, 4.0, 4.0)  # [N.m]
COLLISION_TORQUE: Final[Seven] = (20.0, 20.0, 20.0, 20.0, 8.0, 8.0, 8.0)  # [N.m]

REACTIONS: Final = ("none", "stop", "yield")
STIFFNESS_UNITS: Final = (*["N/m"] * 3, *["N.m/rad"] * 3)
WRENCH_UNITS: Final = (*["N"] * 3, *["N.m"] * 3)


def _gain(default: Any, unit: str | tuple[str, ...], low: float, high: float, text: str) -> Any:
    """Return the field of a gain between two values: wide, but all sums stay finite."""
    return field(default=default, metadata={"unit": unit, "range": (low, high), "text": text})


def switch(default: bool | str, text: str, choices: tuple[str, ...] = ()) -> Any:
    """Return the field of a switch, or of one of several names."""
    return field(default=default, metadata={"choices": choices, "text": text})


@dataclass(frozen=True)
class Gains:
    """Gains and switches of the controller; the FMU's interface checks their `RANGES`."""

    # fmt: off
    # True: a joint reference is integrated from the commanded velocity, and the PID acts on
    # reference minus measured. False: the PID acts on the joint error that the pseudo-inverse
    # gives, about `base_ctrl` (the tutorial's law).
    use_reference: bool = switch(True, "Integrate a joint reference; false: the tutorial's law")
    kp: Seven = _gain(KP, "1", 0.0, 1e4, "Proportional gain of each joint's PID")
    ki: Seven = _gain(_ZERO, "1/s", 0.0, 1e6, "Integral gain of each joint's PID")
    kd: Seven = _gain(_ZERO, "s", 0.0, 1e3, "Derivative gain of each joint's PID")
    derivative_filter: float = _gain(0.005, "s", 0.0, 1e3, "Time constant of the derivative's "
                                     "low-pass; 0: none")
    integral_limit: Seven = _gain(INTEGRAL_LIMIT, "rad", 0.0, 1e3, "Largest magnitude of the PID's "
                                  "integral part")
    base_ctrl: Seven = _gain(HOME_Q, "rad", -10.0, 10.0, "Servo targets that the PID's output is "
                             "added to if use_reference is false")
    ik_gain: float = _gain(50.0, "1/s", 0.0, 1e4, "Rate at which a pose error is driven to zero")
    error_filter: float = _gain(0.0, "s", 0.0, 1e3, "Time constant of the pose error's low-pass; "
                                "0: none")
    ik_damping: float = _gain(5e-3, "1", 0.0, 10.0, "Damping of the least-squares solution where "
                              "joint limits bind")
    singular_damping: float = _gain(0.04, "1", 0.0, 10.0, "Damping at a singularity")
    singular_value: float = _gain(0.06, "1", 0.0, 10.0, "Smallest singular value of the Jacobian "
                                  "below which damping grows")
    linear_correction: float = _gain(0.3, "m/s", 0.0, 1e3, "Largest speed of the correction of a "
                                     "position error")
    linear_braking: float = _gain(1.0, "m/s2", 0.0, 1e4, "Deceleration as the position error goes "
                                  "to zero")
    angular_correction: float = _gain(1.0, "rad/s", 0.0, 1e3, "Largest speed of the correction of "
                                      "an orientation error")
    angular_braking: float = _gain(3.0, "rad/s2", 0.0, 1e4, "Deceleration as the orientation error "
                                   "goes to zero")
    posture: Seven = _gain(HOME_Q, "rad", -10.0, 10.0, "Joint positions that the null space is "
                           "pulled to")
    posture_gain: Seven = _gain(POSTURE_GAIN, "1/s", 0.0, 1e4, "Rate at which the null space is "
                                "pulled to the posture")
    servo_lag: Seven = _gain(SERVO_LAG, "s", 0.0, 10.0, "Lag of each servo behind a ramp, fed "
                             "forward")
    servo_stiffness: Seven = _gain(SERVO_STIFFNESS, "N.m/rad", 1.0, 1e9, "Stiffness of each servo")
    gravity_feedforward: Seven = _gain(_ONE, "1", 0.0, 10.0, "Share of the bias force that is fed "
                                       "forward")
    inertia_feedforward: Seven = _gain(_ONE, "1", 0.0, 10.0, "Share of the inertia force that is "
                                       "fed forward")
    # Above 1, it shows what a command would need without limits.
    limit_share: float = _gain(0.99, "1", 1e-3, 100.0, "Share of the robot's limits that the joint "
                               "reference may use")
    reference_lead: float = _gain(0.01, "rad", 1e-6, 10.0, "How far the joint reference may run "
                                  "ahead of a blocked joint")
    finger_speed: float = _gain(0.047, "m/s", 0.0, 10.0, "Speed of each finger's command; 0: "
                                "unlimited")
    grip_force: float = _gain(0.0, "N", 0.0, GRIP_FORCE_MAX, "Force of each finger wherever the "
                              "commanded opening is less than grip_width; 0: the fingers go to the "
                              "opening")
    grip_width: float = _gain(BLOCK_WIDTH, "m", 0.0, OPENING_MAX, "Width of what is held")
    grip_stiffness: float = _gain(GRIP_STIFFNESS, "N/m", 1.0, 1e6, "Stiffness of each finger's "
                                  "servo")
    reading_delay: float = _gain(0.0, "s", 0.0, 0.02, "Age of the measured inputs, rounded to a "
                                 "whole number of periods; they are compared with the command and "
                                 "the reference of the time when they were taken")
    follow_posture: bool = switch(False, "The null space follows posture_cmd, instead of being "
                                  "pulled to posture and away from the joints' ends")
    posture_follow_gain: float = _gain(20.0, "1/s", 0.0, 1e4, "Rate at which an error of the "
                                       "commanded posture goes to zero")
    observer: bool = switch(False, "Compute external_torque, external_force and joint_contact, "
                            "also without a reaction")
    observer_gain: float = _gain(500.0, "1/s", 0.0, 1e4, "Inverse of the observer's time constant")
    lower_torque_threshold: Seven = _gain(CONTACT_TORQUE, "N.m", 0.0, 1e6,
                                          "External torque above which a joint is in contact")
    upper_torque_threshold: Seven = _gain(COLLISION_TORQUE, "N.m", 0.0, 1e6,
                                          "External torque above which a joint collides")
    reaction: str = switch("none", "What the arm does once a joint has collided, until this is "
                           "set to none: none; stop (hold the joints where they are); yield (give "
                           "way, held up against gravity alone); with impedance always none",
                           REACTIONS)
    robot: str = switch(DEFAULT_ROBOT, "Arm whose model and limits are used: panda (Franka Emika "
                        "Panda) or fr3 (Franka Research 3)", tuple(ROBOTS))
    impedance: bool = switch(False, "Cartesian impedance law: torques for the scene motors "
                             "instead of servo targets")
    stiffness: Six = _gain(STIFFNESS, STIFFNESS_UNITS, 1.0, 1e5, "Stiffness of the hand along and "
                           "about the world's axes, if impedance is true")
    spring_force: float = _gain(60.0, "N", 0.0, 1e4, "Largest force of the hand's springs")
    spring_torque: float = _gain(10.0, "N.m", 0.0, 1e4, "Largest torque of the hand's springs")
    damping_ratio: float = _gain(1.0, "1", 0.0, 10.0, "Damping ratio of each mode of the hand on "
                                 "its springs")
    offset_rate: float = _gain(4.0, "1/s", 0.0, 100.0, "Rate at which the wrench that the law's "
                               "model lacks is estimated, but not along axes of a commanded force")
    offset_limit: Six = _gain(OFFSET_LIMIT, WRENCH_UNITS, 0.0, 1e3, "Largest estimated wrench")
    posture_stiffness: float = _gain(20.0, "N.m/rad", 0.0, 1e4, "Stiffness of each joint towards "
                                     "the posture, in the null space")
    posture_damping: float = _gain(4.0, "N.m.s/rad", 0.0, 1e3, "Damping of each joint, in the null "
                                   "space")
    # fmt: on

    @property
    def law(self) -> str:
        """Name of the control law, see `controller.LAWS`."""
        if self.impedance:
            return "impedance"
        return "reference" if self.use_reference else "tutorial"


# Lowest and highest allowed value of each gain.
RANGES: Final[Mapping[str, tuple[float, float]]] = {
    gain.name: gain.metadata["range"] for gain in fields(Gains) if "range" in gain.metadata
}
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
    servo_lag=_ZERO,
    gravity_feedforward=_ZERO,
    inertia_feedforward=_ZERO,
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
    return replace(PRESETS[name], **changes)  # type: ignore[arg-type]
