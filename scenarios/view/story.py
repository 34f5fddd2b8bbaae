"""What the page shows beside the motion: verdict, criteria, limits, moments, first curves."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final

import numpy as np

from ...assets.franka import OPENING_MAX, ROBOTS, TORQUE_MAX
from ..judging.definitions import DEFINITIONS
from ..judging.refusals import CHECKS, outcome
from ..pictures.motion import Signals, key_moments
from ..scenario.limits import METRICS

MOMENTS: Final = 8  # most marks on the timeline
JOINTS: Final = range(1, 8)
CURVES: Final = (
    ("Tracking error", ["tracking error"]),
    ("Fingers on the block", ["plant.contact_force"]),
    ("Joint velocities", [f"plant.qvel[{i}]" for i in JOINTS]),
    ("Joint torques", [f"plant.actuator_force[{i}]" for i in JOINTS]),
)


def verdict(summary: Mapping[str, Any], metadata: Mapping[str, Any]) -> dict[str, str]:
    """Return the run's outcome: a state (good, bad, plain) and a text."""
    if metadata.get("complete") is False:
        reason = summary.get("reason") or metadata.get("reason") or "stopped early"
        return {"state": "bad", "words": f"incomplete: {reason}"}
    criteria = criteria_of(summary)
    unknown = [str(c["name"]) for c in criteria if c["value"] is None]
    missed = [str(c["name"]) for c in criteria if not c["ok"] and c["value"] is not None]
    if unknown or missed:
        groups = {"not measured": unknown, "missed": missed}
        words = "; ".join(f"{word}: {', '.join(names)}" for word, names in groups.items() if names)
        return {"state": "bad", "words": words}
    if criteria:
        count = len(criteria)
        return {"state": "good", "words": f"success: {count} of {count} criteria hold"}
    return {"state": "plain", "words": "no success condition"}


def criteria_of(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the success criteria with measured values, in their units."""
    rows = summary.get("criteria")
    return [
        {
            "name": str(row.get("name", "")),
            "value": number(row.get("value")),
            "bound": number(row.get("bound")),
            "unit": str(row.get("unit", "")),
            "ok": row.get("ok") is True,
            "least": row.get("direction") == "above",
            "words": meaning(f"success.{row.get('name')}"),
        }
        for row in (rows if isinstance(rows, list) else ())
        if isinstance(row, Mapping)
    ]


def meaning(key: str) -> str:
    """Return what a criterion or number means, for a tooltip, or ""."""
    return DEFINITIONS[key].text if key in DEFINITIONS else ""


def limits_of(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the largest shares of the robot's limits that the run used."""
    limits = summary.get("limits")
    shares = limits if isinstance(limits, Mapping) else {}
    rows = [("limits", key, name, shares) for key, name in METRICS.items()]
    real = summary.get("preflight")
    if isinstance(real, Mapping):
        judged = (real.get("interface"), "arm")
        keys = [key for key, check in CHECKS.items() if check.interface in judged]
        rows += [
            ("preflight", f"{key}_share", f"{real.get('robot')}: {key.replace('_', ' ')}", real)
            for key in keys
        ]
    return [
        {"name": name, "words": meaning(f"{group}.{key}"), "shares": list(map(number, used[key]))}
        for group, key, name, used in rows
        if isinstance(used.get(key), list)
    ]


def refusals_of(summary: Mapping[str, Any]) -> list[str]:
    """Return what the real robot would refuse, in lines."""
    try:
        return [text for level, text in outcome(summary["preflight"]) if level == "refused"]
    except (LookupError, TypeError, ValueError):  # there is none, or it is another's
        return []


def bounds(name: str) -> dict[str, list[float]]:
    """Return a robot's lower and upper limits of single columns, for curves."""
    robot = ROBOTS[name]
    lines: dict[str, list[float]] = {"controller.grip_cmd": [0.0, OPENING_MAX]}
    for i in JOINTS:
        lines[f"plant.qpos[{i}]"] = [float(robot.q_min[i - 1]), float(robot.q_max[i - 1])]
        lines[f"plant.qvel[{i}]"] = [-float(robot.velocity[i - 1]), float(robot.velocity[i - 1])]
        torque = float(TORQUE_MAX[i - 1])
        lines[f"plant.actuator_force[{i}]"] = [-torque, torque]
    return lines


def moments(signals: Signals) -> list[dict[str, Any]]:
    """Return the key instants: start, grasp, lift ..."""
    return [{"time": m.time, "label": m.label} for m in key_moments(signals, MOMENTS) if m.label]


def waypoints(metadata: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of the scenario's table: their instants [s], and names or numbers."""
    times = metadata.get("row_times", ())
    names = metadata.get("row_names") or [""] * len(times)
    return [
        {"time": time, "label": name or str(index)}
        for index, (time, name) in enumerate(zip(times, names, strict=False), start=1)
    ]


def number(value: object) -> float | None:
    """Return a finite number, or None."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating):
        return None
    return float(value) if math.isfinite(value) else None


def shown(curves: Iterable[tuple[str, list[str]]], columns: Collection[str]) -> list[Any]:
    """Return the curves whose columns a run has."""
    kept = [(title, [name for name in names if name in columns]) for title, names in curves]
    return [{"title": title, "columns": names} for title, names in kept if names]
