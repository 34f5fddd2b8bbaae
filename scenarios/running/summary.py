"""The metrics of a run and its verdict, `summary.json`.

The file's layout (format 2): `format`, `scenario`, `complete`, `reason`, `success`, `expect`,
`as_expected`, `margin`, `criteria` (see `judging.criterion`), `events` [s], and one object each for
`tracking`, `orientation`, `block`, `contact`, `limits`, `first_limit`, `energy`, `timing`, whose
keys end with their units. A value that could not be measured is null. Format 1 lacks `expect`,
`as_expected`, `margin` and `events`, and of the criteria `direction`, `margin` and `reason`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...fmus.master.realtime import RunStatistics
from .. import rotations
from ..definition.scenario import Scenario
from ..definition.success import Success
from ..judging.bodies import judge_bodies
from ..judging.contacts import SIGNAL as UNWANTED
from ..judging.contacts import unwanted_contacts
from ..judging.criterion import Criterion, Direction, smallest_margin
from ..judging.events import (
    COMMAND,
    HELD_FORCE,
    LIFTED,
    Events,
    events,
    last_true,
    moving_rows,
    placed_row,
)
from ..judging.limits import first_limit, largest_share, limit_shares
from ..judging.verdict import judge_signals
from ..recording import Recording

Array = NDArray[np.float64]
Metrics = dict[str, Any]

FORMAT = 2


@dataclass(frozen=True)
class Summary:
    """Metrics of a run and its verdict.

    Attributes:
        scenario: Its name.
        complete: Whether it ran to its end.
        reason: Why not, or None.
        success: Whether it is complete and all criteria hold.
        criteria: The judged criteria, with values, bounds and margins.
        expect: What the scenario expects, "success" or "failure".
        expect_reason: Why it expects a failure, or "".
        as_expected: Whether it is complete, all criteria were measured, and it is a success or a
            failure as expected.
        margin: Smallest margin of the criteria; None: there are none, or one was not measured.
        events: Instants of grasp, release and so on [s]; None: did not happen.
        tracking: Metrics, as are all that follow; their keys have the units.
    """

    scenario: str
    complete: bool
    reason: str | None
    success: bool
    expect: str
    expect_reason: str
    as_expected: bool
    margin: float | None
    criteria: tuple[Criterion, ...]
    events: Events
    tracking: Metrics
    orientation: Metrics
    block: Metrics
    contact: Metrics
    limits: Metrics
    first_limit: Metrics
    energy: Metrics
    timing: Metrics
    format: int = field(default=FORMAT)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, as JSON holds them."""
        values = asdict(self)
        return {"format": values.pop("format"), **values}


def summarize(
    recording: Recording, scenario: Scenario, statistics: RunStatistics | None = None
) -> Summary:
    """Measure a run.

    Args:
        recording: The run's recording.
        scenario: The scenario with its success conditions.
        statistics: Timing of the stepping; None if only the recording is available.
    """
    happened = events(recording)
    tracking = _measured(_tracking, recording, "plant.hand_xpos", "controller.pos_cmd", *COMMAND)
    orientation = _measured(
        _orientation, recording, "plant.hand_xquat", "controller.quat_cmd", *COMMAND
    )
    block = _measured(
        lambda r: _block(r, scenario.success), recording, "plant.contact_force", "plant.qpos[16]",
        "plant.hand_xpos", "plant.hand_xquat",
    )  # fmt: skip
    limits = _measured(
        limit_shares,
        recording,
        "plant.qpos[16]",
        "plant.qvel[9]",
        "plant.actuator_force[7]",
        "controller.qvel_ref",
    )
    criteria = (
        *_criteria(scenario.success, tracking, orientation, block, limits),
        *judge_bodies(scenario.success.body, recording, happened),
        *judge_signals(scenario.success.signal, recording, happened),
    )
    holds = all(criterion.ok for criterion in criteria)
    judged = recording.complete and all(criterion.measured for criterion in criteria)
    return Summary(
        scenario=scenario.name,
        complete=recording.complete,
        reason=recording.reason,
        success=recording.complete and holds,
        expect=scenario.expect,
        expect_reason=scenario.expect_reason,
        as_expected=judged and holds == (scenario.expect == "success"),
        margin=smallest_margin(criteria),
        criteria=criteria,
        events=happened,
        tracking=tracking,
        orientation=orientation,
        block=block,
        contact={
            **_measured(_contact, recording, "plant.contact_force"),
            **_measured(unwanted_contacts, recording, UNWANTED),
        },
        limits=limits,
        first_limit=first_limit(recording),
        energy=_measured(_energy, recording, "plant.actuator_force[7]", "plant.qvel[9]"),
        timing=_timing(recording, statistics),
    )


def _measured(
    measure: Callable[[Recording], Metrics], recording: Recording, *signals: str
) -> Metrics:
    """Compute the metrics that the recorded signals allow; foreign FMUs may lack some."""
    return measure(recording) if all(name in recording for name in signals) else {}


def _contact(recording: Recording) -> Metrics:
    return {"peak_force_N": _peak(recording["plant.contact_force"])}


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _peak(values: Array) -> float | None:
    return float(np.max(np.abs(values))) if values.size else None


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _tracking(recording: Recording) -> Metrics:
    error = np.linalg.norm(recording["plant.hand_xpos"] - recording["controller.pos_cmd"], axis=1)
    moving = error[moving_rows(recording)]
    return {
        "rms_mm": _scaled(_rms(error), 1e3),
        "max_mm": _scaled(_peak(error), 1e3),
        "moving_rms_mm": _scaled(_rms(moving), 1e3),
        "moving_max_mm": _scaled(_peak(moving), 1e3),
    }


def _orientation(recording: Recording) -> Metrics:
    command, hand = recording["controller.quat_cmd"], recording["plant.hand_xquat"]
    turn = rotations.log(rotations.multiply(command, rotations.conjugate(hand)))
    angle = np.degrees(np.linalg.norm(turn, axis=1))
    return {"rms_deg": _rms(angle), "max_deg": _peak(angle)}


def _block(recording: Recording, success: Success) -> Metrics:
    qpos, force, time = recording["plant.qpos"], recording["plant.contact_force"], recording.time
    if not len(time):
        return {}
    position, quaternion = qpos[:, 9:12], qpos[:, 12:16]
    held = force > HELD_FORCE
    carried = held & (position[:, 2] > position[0, 2] + LIFTED)
    release = last_true(held)
    placed = None if release is None else placed_row(time, release)
    yaw, tilt = _yaw_and_tilt(quaternion[-1 if placed is None else placed])
    at = position[-1 if placed is None else placed]
    metrics: Metrics = {
        "lift_m": float(position[:, 2].max() - position[0, 2]),
        "final_position_m": position[-1].tolist(),
        "final_quaternion_wxyz": quaternion[-1].tolist(),
        "placed_at_s": None if placed is None else float(time[placed]),
        "release_s": None if release is None or release >= len(time) else float(time[release]),
        "max_tilt_deg": max(_yaw_and_tilt(q)[1] for q in quaternion[::50]),
        "tilt_deg": tilt,
        "yaw_deg": yaw,
        "yaw_error_deg": abs((yaw + 45.0) % 90.0 - 45.0),
        "slip_mm": _slip(recording, carried),
        "place_error_mm": None,
        "place_error_xyz_mm": None,
    }
    if success.block_position is not None:
        error = (at - np.array(success.block_position)) * 1e3
        metrics["place_error_mm"] = float(np.linalg.norm(error))
        metrics["place_error_xyz_mm"] = error.tolist()
    return metrics


def _yaw_and_tilt(quaternion: Array) -> tuple[float, float]:
    """Yaw and tilt [deg] of a body from its quaternion (w, x, y, z)."""
    w, x, y, z = quaternion.tolist()
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    tilt = math.acos(min(1.0, max(-1.0, 1 - 2 * (x * x + y * y))))
    return math.degrees(yaw), math.degrees(tilt)


def _slip(recording: Recording, carried: NDArray[np.bool_]) -> float | None:
    """Largest displacement of the block in the hand since it left the ground [mm]."""
    if not carried.any():
        return None
    block = recording["plant.qpos"][carried][:, 9:12]
    hand = recording["plant.hand_xpos"][carried]
    quaternion = recording["plant.hand_xquat"][carried]
    in_hand = rotations.rotate(rotations.conjugate(quaternion), block - hand)
    return float(np.linalg.norm(in_hand - in_hand[0], axis=1).max() * 1e3)


def _energy(recording: Recording) -> Metrics:
    """Work of the arm's servos; braking does not recover energy."""
    torque, speed = recording["plant.actuator_force"][:, :7], recording["plant.qvel"][:, :7]
    power = np.maximum(torque * speed, 0.0).sum(axis=1)
    return {"arm_work_J": float(power.sum() * STEP_SIZE), "peak_power_W": _peak(power)}


def _timing(recording: Recording, statistics: RunStatistics | None) -> Metrics:
    time = recording.time
    simulated = float(time[-1] - time[0]) if len(time) else 0.0
    commanded = all(name in recording for name in COMMAND)
    moving = np.flatnonzero(moving_rows(recording)) if commanded else np.zeros(0, dtype=int)
    timing: Metrics = {
        "simulated_s": simulated,
        "cycle_s": float(time[moving[-1]]) if len(moving) else 0.0,
        "steps": max(len(time) - 1, 0),
    }
    if statistics is not None:
        timing |= {
            "wall_s": statistics.wall_time,
            "real_time_factor": simulated / statistics.wall_time if statistics.wall_time else None,
            "overruns": statistics.overruns,
            "worst_lateness_s": statistics.worst_lateness,
        }
    return timing


def _criteria(
    success: Success, tracking: Metrics, orientation: Metrics, block: Metrics, limits: Metrics
) -> tuple[Criterion, ...]:
    """Compare the metrics with the success conditions, in the scenario file's units."""
    measured: list[tuple[str, float | None, str, Direction]] = [
        ("position_tolerance", _scaled(block.get("place_error_mm"), 1e-3), "m", "below"),
        ("max_yaw_error", block.get("yaw_error_deg"), "deg", "below"),
        ("max_tilt", block.get("tilt_deg"), "deg", "below"),
        ("tracking_rms", _scaled(tracking.get("rms_mm"), 1e-3), "m", "below"),
        ("tracking_max", _scaled(tracking.get("max_mm"), 1e-3), "m", "below"),
        ("orientation_rms", orientation.get("rms_deg"), "deg", "below"),
        ("min_lift", block.get("lift_m"), "m", "above"),
        ("max_slip", _scaled(block.get("slip_mm"), 1e-3), "m", "below"),
        ("max_limit_share", largest_share(limits), "1", "below"),
    ]
    return tuple(
        Criterion.judge(name, value, getattr(success, name), unit, direction)
        for name, value, unit, direction in measured
        if getattr(success, name) is not None
    )
