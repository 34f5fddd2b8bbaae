"""Gains of the control laws: defaults, units and ranges.

`fmus/interface/controller.toml` says what each of them is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Final

from ..assets.fields import bounded, switch
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

Six = tuple[float, ...]
ZERO: Final = (0.0,) * 7
# Joint 3 is pulled to its home, 0. This keeps the arm in one vertical plane, where moves up, down
# and outwards need joints 2, 4 and 6 only, and the elbow on its side. Joint 4 hardly moves in the
# null space; near singularities its pull keeps the stretched arm from folding the wrong way.
POSTURE_GAIN: Final = (0.0, 0.0, 4.0, 1.0, 0.0, 0.0, 0.0)

# Of the hand: the most that libfranka documents for `setCartesianImpedance`.
STIFFNESS: Final = (3000.0, 3000.0, 3000.0, 300.0, 300.0, 300.0)
OFFSET_LIMIT: Final = (20.0, 20.0, 20.0, 5.0, 5.0, 5.0)

# External torques at which a contact and a collision begin. 1 in 100 calibrated robots sets the
# block down so low, with 48 N or more, that joint 2 counts as collided.
CONTACT_TORQUE: Final = (10.0, 10.0, 10.0, 10.0, 4.0, 4.0, 4.0)
COLLISION_TORQUE: Final = (20.0, 20.0, 20.0, 20.0, 8.0, 8.0, 8.0)
REACTIONS: Final = ("none", "stop", "yield")


@dataclass(frozen=True)
class Gains:
    """Gains and switches of the controller: default, unit, lowest and highest value.

    The ranges are wide, but all sums stay finite within them. The FMU's interface checks them.
    """

    # True: a joint reference is integrated from the commanded velocity, and the PID acts on
    # reference minus measured. False: the PID acts on the joint error that the pseudo-inverse
    # gives, about `base_ctrl` (the tutorial's law).
    use_reference: bool = switch(True)
    # One PID per joint.
    kp: Seven = bounded((8.0,) * 7, "1", 0.0, 1e4)
    ki: Seven = bounded(ZERO, "1/s", 0.0, 1e6)
    kd: Seven = bounded(ZERO, "s", 0.0, 1e3)
    derivative_filter: float = bounded(0.005, "s", 0.0, 1e3)
    integral_limit: Seven = bounded((0.05,) * 7, "rad", 0.0, 1e3)
    base_ctrl: Seven = bounded(HOME_Q, "rad", -10.0, 10.0)
    # Differential inverse kinematics.
    ik_gain: float = bounded(50.0, "1/s", 0.0, 1e4)
    error_filter: float = bounded(0.0, "s", 0.0, 1e3)
    ik_damping: float = bounded(5e-3, "1", 0.0, 10.0)
    singular_damping: float = bounded(0.04, "1", 0.0, 10.0)
    singular_value: float = bounded(0.06, "1", 0.0, 10.0)
    linear_correction: float = bounded(0.3, "m/s", 0.0, 1e3)
    linear_braking: float = bounded(1.0, "m/s2", 0.0, 1e4)
    angular_correction: float = bounded(1.0, "rad/s", 0.0, 1e3)
    angular_braking: float = bounded(3.0, "rad/s2", 0.0, 1e4)
    posture: Seven = bounded(HOME_Q, "rad", -10.0, 10.0)
    posture_gain: Seven = bounded(POSTURE_GAIN, "1/s", 0.0, 1e4)
    # Feed-forward.
    servo_lag: Seven = bounded(SERVO_LAG, "s", 0.0, 10.0)
    servo_stiffness: Seven = bounded(SERVO_STIFFNESS, "N.m/rad", 1.0, 1e9)
    gravity_feedforward: Seven = bounded((1.0,) * 7, "1", 0.0, 10.0)
    inertia_feedforward: Seven = bounded((1.0,) * 7, "1", 0.0, 10.0)
    # Limits of the joint reference. A share above 1 shows what a command would need without them.
    limit_share: float = bounded(0.99, "1", 1e-3, 100.0)
    reference_lead: float = bounded(0.01, "rad", 1e-6, 10.0)
    # Gripper.
    finger_speed: float = bounded(0.047, "m/s", 0.0, 10.0)
    grip_force: float = bounded(0.0, "N", 0.0, GRIP_FORCE_MAX)
    grip_width: float = bounded(BLOCK_WIDTH, "m", 0.0, OPENING_MAX)
    grip_stiffness: float = bounded(GRIP_STIFFNESS, "N/m", 1.0, 1e6)
    # Of either law.
    reading_delay: float = bounded(0.0, "s", 0.0, 0.02)
    follow_posture: bool = switch(False)
    posture_follow_gain: float = bounded(20.0, "1/s", 0.0, 1e4)
    # Touch: the observer of external torques, and the reaction.
    observer: bool = switch(False)
    observer_gain: float = bounded(500.0, "1/s", 0.0, 1e4)
    lower_torque_threshold: Seven = bounded(CONTACT_TORQUE, "N.m", 0.0, 1e6)
    upper_torque_threshold: Seven = bounded(COLLISION_TORQUE, "N.m", 0.0, 1e6)
    reaction: str = switch("none", REACTIONS)
    robot: str = switch(DEFAULT_ROBOT, ROBOTS)
    # Cartesian impedance.
    impedance: bool = switch(False)
    stiffness: Six = bounded(STIFFNESS, "N/m, N.m/rad", 1.0, 1e5)
    spring_force: float = bounded(60.0, "N", 0.0, 1e4)
    spring_torque: float = bounded(10.0, "N.m", 0.0, 1e4)
    damping_ratio: float = bounded(1.0, "1", 0.0, 10.0)
    offset_rate: float = bounded(4.0, "1/s", 0.0, 100.0)
    offset_limit: Six = bounded(OFFSET_LIMIT, "N, N.m", 0.0, 1e3)
    posture_stiffness: float = bounded(20.0, "N.m/rad", 0.0, 1e4)
    posture_damping: float = bounded(4.0, "N.m.s/rad", 0.0, 1e3)

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
