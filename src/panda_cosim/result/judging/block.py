"""The block's metrics: how it was lifted, carried, set down, and where it lies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from ...assets.fields import Array
from ...task import rotations
from ..recording import Recording, by_rows
from .holds import BLOCK, Hold, instant, last_release, placed_row
from .summary import Metrics

SUPPORT: Final = "plant.support_force"
POSE: Final = [f"plant.qpos[{i}]" for i in range(10, 17)]  # position, quaternion (w, x, y, z)


def measure_block(
    recording: Recording, held: Sequence[Hold], goal: tuple[float, float, float] | None
) -> Metrics:
    """Return the metrics under `block` in summary.json; `goal` is its place, world frame [m]."""
    time = recording.time
    if not len(time):
        return {}
    each = _holds(recording, held)
    placed = placed_row(time, held)
    at = -1 if placed is None else placed
    there, final = np.column_stack([recording[name][[at, -1]] for name in POSE])
    yaw, tilt = _yaw(there[3:]), by_rows(recording, _tilt, *POSE[4:6])
    released = last_release(held, len(time))
    height = recording[BLOCK[2]]
    lifts = [float(height[h.grasp : h.end].max() - height[h.grasp]) for h in held]
    error = 1e3 * (there[:3] - (0.0 if goal is None else np.array(goal)))
    return {
        "holds": each,
        "lift_m": max(lifts, default=0.0),
        "slip_mm": max((h["slip_mm"] for h in each if h["slip_mm"] is not None), default=None),
        **_set_down(recording, height, released, placed),
        "final_position_m": final[:3].tolist(),
        "final_quaternion_wxyz": final[3:].tolist(),
        "placed_at_s": instant(time, placed),
        "release_s": instant(time, released.end if released else None),
        "peak_tilt_deg": float(tilt.max()),
        "tilt_deg": float(tilt[at]),
        "yaw_deg": yaw,
        "yaw_error_deg": abs((yaw + 45.0) % 90.0 - 45.0),
        "place_error_mm": None if goal is None else float(np.linalg.norm(error)),
        "place_error_xyz_mm": None if goal is None else error.tolist(),
    }


def _yaw(quaternion: Array) -> float:
    """Yaw [deg] of a body from its quaternion (w, x, y, z)."""
    w, x, y, z = quaternion.tolist()
    return math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def _tilt(x: Array, y: Array) -> Array:
    """Tilt (n,) [deg] of a body from these parts of its quaternions (w, x, y, z)."""
    return np.degrees(np.arccos(np.clip(1 - 2 * (x**2 + y**2), -1.0, 1.0)))


def _holds(recording: Recording, held: Sequence[Hold]) -> list[Metrics]:
    """Return the instants of each hold, and the slip in it."""
    time, slips = recording.time, _slips(recording, held)
    return [
        {
            "grasp_s": float(time[hold.grasp]),
            "lift_s": instant(time, hold.lift),
            "release_command_s": instant(time, hold.release_command),
            "release_s": instant(time, hold.end),
            "slip_mm": slip,
        }
        for hold, slip in zip(held, slips, strict=True)
    ]


def _slips(recording: Recording, held: Sequence[Hold]) -> list[float | None]:
    """Return the largest displacement of the block in the hand while each hold carries it [mm]."""

    def seen_from(hand: Array, quaternion: Array, *block: Array) -> Array:
        return rotations.rotate(rotations.conjugate(quaternion), np.column_stack(block) - hand)

    in_hand = by_rows(recording, seen_from, "plant.hand_xpos", "plant.hand_xquat", *BLOCK)
    carried = [in_hand[hold.carried] for hold in held]
    ways = [np.linalg.norm(place - place[:1], axis=1) for place in carried]
    return [1e3 * float(way.max()) if len(way) else None for way in ways]


def _set_down(
    recording: Recording, height: Array, released: Hold | None, placed: int | None
) -> Metrics:
    """Measure how the block is set down after its last hold."""
    drop = force = None
    if released is not None and placed is not None:
        if released.release_command is not None:
            drop = float(height[released.release_command] - height[placed]) * 1e3
        if released.lift is not None and SUPPORT in recording:
            force = float(recording[SUPPORT][released.lift : placed + 1].max())
    return {"drop_mm": drop, "set_down_force_N": force}
