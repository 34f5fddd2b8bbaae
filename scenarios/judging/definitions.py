"""What each number of a run means: one row per key of summary.json, event and criterion.

Help, tooltips and the site's tables are made of these rows; `tests/test_definitions.py` computes
the numbers again from them alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

from .refusals import CHECKS

Better = Literal["lower", "higher", ""]


@dataclass(frozen=True)
class Definition:
    """What one number means."""

    key: str  # in summary.json, such as `block.slip_mm`; of a criterion `success.` and its key
    what: str  # one phrase
    signals: tuple[str, ...] = ()  # recorded ones that it is computed from
    window: str = "all rows"  # which rows count
    unit: str = ""  # "" if it has none
    better: Better = ""  # whether a lower or a higher value is better
    unmeasured: str = ""  # when it is null, besides without rows or one of the signals
    metric: str = ""  # of a criterion: key of the number that it bounds

    @property
    def text(self) -> str:
        """The definition in one line, with the rows that count."""
        return self.what if self.window == "all rows" else f"{self.what}; {self.window}"


D = Definition
SENT: Final = ("controller.qpos_ref",)
POSE: Final = ("controller.pos_cmd", "controller.quat_cmd")
ARM: Final = ("plant.qpos", "plant.qvel", "plant.actuator_force", "plant.qfrc_bias", "plant.jac")
POSITION: Final = ("plant.hand_xpos", "controller.pos_cmd")
ROTATION: Final = ("plant.hand_xquat", "controller.quat_cmd")
COMMAND: Final = ("controller.pos_cmd", "controller.quat_cmd")
FORCE: Final = ("plant.contact_force",)
BLOCK: Final = ("plant.qpos",)
HELD: Final = (*FORCE, *BLOCK)
IN_HAND: Final = (*HELD, "plant.hand_xpos", "plant.hand_xquat", "controller.grip_cmd")
LANDED: Final = (*HELD, "controller.grip_cmd")
TORQUE: Final = ("plant.actuator_force",)
SPEED: Final = ("plant.qvel",)
REFERENCE: Final = ("controller.qvel_ref",)

SIGNALS: Final = {"joint": SENT, "cartesian": POSE, "torque": ARM, "arm": ARM}
WINDOWS: Final = {"start": "the first row", "end": "the last row"}

MOVING: Final = "rows at which the command moves"
CARRIED: Final = "from lift to release command of each hold"
AT_PLACED: Final = "at `placed`, else at the end"
TO_PLACED: Final = "from the last release command to `placed`"
NOT_HELD: Final = "the block is not held"
NOT_CARRIED: Final = "no hold lifts the block"

_ROWS: Final = (
    D("scenario", "the scenario's name"),
    D("complete", "whether the run reached its end"),
    D("reason", "why it did not", unmeasured="it did"),
    D("success", "whether it is complete and all criteria hold"),
    D("criteria", "of each criterion `name`, `value`, `bound`, `unit`, `ok`, `direction`, `margin` "
      "and `reason` (why it could not be measured)"),
    D("margin", "the smallest margin of all criteria: distance to the bound, divided by its "
      "magnitude (by 1 if it is 0); negative if missed", unit="1", better="higher",
      unmeasured="there are no criteria, or one could not be measured"),
    D("expect", "the verdict that the scenario expects, `success` or `failure`"),
    D("expect_reason", "why it expects a failure, or empty"),
    D("as_expected", "whether it is complete, every criterion was measured, and the verdict is as "
      "expected"),
    D("row_ends", "of each row of the table with `until` its `row`, `until` and `ended_s`, the "
      "instant at which it has ended early [s]; null: it never did"),
    # Events
    D("events.start", "the first row", (), unit="s"),
    D("events.grasp", "the first hold begins", FORCE, unit="s", unmeasured=NOT_HELD),
    D("events.lift", "the block is first more than 5 mm from where a hold began, while held", HELD,
      unit="s", unmeasured=NOT_CARRIED),
    D("events.release_command", "the gripper is commanded to open, in the last hold that ends",
      LANDED, unit="s", unmeasured="no hold ends"),
    D("events.release", "the last hold that ends does so", FORCE, unit="s",
      unmeasured="no hold ends"),
    D("events.placed", "half a second after `release`", FORCE, unit="s",
      unmeasured="no hold ends, the run ends before, or the block is held again by then"),
    D("events.command_end", "the command moves for the last time", COMMAND, unit="s",
      unmeasured="the command does not move"),
    D("events.at_rest", "from here to the end the hand is slower than 5 mm/s", POSITION[:1],
      unit="s", unmeasured="the hand moves at the end"),
    D("events.end", "the last row", (), unit="s"),
    D("events.collision", "a joint first collides, as an observer in the controller finds",
      ("controller.joint_contact",), unit="s", unmeasured="no joint does"),
    # Tracking
    D("tracking.rms_mm", "distance between hand and command, root mean square", POSITION, unit="mm",
      better="lower"),
    D("tracking.max_mm", "distance between hand and command, largest", POSITION, unit="mm",
      better="lower"),
    D("tracking.moving_rms_mm", "distance between hand and command, root mean square", POSITION,
      MOVING, "mm", "lower", "the command does not move"),
    D("tracking.moving_max_mm", "distance between hand and command, largest", POSITION,
      MOVING, "mm", "lower", "the command does not move"),
    D("orientation.rms_deg", "angle between hand and command, root mean square", ROTATION,
      unit="deg", better="lower"),
    D("orientation.max_deg", "angle between hand and command, largest", ROTATION, unit="deg",
      better="lower"),
    # Block
    D("block.holds", "each span in which the fingers press on the block with more than 0.5 N, in "
      "order; gaps below 50 ms belong to it, spans below 50 ms do not count", HELD),
    D("block.holds.grasp_s", "the hold's first row", FORCE, unit="s"),
    D("block.holds.lift_s", "the block's centre is first more than 5 mm from where it was at the "
      "hold's first row", HELD, "the hold", "s", "", "it stays within 5 mm"),
    D("block.holds.release_command_s", "the commanded opening begins to rise for the last time, to "
      "stay above what it was until the hold's end; the hold's end if it does not rise so", LANDED,
      "the hold", "s", "", "the hold lasts to the end, and it does not rise"),
    D("block.holds.release_s", "the first row after the hold", FORCE, unit="s",
      unmeasured="the hold lasts to the end"),
    D("block.holds.slip_mm", "largest displacement of the block in the hand's frame from where it "
      "was at the hold's lift", IN_HAND, "from lift to release command", "mm", "lower",
      "the hold does not lift the block"),
    D("block.lift_m", "largest height of the block above its height at the hold's first row; 0 if "
      "it is not held", HELD, "holds", "m", "higher"),
    D("block.slip_mm", "largest displacement of the block in the hand's frame from where it was at "
      "the hold's lift; the largest of all holds", IN_HAND, CARRIED, "mm", "lower",
      NOT_CARRIED),
    D("block.drop_mm", "how far the block's centre sinks when it is released", LANDED, TO_PLACED,
      "mm", "lower", "the block is not placed"),
    D("block.set_down_force_N", "largest force of the block on its support as it is set down",
      (*LANDED, "plant.support_force"), "from the last released hold's lift to `placed`", "N",
      "lower", "the block is not placed, or that hold does not lift it"),
    D("block.place_error_mm", "distance of the block's centre from `block_position`", HELD,
      AT_PLACED, "mm", "lower", "the scenario has no `block_position`"),
    D("block.place_error_xyz_mm", "the block's centre minus `block_position`, world axes", HELD,
      AT_PLACED, "mm", "", "the scenario has no `block_position`"),
    D("block.tilt_deg", "angle between the block's z axis and the world's", HELD, AT_PLACED, "deg",
      "lower"),
    D("block.peak_tilt_deg", "angle between the block's z axis and the world's, largest", BLOCK,
      unit="deg", better="lower"),
    D("block.yaw_deg", "turn of the block about z", HELD, AT_PLACED, "deg"),
    D("block.yaw_error_deg", "turn of the block about z to the nearest multiple of 90 deg", HELD,
      AT_PLACED, "deg", "lower"),
    D("block.release_s", "`events.release`", FORCE, unit="s", unmeasured="no hold ends"),
    D("block.placed_at_s", "`events.placed`", FORCE, unit="s", unmeasured="it is not placed"),
    D("block.final_position_m", "the block's centre, world frame", BLOCK, "the last row", "m"),
    D("block.final_quaternion_wxyz", "the block's orientation, world frame", BLOCK, "the last row",
      "1"),
    # Contact
    D("contact.peak_force_N", "force of the fingers on the block, largest", FORCE, unit="N",
      better="lower"),
    D("contact.unwanted_force_N", "sum of the normal forces of unwanted contacts, largest",
      ("plant.unwanted_contact_force",), unit="N", better="lower"),
    D("contact.unwanted", "of each pair of bodies in an unwanted contact `bodies`, `time_s` and "
      "`end_s` of the first and the last row, and `force_N`, the largest sum on these",
      ("plant.unwanted_contact_force", *BLOCK)),
    # Limits, largest share of each joint or finger
    D("limits.position_share", "joint position from the middle of its range, per half range", BLOCK,
      unit="1", better="lower"),
    D("limits.velocity_share", "joint velocity", SPEED, unit="1", better="lower"),
    D("limits.torque_share", "torque of the joint's servo", TORQUE, unit="1", better="lower"),
    D("limits.torque_rate_share", "change of the servo's torque from row to row", TORQUE,
      "from the second after the torques first differ from 0, as the servos switch on", "1",
      "lower"),
    D("limits.finger_speed_share", "speed of each finger", SPEED, unit="1", better="lower"),
    D("limits.reference_velocity_share", "velocity of the joint reference", REFERENCE, unit="1",
      better="lower"),
    D("limits.reference_acceleration_share", "change of the joint reference's velocity between "
      "updates of the controller", REFERENCE, unit="1", better="lower"),
    D("limits.reference_jerk_share", "change of that acceleration between updates", REFERENCE,
      unit="1", better="lower"),
    D("limits.not_measured", "why shares are missing, by name"),
    D("first_limit", "the first limit that bound: `time_s`, `joint`, `kind` (`position`, "
      "`velocity`, `acceleration` or `jerk` of the joint reference; `torque`: the servo has none "
      "left; with impedance `torque` or `torque rate` of the motor)",
      ("controller.limit", *TORQUE), unmeasured="none bound"),
    # Preflight: the run over the interface of a real robot
    D("preflight.robot", "the robot, `fer` or `fr3`"),
    D("preflight.interface", "how the run is sent: `joint` positions, or `torque` where the arm "
      "has motors"),
    D("preflight.refusals", "violated conditions, of that interface and of the arm "
      "itself; each aborts the motion", (*SENT, *ARM), unit="1", better="lower"),
    D("preflight.first_s", "the first of them", unit="s", unmeasured="none is violated"),
    *(D(f"preflight.{name}_refusals", f"violated conditions of {what}", unit="1",
        better="lower", unmeasured="one of them was not measured")
      for name, what in (("joint", "joint positions"), ("cartesian", "poses of the hand"),
                         ("torque", "torques"), ("arm", "the arm itself"))),
    D("preflight.lost_packets", "most commands in a row that may be lost, anywhere; the robot "
      "keeps its acceleration meanwhile", SENT, unit="1", better="higher",
      unmeasured="torques are sent"),
    D("preflight.delay_ms", "largest delay that the commands may begin to have, anywhere; the "
      "robot keeps its acceleration until the next comes", SENT, unit="ms", better="higher",
      unmeasured="torques are sent"),
    *(D(f"preflight.{key}_share", f"{check.what}: largest share of its limit"
        f"{'' if check.necessary else ' (recommended)'}",
        SENT if key.startswith("elbow") else SIGNALS[check.interface],
        WINDOWS.get(key.partition("_")[0], "all rows"), "1", "lower")
      for key, check in CHECKS.items()),
    D("preflight.findings", "of each violated condition `name`, `interface`, libfranka's "
      "`error`, `what`, `unit`, `remedy`, whether it is `necessary`, and of the first time "
      "`time_s`, `row` of the table, `joint`, `value` and `bound`, and the largest `share`"),
    D("preflight.late", "the same with one more lost packet, or ms of delay"),
    # Energy
    D("energy.arm_work_J", "work of the arm's servos: positive power summed over joints and time; "
      "braking returns nothing", (*TORQUE, *SPEED), unit="J", better="lower"),
    D("energy.peak_power_W", "sum over the joints of their servos' positive power, largest",
      (*TORQUE, *SPEED), unit="W", better="lower"),
    # Timing
    D("timing.simulated_s", "from the first to the last row", (), unit="s"),
    D("timing.cycle_s", "until the command stops moving (`events.command_end`); 0 if it does not "
      "move", COMMAND, unit="s", better="lower"),
    D("timing.steps", "steps of the master", (), unit="1"),
    D("timing.wall_s", "time that the run took on this machine", (), "the run", "s", "lower"),
    D("timing.real_time_factor", "`simulated_s` / `wall_s`", (), "the run", "1", "higher"),
    D("timing.overruns", "steps that ended late, in real time", (), "the run", "1", "lower"),
    D("timing.worst_lateness_s", "how late the latest step ended, in real time", (), "the run", "s",
      "lower"),
    # Criteria about bodies, at the instant `at`, and reductions of signals, from `from` to `to`
    D("success.body.tolerance", "distance of the body's origin from `position`", (), "at `at`", "m",
      "lower"),
    D("success.body.max_tilt", "angle between the body's z axis and the world's", (), "at `at`",
      "deg", "lower"),
    D("success.body.max_shift", "distance of the body's origin from where it started", (),
      "at `at`", "m", "lower"),
    D("success.body.min_lift", "height of the body's origin above its start", (), "at `at`", "m",
      "higher"),
)  # fmt: skip

# Criterion: the number that it bounds, and the bound's unit.
_CRITERIA: Final = {
    "position_tolerance": ("block.place_error_mm", "m"),
    "max_yaw_error": ("block.yaw_error_deg", "deg"),
    "max_tilt": ("block.tilt_deg", "deg"),
    "tracking_rms": ("tracking.rms_mm", "m"),
    "tracking_max": ("tracking.max_mm", "m"),
    "orientation_rms": ("orientation.rms_deg", "deg"),
    "min_lift": ("block.lift_m", "m"),
    "max_slip": ("block.slip_mm", "m"),
    "max_drop": ("block.drop_mm", "m"),
    "max_set_down_force": ("block.set_down_force_N", "N"),
    "max_unwanted_force": ("contact.unwanted_force_N", "N"),
    "max_refusals": ("preflight.refusals", "1"),
}

_METRICS: Final = {row.key: row for row in _ROWS}
_BOUNDED: Final = (
    *(replace(_METRICS[key], key=f"success.{name}", unit=unit, metric=key)
      for name, (key, unit) in _CRITERIA.items()),
    D("success.max_limit_share", "largest share of any limit of the robot; 1 is the limit",
      unit="1", better="lower", unmeasured="no limit could be measured", metric="limits"),
)  # fmt: skip
DEFINITIONS: Final[Mapping[str, Definition]] = _METRICS | {row.key: row for row in _BOUNDED}
