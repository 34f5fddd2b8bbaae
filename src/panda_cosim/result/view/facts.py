"""What a run's page says beside the scene: criteria, limits, refusals, moments, waypoints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np
from pydantic_core import to_jsonable_python

from ...assets.checks import CHECKS
from ...assets.franka import OPENING_MAX, ROBOTS, TORQUE_MAX
from ...result.judging.advice import refusals
from ...result.judging.definitions import DEFINITIONS
from ...result.judging.limits import SHARES
from ...result.judging.summary import Summary
from ...result.recording import Recording
from ...result.recording.storage import Metadata
from ..pictures.motion import key_moments
from .columns import Json

MOMENTS: Final = 8  # most marks on the timeline
PARTS: Final = 6  # most FMUs, and the stepper, of which the header says what ran
JOINTS: Final = range(1, 8)
CURVES: Final = (
    ("Tracking error", ["tracking error"]),
    ("Fingers on the block", ["plant.contact_force"]),
    ("Joint velocities", [f"plant.qvel[{i}]" for i in JOINTS]),
    ("Joint torques", [f"plant.actuator_force[{i}]" for i in JOINTS]),
)


def criteria_of(summary: Summary) -> list[Json]:
    """Return the success criteria with measured values, in their units."""
    return [
        {
            **to_jsonable_python(each, inf_nan_mode="null"),
            "least": each.direction == "above",
            "words": meaning(f"success.{each.name}"),
        }
        for each in summary.criteria
    ]


def meaning(key: str) -> str:
    """Return what a criterion or number means, for a tooltip, or ""."""
    return DEFINITIONS[key].text if key in DEFINITIONS else ""


def limits_of(summary: Summary) -> list[Json]:
    """Return the largest shares of the robot's limits that the run used."""
    rows = [("limits", key, name, summary.limits) for key, name in SHARES.items()]
    real = summary.preflight
    rows += [
        ("preflight", f"{key}_share", f"{real.get('robot')}: {key.replace('_', ' ')}", real)
        for key, check in CHECKS.items()
        if check.interface in (real.get("interface"), "arm")
    ]
    return [
        {"name": name, "words": meaning(f"{group}.{key}"), "shares": shares}
        for group, key, name, used in rows
        if isinstance(shares := to_jsonable_python(used.get(key), inf_nan_mode="null"), list)
    ]


def refusals_of(summary: Summary) -> list[str]:
    """Return what the real robot would refuse, in lines."""
    try:
        lines = refusals(summary.preflight, complete=summary.complete)
        return [text for level, text in lines if level == "refused"]
    except (AttributeError, LookupError, TypeError, ValueError):  # none, or another's
        return []


def column_bounds(name: str) -> dict[str, list[float]]:
    """Return a robot's lower and upper limits of single columns, for curves."""
    robot = ROBOTS[name]
    bounds: dict[str, list[float]] = {"controller.grip_cmd": [0.0, OPENING_MAX]}
    rows = np.column_stack((robot.q_min, robot.q_max, robot.velocity, TORQUE_MAX)).tolist()
    for i, (low, high, speed, torque) in enumerate(rows, 1):
        bounds[f"plant.qpos[{i}]"] = [low, high]
        bounds[f"plant.qvel[{i}]"] = [-speed, speed]
        bounds[f"plant.actuator_force[{i}]"] = [-torque, torque]
    return bounds


def moments(signals: Recording) -> list[Json]:
    """Return the key instants: start, grasp, lift ..."""
    return [{"time": m.time, "label": m.label} for m in key_moments(signals, MOMENTS) if m.label]


def waypoints(metadata: Metadata) -> list[Json]:
    """Return the rows of the scenario's table: their instants [s], and names or numbers."""
    times = metadata.get("row_times", ())
    names = metadata.get("row_names") or [""] * len(times)
    rows = enumerate(zip(times, names, strict=False), start=1)
    return [{"time": time, "label": name or str(row)} for row, (time, name) in rows]


def shown_curves(curves: Iterable[tuple[str, list[str]]], units: Mapping[str, str]) -> list[Json]:
    """Return the curves whose columns a run has, in one plot per unit."""
    return [
        {"title": title, "columns": [name for name in names if units.get(name) == unit]}
        for title, names in curves
        for unit in dict.fromkeys(units[name] for name in names if name in units)
    ]
