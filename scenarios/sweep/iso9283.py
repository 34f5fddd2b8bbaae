"""The sheet of ISO 9283:1998, from a sweep whose rows are cycles of one robot.

A cycle's table names the rows that end at the poses P1 to P5, each followed by one at the end of
its dwell, and the row `path` that ends a straight line at one orientation. Poses are the true ones
of the hand's origin, world frame; a deviation is a vector (6,): position less its command [m], and
the rotation vector from the commanded orientation [rad]. Attained is the mean at a dwell's end.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jinja2 import Environment, FileSystemLoader
from numpy.typing import NDArray

from ...fmus.atomic import replacing
from ...fmus.errors import InputError
from .. import rotations
from ..recording import Recording
from .store import Store

Array = NDArray[np.float64]

SHEET: Final = "iso9283"  # .html and .json, in the sweep's folder
PAGE: Final = Path(__file__).parent / "page"
POSES: Final = ("P1", "P2", "P3", "P4", "P5")
# Cycles for poses, for the path, and for overshoot and stabilization.
CYCLES, PATH_CYCLES, STABLE_CYCLES = 30, 10, 3
AVERAGED: Final = 100  # [ticks] over which an attained pose is measured
PLANES: Final = np.linspace(0.1, 0.9, 81)  # normal to the path, at shares of its length [1]


@dataclass(frozen=True, eq=False)
class Cycle:
    """What one cycle attained."""

    poses: Array  # deviations at P1 to P5 (5, 6)
    path: Array  # deviations in each of the `PLANES` (m, 6)
    time: Array  # on the way to P1 and in its dwell (n,) [s]
    distance: Array  # from the attained P1 then (n,) [m]

    @classmethod
    def read(cls, recording: Recording) -> Cycle:
        """Read a cycle from its recording."""
        names, ends = recording.metadata.get("row_names", []), recording.metadata["row_times"]
        if {*POSES, "path"} - {*names} or not recording.complete:
            raise InputError("must be a whole cycle, whose table has rows P1 to P5 and path")
        time, hand = recording.time, recording["plant.hand_xpos"]
        command, facing = recording["controller.pos_cmd"], recording["controller.quat_cmd"]
        turn = rotations.multiply(recording["plant.hand_xquat"], rotations.conjugate(facing))
        deviation = np.hstack((hand - command, rotations.log(turn)))

        def rows(name: str, first: int, last: int) -> slice:
            row = names.index(name)
            return slice(*np.searchsorted(time, (ends[row + first], ends[row + last])))

        def attained(name: str, values: Array) -> Array:
            mean: Array = values[rows(name, 0, 1)][-AVERAGED:].mean(axis=0)
            return mean

        to_p1, line = rows("P1", -1, 1), rows("path", -1, 0)
        return cls(
            np.array([attained(name, deviation) for name in POSES]),
            _in_planes(hand[line], command[line], deviation[line, 3:]),
            time[to_p1],
            np.linalg.norm(hand[to_p1] - attained("P1", hand), axis=1),
        )


def _in_planes(hand: Array, command: Array, turn: Array) -> Array:
    """Return the deviations (m, 6) where the hand crosses the planes normal to a straight line."""
    line = command[-1] - command[0]
    along = np.maximum.accumulate((hand - command[0]) @ line / (line @ line))
    columns = (*hand.T, *turn.T)
    crossed = np.column_stack([np.interp(PLANES, along, column) for column in columns])
    crossed[:, :3] -= command[0] + np.outer(PLANES, line)
    return crossed


def accuracy(deviations: Array, kind: str = "P") -> dict[str, float]:
    """Return AP (or AT) of deviations (n, 6), those of the barycentre [mm], [deg]."""
    mean = np.append(1e3 * deviations[:, :3], np.degrees(deviations[:, 3:]), axis=1).mean(axis=0)
    values = {f"A{kind}_{axis}": float(x) for axis, x in zip("xyzabc", mean, strict=True)}
    return {f"A{kind}_p": float(np.linalg.norm(mean[:3])), **values}


def repeatability(deviations: Array, kind: str = "P") -> dict[str, float]:
    """Return RP (or RT) of deviations (n, 6): l + 3 S_l to the barycentre [mm], 3 S [deg]."""
    spread = deviations - deviations.mean(axis=0)
    distance = 1e3 * np.linalg.norm(spread[:, :3], axis=1)
    angles = np.degrees(3.0 * spread[:, 3:].std(axis=0, ddof=1))
    values = {f"R{kind}_{axis}": float(x) for axis, x in zip("abc", angles, strict=True)}
    first = f"R{kind}_{'l' if kind == 'P' else 'p'}"
    return {first: float(distance.mean() + 3.0 * distance.std(ddof=1)), **values}


def path_figures(cycles: Sequence[Cycle]) -> dict[str, float]:
    """Return AT and RT, the largest of all planes."""
    planes = np.array([cycle.path for cycle in cycles]).swapaxes(0, 1)  # (m, n, 6)
    each = [accuracy(plane, "T") | repeatability(plane, "T") for plane in planes]
    names = [name for name in each[0] if name[-1] not in "xyz"]
    return {name: max(abs(values[name]) for values in each) for name in names}


def stabilization(cycle: Cycle, band: float) -> tuple[float, float] | None:
    """Return OV [mm] and t_s [s] at P1 from its first crossing into the band [mm]; or None."""
    inside = 1e3 * cycle.distance <= band
    if not inside[-1]:
        return None
    first = int(inside.argmax())
    outside = first + np.flatnonzero(~inside[first:])
    if not len(outside):
        return 0.0, 0.0
    over = 1e3 * float(cycle.distance[outside].max())
    return over, float(cycle.time[outside[-1] + 1] - cycle.time[first])


def figures(cycles: Sequence[Cycle]) -> dict[str, Any]:
    """Return all figures of the sheet, lengths in mm and angles in degrees."""
    poses = np.array([cycle.poses for cycle in cycles]).swapaxes(0, 1)  # (5, n, 6)
    at_poses = {n: accuracy(p) | repeatability(p) for n, p in zip(POSES, poses, strict=True)}
    band = at_poses["P1"]["RP_l"]
    settled = [s for c in cycles[:STABLE_CYCLES] if (s := stabilization(c, band))]
    all_settle = len(settled) == STABLE_CYCLES
    return {
        "poses": at_poses,
        "path": path_figures(cycles[:PATH_CYCLES]),
        "P1": {
            "limit_band": band,
            "OV": max(over for over, _ in settled) if all_settle else None,
            "t_s": float(np.mean([time for _, time in settled])) if all_settle else None,
        },
    }


def _conditions(recordings: Sequence[Recording]) -> dict[str, Any]:
    """Return what was measured; all cycles must be of one robot, but for the noise."""
    each = [recording.metadata["parameters"] for recording in recordings]
    seeds = {parameters["sensors"]["seed"] for parameters in each}
    fixed = [p | {"sensors": p["sensors"] | {"seed": 0.0}} for p in each]
    if len(seeds) < len(each) or any(parameters != fixed[0] for parameters in fixed):
        raise InputError("the cycles must differ in sensors.seed, and in nothing else")
    first = recordings[0]
    return {
        "robot": first.metadata["robot"],
        "gains": first.metadata["gains"],
        "cycles": {"poses": CYCLES, "path": PATH_CYCLES, "P1": STABLE_CYCLES},
        "velocity_m_s": float(np.linalg.norm(first["controller.vel_cmd"], axis=1).max()),
        "varies": "sensors.seed, the noise of the readings",
        "parameters": each[0],
    }


def write_sheet(folder: Path) -> Path:
    """Write iso9283.json and iso9283.html of a sweep that kept its recordings."""
    store = Store(folder)
    runs = [store.run_folder(index) for index in range(CYCLES)]
    kept = [run for run in runs if run.is_dir()]
    if len(kept) < CYCLES:
        raise InputError(f'{folder}: {len(kept)} kept cycles; must be {CYCLES}, with keep = "all"')
    recordings = [Recording.open(run) for run in kept]
    sheet = {
        "standard": "ISO 9283:1998",
        "measures": "the assumed errors of a model, not a robot",
        "conditions": _conditions(recordings),
        **figures([Cycle.read(recording) for recording in recordings]),
    }
    page = Environment(loader=FileSystemLoader(PAGE), autoescape=True).get_template(f"{SHEET}.html")
    for name, text in (("json", json.dumps(sheet, indent=2)), ("html", page.render(sheet))):
        with replacing(store.folder / f"{SHEET}.{name}") as path:
            path.write_text(text + "\n", encoding="utf-8")
    return store.folder / f"{SHEET}.html"
