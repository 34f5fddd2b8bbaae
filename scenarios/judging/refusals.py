"""Conditions of the real robot's interface, under libfranka's names of the errors.

Sources: libfranka, include/franka/errors.h (franka::Errors); the FCI documentation, "libfranka",
section "Errors", says which limit each is about, and the robots' files in `assets` what it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

Level = Literal["wrong", "refused", "hint", "good"]

DERIVATIVES: Final = ("velocity", "acceleration", "jerk")
LATE: Final = {"lost_packets": "lost packets in a row", "delay_ms": "ms of delay"}
ARMS: Final = {"fer": "panda", "fr3": "fr3"}  # as the key `robot` of a scenario has them
# What to change; {robot} is put in.
MORE_TIME: Final = (
    "give that row more time: `panda-cosim retime SCENARIO --keep-times --robot {robot}`"
)
ELSEWHERE: Final = (
    "choose another path, or turn the hand: `panda-cosim route SCENARIO --robot {robot}`"
)
SMOOTH: Final = 'give that row more time; interpolation = "quintic" or "spline" has no kinks'
START: Final = "begin at the measured pose"
SETTLE: Final = "hold the last row until all joints are at rest: a longer `duration`"
SOFTER: Final = (
    "touch more gently, carry less, or set higher thresholds (setCollisionBehavior); friction and "
    "loads that the model lacks count, too"
)
TORQUE: Final = (
    "move or touch more gently; with noisy readings, lower controller.ik_gain or stiffness"
)
SMOOTHER: Final = "accelerate less: more time for that row, or a lower controller.limit_share"

# The same of joint positions, where rows are not the cause.
PERIOD: Final = "send a command every ms: controller.period = 0.001"
NO_REFERENCE: Final = 'use a law that limits its joint reference, as gains = "default" does'

_JOINT: Final = "joint_motion_generator"
_HAND: Final = "cartesian_motion_generator"
_LIMIT, _STEP, _JUMP = (
    "velocity_limits_violation",
    "velocity_discontinuity",
    "acceleration_discontinuity",
)


@dataclass(frozen=True)
class Check:
    """One condition of the interface; what aborts no motion is only recommended."""

    interface: str  # over which the run is sent: joint, cartesian, torque; or `arm`: by any
    error: str  # libfranka's name (franka::Errors)
    what: str
    unit: str
    remedy: str
    necessary: bool = True


def _three(key: str, interface: str, generator: str, what: str, remedy: str) -> dict[str, Check]:
    """Return the checks of a velocity, an acceleration and a jerk; `what` ends in the unit."""
    name, _, unit = what.rpartition(" ")
    errors = zip(DERIVATIVES, (_LIMIT, _STEP, _JUMP), ("", "^2", "^3"), strict=True)
    return {
        f"{key}_{rate}": Check(
            interface, f"{generator}_{error}", f"{rate} of {name}", f"{unit}/s{power}", remedy
        )
        for rate, error, power in errors
    }


# By the key of their largest share in summary.json.
CHECKS: Final[Mapping[str, Check]] = {
    "start_pose": Check("joint", "joint_position_motion_generator_start_pose_invalid",
                        "distance of the first command from joint", "rad", START),
    "joint_position": Check("joint", f"{_JOINT}_position_limits_violation", "position of joint",
                            "rad", ELSEWHERE),
    **_three("joint", "joint", _JOINT, "joint rad", MORE_TIME),
    "end_velocity": Check("joint", f"{_JOINT}_{_STEP}", "velocity at the end of joint", "rad/s",
                          SETTLE, necessary=False),
    "end_acceleration": Check("joint", f"{_JOINT}_{_JUMP}", "acceleration at the end of joint",
                              "rad/s^2", SETTLE, necessary=False),
    "start_place": Check("cartesian", "cartesian_position_motion_generator_start_pose_invalid",
                         "distance of the first command from the hand", "m", START),
    **_three("translation", "cartesian", _HAND, "the hand m", SMOOTH),
    **_three("rotation", "cartesian", _HAND, "the hand's turn rad", SMOOTH),
    **_three("elbow", "cartesian", _HAND, "the elbow rad", SMOOTH),
    "elbow_position": Check("cartesian", f"{_HAND}_elbow_limit_violation",
                            "position of the elbow", "rad", ELSEWHERE),
    "torque_rate": Check("torque", "controller_torque_discontinuity", "torque rate of joint",
                         "N.m/s", TORQUE),
    "torque": Check("arm", "tau_j_range_violation", "torque of joint", "N.m", TORQUE),
    "arm_position": Check("arm", "joint_position_limits_violation", "measured position of joint",
                          "rad", ELSEWHERE),
    "arm_velocity": Check("arm", "joint_velocity_violation", "measured velocity of joint", "rad/s",
                          MORE_TIME),
    "hand_velocity": Check("arm", "cartesian_velocity_violation", "measured velocity of the hand",
                           "m/s", MORE_TIME),
    "external_torque": Check("arm", "joint_reflex", "external torque of joint", "N.m", SOFTER),
    "external_force": Check("arm", "cartesian_reflex", "external force at the hand", "N", SOFTER),
    "external_moment": Check("arm", "cartesian_reflex", "external torque at the hand", "N.m",
                             SOFTER),
}  # fmt: skip


def outcome(preflight: Mapping[str, Any]) -> Iterator[tuple[Level, str]]:
    """Yield in lines what the robot would refuse, by that section of summary.json."""
    if not preflight:
        return
    robot, own = preflight["robot"], preflight["interface"]
    if preflight["refusals"] is None:
        yield "wrong", f"{robot}: signals that the {own} interface is judged by are not recorded"
    elif not preflight["refusals"]:
        yield "good", f"{robot} refuses nothing over the {own} interface"
    for each in preflight["findings"]:
        if not each["necessary"]:
            yield "hint", f"{robot} recommends against: {_text(each)}"
        elif each["interface"] in (own, "arm"):
            yield "refused", f"{robot} refuses: {_text(each)}"
        else:
            yield "hint", f"{robot} refuses over the {each['interface']} interface: {_text(each)}"
    if (preflight["refusals"] or 0) > 1:
        yield "hint", f"{robot} stops at the first refusal; later ones may follow from it"
    for key, each in preflight["late"].items() if not preflight["joint_refusals"] else ():
        borne = f"{preflight[key]} {LATE[key]}"
        yield "hint", f"{robot} tolerates {borne}; one more, and it refuses: {_text(each)}"


def _text(refusal: Mapping[str, Any]) -> str:
    """Describe the first violation of a condition."""
    row = f" (row {refusal['row']})" if refusal["row"] else ""
    joint = f" {refusal['joint']}" if refusal["what"].endswith("joint") else ""
    share = f" (in the run up to {refusal['share']:.3g} times it)" if "share" in refusal else ""
    return (
        f"{refusal['error']} at t = {refusal['time_s']:.3f} s{row}: {refusal['what']}{joint} is "
        f"{refusal['value']:.4g} {refusal['unit']}; the limit is {refusal['bound']:.4g} "
        f"{refusal['unit']}{share}; {refusal['remedy']}"
    )
