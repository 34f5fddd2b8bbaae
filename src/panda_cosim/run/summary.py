"""Measures and judges a run: makes its summary."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ..fmus.master.master import RunStatistics
from ..fmus.master.wiring import Array
from ..result.judging.block import measure_block
from ..result.judging.contacts import SIGNAL as UNWANTED
from ..result.judging.contacts import unwanted_contacts
from ..result.judging.criterion import Criterion
from ..result.judging.holds import COMMAND, Events, events, find_holds, moving_rows
from ..result.judging.limits import all_lacking, first_limit, largest_share, limit_shares
from ..result.judging.signals import judge_bodies, judge_signals
from ..result.judging.summary import Metrics, Summary
from ..result.judging.verdict import Verdict
from ..result.judging.verdicts import ENDED
from ..result.recording import Recording, by_rows
from ..task import rotations
from ..task.criteria import Direction, Success, split_instant
from ..task.fields import field_names
from ..task.scenario import Scenario

if TYPE_CHECKING:
    from ..result.judging.definitions import Definition

_HAND, _FORCE = ("plant.hand_xpos", "plant.hand_xquat"), "plant.contact_force"
# Signals without which a section is empty; foreign FMUs may lack some.
NEEDED: Final[Mapping[str, tuple[str, ...]]] = {
    "tracking": (_HAND[0], COMMAND[0]),
    "orientation": (_HAND[1], COMMAND[1]),
    "block": (_FORCE, "plant.qpos[16]", *_HAND),
    "contact": (UNWANTED,),  # but for its peak
    "energy": ("plant.actuator_force[7]", "plant.qvel[9]", _HAND[0]),
}


def summarize(
    recording: Recording,
    scenario: Scenario,
    statistics: RunStatistics | None = None,
    end: Verdict = ENDED,
) -> Summary:
    """Measure a run; `end`: how it ended, if it is not complete."""
    statistics, about = statistics or RunStatistics(), recording.metadata
    held = find_holds(recording)
    happened = events(recording, held)
    success, counts = scenario.success, about.get("engine", {})
    if any(counts.values()) and success.max_engine_warnings is None:
        success = replace(success, max_engine_warnings=0.0)
    measures: dict[str, Callable[[Recording], Metrics]] = {
        "tracking": _tracking,
        "orientation": _orientation,
        "block": partial(measure_block, held=held, goal=success.block_position),
        "contact": unwanted_contacts,
        "energy": _energy,
    }
    peak = {"peak_force_N": _peak(recording[_FORCE])} if _FORCE in recording else {}
    measured = {
        name: measure(recording) if all(each in recording for each in NEEDED[name]) else {}
        for name, measure in measures.items()
    }
    measured |= {
        "contact": peak | measured["contact"],
        "limits": limit_shares(recording),
        "preflight": _preflight(recording, scenario.preflight),
        "engine": {"warnings": sum(counts.values()) if counts else None},
        "timing": _timing(recording, happened, statistics),
    }
    criteria = (
        *_criteria(success, measured, recording),
        *judge_bodies(success.body, recording, happened),
        *judge_signals(success.signal, recording, happened),
    )
    return Summary(
        scenario=scenario.name,
        complete=recording.complete,
        reason=recording.reason,
        end=end,
        expect=scenario.expect,
        expect_reason=scenario.expect_reason,
        criteria=criteria,
        events=happened,
        first_limit=first_limit(recording),
        stepped_by=statistics.stepped_by,
        code=about.get("code", {}),
        profile=statistics.spent,
        order=tuple(about.get("order", ())),
        late=tuple(about.get("late", ())),
        row_ends=tuple(about.get("row_ends", ())),
        **measured,
    )


def _preflight(recording: Recording, robot: str) -> Metrics:
    if not robot:
        return {}
    from ..result.judging.preflight import preflight  # noqa: PLC0415 - imports MuJoCo, which is slow

    return preflight(recording, robot)


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _peak(values: Array) -> float | None:
    return float(np.max(np.abs(values))) if values.size else None


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _tracking(recording: Recording) -> Metrics:
    places = ("plant.hand_xpos", "controller.pos_cmd")
    error = by_rows(recording, lambda hand, cmd: np.linalg.norm(hand - cmd, axis=1), *places)
    moving = error[moving_rows(recording)]
    return {
        "rms_mm": _scaled(_rms(error), 1e3),
        "max_mm": _scaled(_peak(error), 1e3),
        "moving_rms_mm": _scaled(_rms(moving), 1e3),
        "moving_max_mm": _scaled(_peak(moving), 1e3),
    }


def _orientation(recording: Recording) -> Metrics:
    places = ("controller.quat_cmd", "plant.hand_xquat")
    angle = by_rows(recording, rotations.angle_deg, *places)
    return {"rms_deg": _rms(angle), "max_deg": _peak(angle)}


def _energy(recording: Recording) -> Metrics:
    """Work of the arm's servos; braking does not recover energy."""
    power = by_rows(recording, _positive, "plant.actuator_force", "plant.qvel")
    # A row's torques are those of the step that ends there.
    work = float(power[1:] @ np.diff(recording.time)) if len(power) else None
    return {"arm_work_J": work, "peak_power_W": _peak(power)}


def _positive(torque: Array, speed: Array) -> Any:
    return np.maximum(torque[:, :7] * speed[:, :7], 0.0).sum(axis=1)


def _timing(recording: Recording, happened: Events, statistics: RunStatistics) -> Metrics:
    time, wall = recording.time, statistics.wall_time
    simulated = float(time[-1] - time[0]) if len(time) else 0.0
    is_commanded = all(name in recording for name in COMMAND)
    return {
        "simulated_s": simulated,
        "cycle_s": (happened["command_end"] or 0.0) if is_commanded else None,
        "steps": max(len(time) - 1, 0),
        "wall_s": wall,
        "real_time_factor": simulated / wall if wall else None,
        "overruns": statistics.overruns,
        "worst_lateness_s": statistics.worst_lateness,
    }


def unrecorded(success: Success, recorded: Container[str]) -> Iterator[str]:
    """Say of each criterion on a metric which signal it lacks."""
    for name, _, definition in _asked(success):
        if reason := _lacking(definition.metric, recorded):
            yield f"{name}: {reason}"
    windows = [(each.label, at) for each in success.signal for at in (each.from_, each.to)]
    for label, at in (*windows, *((each.body, each.at) for each in success.body)):
        event = isinstance(at, str) and f"events.{split_instant(at)[0]}"
        if event and (reason := _lacking(event, recorded)):
            yield f"{label}: {at} never happens: {reason}"


def _asked(success: Success) -> Iterator[tuple[str, float, Definition]]:
    """Yield name, bound and definition of each criterion on a metric."""
    from ..result.judging.definitions import DEFINITIONS  # noqa: PLC0415 - read while FMUs step, for pages

    for name in field_names(Success):
        definition, bound = DEFINITIONS.get(f"success.{name}"), getattr(success, name)
        if definition is not None and bound is not None:
            yield name, bound, definition


def _lacking(metric: str, recorded: Container[str]) -> str | None:
    if metric == "limits":
        return all_lacking(recorded) or None
    from ..result.judging.definitions import DEFINITIONS  # noqa: PLC0415 - slow to read

    needed = (*NEEDED.get(metric.partition(".")[0], ()), *DEFINITIONS[metric].signals)
    return next((f"{signal} is not recorded" for signal in needed if signal not in recorded), None)


def _criteria(
    success: Success, measured: Mapping[str, Metrics], recorded: Container[str]
) -> Iterator[Criterion]:
    """Compare the metrics with the success criteria, in the scenario file's units."""
    for name, bound, definition in _asked(success):
        section, _, key = definition.metric.partition(".")
        value = measured[section].get(key) if key else largest_share(measured[section])
        direction: Direction = "above" if definition.better == "higher" else "below"
        reason = _unmeasured(definition.metric, recorded) if value is None else None
        value = _scaled(value, 1e-3) if key.endswith("_mm") else value
        yield Criterion(name, value, bound, definition.unit, direction, reason)


def _unmeasured(metric: str, recorded: Container[str]) -> str | None:
    from ..result.judging.definitions import DEFINITIONS  # noqa: PLC0415 - slow to read

    lacking = _lacking(metric, recorded)
    return lacking if lacking or "." not in metric else DEFINITIONS[metric].unmeasured
