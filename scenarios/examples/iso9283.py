"""The data sheet of ISO 9283:1998, from the recordings of a sweep: each row is a cycle of a robot.

    panda-cosim sweep iso9283 --out iso
    python iso9283.py iso

It measures the assumed errors of a model, not a robot. A cycle stops at the poses P1 to P5 and
moves along a straight line. A deviation is a vector (6,): position less its command [mm], and the
rotation vector from the commanded orientation [deg], world frame, of the hand's origin. What is
attained is the mean over the last 0.1 s of a dwell.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from panda_cosim import Recording

POSES = ("P1", "P2", "P3", "P4", "P5")
CYCLES, PATH_CYCLES, STABLE_CYCLES = 30, 10, 3
AVERAGED = 100  # ticks over which an attained pose is measured
PLANES = np.linspace(0.1, 0.9, 81)  # normal to the path, at shares of its length


class Cycle:
    """What one cycle attained: deviations at the poses (5, 6) and in the planes (81, 6)."""

    def __init__(self, run):
        hand, command = (1e3 * run[s] for s in ("plant.hand_xpos", "controller.pos_cmd"))  # mm
        turns = (run[s] for s in ("plant.hand_xquat", "controller.quat_cmd"))
        true, wanted = (Rotation.from_quat(turn, scalar_first=True) for turn in turns)
        deviation = np.hstack((hand - command, np.degrees((true * wanted.inv()).as_rotvec())))
        names, ends = run.metadata["row_names"], run.metadata["row_times"]

        def rows(name, first, last):  # from the end of one of the table's rows to that of another
            row = names.index(name)
            return slice(*np.searchsorted(run.time, (ends[row + first], ends[row + last])))

        dwells = [deviation[rows(name, 0, 1)][-AVERAGED:] for name in POSES]
        self.poses = np.array([dwell.mean(axis=0) for dwell in dwells])
        line = rows("path", -1, 0)
        self.path = in_planes(hand[line], command[line], deviation[line, 3:])
        to_p1 = rows("P1", -1, 1)
        p1 = hand[rows("P1", 0, 1)][-AVERAGED:].mean(axis=0)
        self.time, self.distance = run.time[to_p1], np.linalg.norm(hand[to_p1] - p1, axis=1)


def in_planes(hand, command, turn):
    """Deviations (81, 6) where the hand crosses the planes."""
    line = command[-1] - command[0]
    along = np.maximum.accumulate((hand - command[0]) @ line / (line @ line))
    crossed = np.column_stack([np.interp(PLANES, along, x) for x in (*hand.T, *turn.T)])
    crossed[:, :3] -= command[0] + np.outer(PLANES, line)
    return crossed


def figures(deviations):
    """Accuracy A (of the barycentre) and repeatability R (l + 3 S_l; of angles 3 S) of (n, 6)."""
    mean, spread = deviations.mean(axis=0), deviations - deviations.mean(axis=0)
    distance = np.linalg.norm(spread[:, :3], axis=1)
    values = {"A_p": np.linalg.norm(mean[:3]), "R_l": distance.mean() + 3 * distance.std(ddof=1)}
    values |= {f"A_{axis}": x for axis, x in zip("xyzabc", mean, strict=True)}
    turns = 3 * spread[:, 3:].std(axis=0, ddof=1)
    return values | {f"R_{axis}": x for axis, x in zip("abc", turns, strict=True)}


def stabilization(time, distance, band):
    """Overshoot OV [mm] and time t_s [s] from the first crossing into the band [mm]; or None."""
    inside = distance <= band
    if not inside[-1]:
        return None  # it does not settle
    first = int(inside.argmax())
    outside = first + np.flatnonzero(~inside[first:])
    if not len(outside):
        return 0.0, 0.0
    return distance[outside].max(), time[outside[-1] + 1] - time[first]


def settling(overshoots, times):
    """The largest overshoot [mm], and the mean time [s]."""
    return [overshoots.max(), times.mean()]


def sheet(folder):
    """All figures of a sweep; lengths in mm, angles in degrees."""
    kept = sorted(Path(folder, "runs").glob("*"))
    if len(kept) != CYCLES:
        raise SystemExit(f'{folder}: {len(kept)} kept cycles; must be {CYCLES}, with keep = "all"')
    cycles = [Cycle(Recording.open(run)) for run in kept]
    by_pose = np.stack([cycle.poses for cycle in cycles], axis=1)
    by_plane = np.stack([cycle.path for cycle in cycles[:PATH_CYCLES]], axis=1)
    poses, planes = dict(zip(POSES, map(figures, by_pose), strict=True)), [*map(figures, by_plane)]
    band = poses["P1"]["R_l"]
    settled = [stabilization(c.time, c.distance, band) for c in cycles[:STABLE_CYCLES]]
    return {
        "poses": poses,
        "path": {name: max(abs(plane[name]) for plane in planes) for name in planes[0]},
        "OV, t_s at P1": None if None in settled else settling(*np.transpose(settled)),
    }


if __name__ == "__main__":
    print(json.dumps(sheet(sys.argv[1]), indent=2, default=float))
