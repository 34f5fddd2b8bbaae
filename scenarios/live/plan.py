"""The commanded path of a running session, and its waypoints, which a page can move."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..running.session import Session

POINTS: Final = 2000  # of a curved path


def plan(session: Session) -> dict[str, Any]:
    """Return path and waypoints in the world, in the page's form (`Plan` in live/link.ts)."""
    if session.scenario.is_system:
        return {"time": [], "points": [], "waypoints": []}
    path = session.trajectory
    is_curved = path.interpolation == "spline"  # else straight from row to row
    times = np.linspace(path.times[0], path.times[-1], POINTS) if is_curved else path.times
    points = path.sample(times)[:, :3]
    rows = zip(path.times.tolist(), path.positions.tolist(), session.table.rows, strict=True)
    return {
        "time": times.round(6).tolist(),
        "points": points.round(6).ravel().tolist(),
        "waypoints": [
            {"time": time, "label": getattr(row, "name", "") or str(number), "place": place}
            for number, (time, place, row) in enumerate(rows, start=1)
        ],
    }


def offset_of(session: Session, row: int, place: ArrayLike) -> list[float]:
    """Return a row's position in its own frame for a hand position in the world.

    Args:
        session: An open session.
        row: Index of the row, from 0.
        place: Hand origin in the world (3,) [m].
    """
    table = session.table.rows[row]
    way = np.asarray(place, dtype=np.float64) - session.trajectory.positions[row]
    if table.frame == "target" and session.scenario.align:
        way = _turned(way, -session.start_pose.grasp_yaw)
    offset: list[float] = (np.asarray(table.position) + way).round(6).tolist()
    return offset


def _turned(vector: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """Turn a vector (3,) about the z axis by an angle [rad]."""
    x, y, z = vector
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.array((cosine * x - sine * y, sine * x + cosine * y, z))


__all__ = ["offset_of", "plan"]
