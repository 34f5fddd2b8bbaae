"""The metrics of a run and its verdict, `summary.json`.

The file's layout (format 3): `format`, `scenario`, `complete`, `reason`, `success`, `expect`,
`as_expected`, `margin`, `criteria` (see `judging.criterion`), `events` [s], and one object each for
`tracking`, `orientation`, `block`, `contact`, `limits`, `first_limit`, `energy`, `timing`, whose
keys end with their units; `judging.definitions` says what each means. A value that could not be
measured is null. Format 2 had `block.max_tilt_deg` of each 50th row for `peak_tilt_deg`, other
definitions of slip, lift and events, and {} for a `first_limit` of null. Format 1 lacks `expect`,
`as_expected`, `margin` and `events`, and of the criteria `direction`, `margin` and `reason`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...fmus.master.master import RunStatistics
from .. import rotations
from ..fields import field_names
from ..judging.block import measure_block
from ..judging.bodies import judge_bodies
from ..judging.contacts import SIGNAL as UNWANTED
from ..judging.contacts import unwanted_contacts
from ..judging.criterion import Criterion, Direction, smallest_margin
from ..judging.definitions import DEFINITIONS
from ..judging.holds import COMMAND, Events, events, find_holds, moving_rows
from ..judging.limits import first_limit, largest_share, limit_shares
from ..judging.signals import judge_signals
from ..recording import Recording
from ..scenario.scenario import Scenario
from ..scenario.success import Success

Array = NDArray[np.float64]
Metrics = dict[str, Any]

FORMAT = 3


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
    first_limit: Metrics | None
    energy: Metrics
    timing: Metrics
    format: int = field(default=FORMAT, init=False)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, as JSON holds them."""
        values = asdict(self)
        return {"format": values.pop("format"), **values}


def summarize(
    recording: Recording, scenario: Scenario, statistics: RunStatistics | None = None
) -> Summary:
    """Measure a run."""
    held = find_holds(recording)
    happened = events(recording, held)
    measured = {
        "tracking": _measured(_tracking, recording, "plant.hand_xpos", *COMMAND),
        "orientation": _measured(_orientation, recording, "plant.hand_xquat", *COMMAND),
        "block": _measured(
            lambda r: measure_block(r, held, scenario.success.block_position), recording,
            "plant.contact_force", "plant.qpos[16]", "plant.hand_xpos", "plant.hand_xquat",
        ),
        "contact": {
            **_measured(_contact, recording, "plant.contact_force"),
            **_measured(unwanted_contacts, recording, UNWANTED),
        },
        "limits": limit_shares(recording),
        "energy": _measured(_energy, recording, "plant.actuator_force[7]", "plant.qvel[9]"),
        "timing": _timing(recording, happened, statistics),
    }  # fmt: skip
    criteria = (
        *_criteria(scenario.success, measured),
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
        first_limit=first_limit(recording),
        **measured,
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


def _energy(recording: Recording) -> Metrics:
    """Work of the arm's servos; braking does not recover energy."""
    torque, speed = recording["plant.actuator_force"][:, :7], recording["plant.qvel"][:, :7]
    power = np.maximum(torque * speed, 0.0).sum(axis=1)
    work = float(power[:-1] @ np.diff(recording.time)) if len(power) else None
    return {"arm_work_J": work, "peak_power_W": _peak(power)}


def _timing(recording: Recording, happened: Events, statistics: RunStatistics | None) -> Metrics:
    time = recording.time
    simulated = float(time[-1] - time[0]) if len(time) else 0.0
    timing: Metrics = {
        "simulated_s": simulated,
        "cycle_s": happened["command_end"] or 0.0,
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


def _criteria(success: Success, measured: Mapping[str, Metrics]) -> Iterator[Criterion]:
    """Compare the metrics with the success conditions, in the scenario file's units."""
    for name in field_names(Success):
        definition = DEFINITIONS.get(f"success.{name}")
        bound = getattr(success, name)
        if definition is not None and bound is not None:
            section, _, key = definition.metric.partition(".")
            value = measured[section].get(key) if key else largest_share(measured[section])
            if key.endswith("_mm"):
                value = _scaled(value, 1e-3)
            direction: Direction = "above" if definition.better == "higher" else "below"
            yield Criterion.judge(name, value, bound, definition.unit, direction)
