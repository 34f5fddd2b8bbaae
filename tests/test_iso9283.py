"""The example of ISO 9283: its figures computed again from the recordings, and by hand."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from panda_cosim import Recording
from panda_cosim.study.sweep.definition import load_sweep
from panda_cosim.study.sweep.engine import sweep

Array = NDArray[np.float64]
EXAMPLES = Path(__file__).parents[1] / "scenarios" / "examples"
ISO = runpy.run_path(str(EXAMPLES / "iso9283.py"))

# Rows of the shipped table: the last 0.1 s of each dwell, and the line [ticks].
DWELLS = {"P5": 3200, "P4": 5200, "P3": 7200, "P2": 9200, "P1": 11200}
LINE = slice(12500, 13700)


def angles(recording: Recording, rows: slice) -> Array:
    """Rotation vectors [deg] from the commanded to the true orientation, world axes."""
    true, command = (
        Rotation.from_quat(recording[name][rows], scalar_first=True)
        for name in ("plant.hand_xquat", "controller.quat_cmd")
    )
    vectors: Array = np.degrees((true * command.inv()).as_rotvec())
    return vectors


def mean_of(recording: Recording, end: int) -> Array:
    """Attained pose less the command (6,) [mm, deg]."""
    rows = slice(end - 100, end)
    away = recording["plant.hand_xpos"][rows] - recording["controller.pos_cmd"][rows]
    return np.append(1e3 * away.mean(axis=0), angles(recording, rows).mean(axis=0))


def spread(values: Array) -> float:
    """Mean and three standard deviations of the distances from the barycentre of values (n, 3)."""
    distances = [np.sqrt(sum((v - c) ** 2 for v, c in zip(row, values.mean(0), strict=True)))
                 for row in values]  # fmt: skip
    middle = sum(distances) / len(distances)
    return float(
        middle + 3 * np.sqrt(sum((d - middle) ** 2 for d in distances) / (len(values) - 1))
    )


@pytest.mark.long
def test_the_sheet_is_that_of_the_recordings(tmp_path):
    sweep(load_sweep("iso9283"), tmp_path / "iso")
    sheet = ISO["sheet"](tmp_path / "iso")
    runs = [Recording.open(tmp_path / "iso" / "runs" / f"{i:07d}") for i in range(30)]
    for name, end in DWELLS.items():
        poses, told = np.array([mean_of(run, end) for run in runs]), sheet["poses"][name]
        expected = dict(zip(("A_x", "A_y", "A_z", "A_a", "A_b", "A_c"), poses.mean(0), strict=True))
        expected |= {
            "A_p": np.linalg.norm(poses[:, :3].mean(axis=0)),
            "R_l": spread(poses[:, :3]),
        }
        expected |= {f"R_{k}": 3 * poses[:, 3 + i].std(ddof=1) for i, k in enumerate("abc")}
        assert told == pytest.approx(expected, rel=1e-6, abs=1e-9)
    start, end = runs[0]["controller.pos_cmd"][[LINE.start, LINE.stop]]
    worst = {"A_p": 0.0, "R_l": 0.0}
    for share in np.linspace(0.1, 0.9, 81):
        plane = start + share * (end - start)
        crossings = []
        for run in runs[:10]:
            hand = run["plant.hand_xpos"][LINE]
            side = (hand - plane) @ (end - start)
            k = int(np.flatnonzero(side < 0.0)[-1])
            part = side[k] / (side[k] - side[k + 1])
            crossings.append(1e3 * (hand[k] + part * (hand[k + 1] - hand[k]) - plane))
        worst["A_p"] = max(worst["A_p"], np.linalg.norm(np.mean(crossings, axis=0)))
        worst["R_l"] = max(worst["R_l"], spread(np.array(crossings)))
    assert {name: sheet["path"][name] for name in worst} == pytest.approx(worst, rel=1e-3)
    reached = runs[0]["plant.hand_xpos"][9200:11200]
    away = 1e3 * np.linalg.norm(reached - reached[-100:].mean(axis=0), axis=1)
    assert away[-1] > sheet["poses"]["P1"]["R_l"]  # friction keeps the hand moving
    assert sheet["OV, t_s at P1"] is None


def test_repeatability_by_hand():
    """Four poses on a circle of 1 mm: no distance differs; angles of +-1 deg twice."""
    poses = np.zeros((4, 6))
    poses[:, :2] = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
    poses[:, 5] = [1.0, -1.0, 1.0, -1.0]
    values = ISO["figures"](poses)
    assert values["R_l"] == pytest.approx(1.0)
    assert values["R_c"] == pytest.approx(3.0 * np.sqrt(4.0 / 3.0))
    assert values["R_a"] == 0.0


def test_overshoot_begins_with_the_first_crossing():
    time = 0.001 * np.arange(7)
    distance = np.array([9.0, 0.5, 2.0, 3.0, 0.5, 0.1, 0.0])
    assert ISO["stabilization"](time, distance, 1.0) == pytest.approx((3.0, 0.003))
    assert ISO["stabilization"](time, distance, 4.0) == (0.0, 0.0)
    distance[-1] = 2.0  # mm
    assert ISO["stabilization"](time, distance, 1.0) is None


def test_a_sweep_without_recordings_has_no_sheet(tmp_path):
    with pytest.raises(SystemExit, match="0 kept cycles; must be 30"):
        ISO["sheet"](tmp_path)
