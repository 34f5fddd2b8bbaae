"""The example of ISO 9283: its figures computed again from the recordings, and by hand."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "scenarios" / "examples"
ISO = runpy.run_path(str(EXAMPLES / "iso9283.py"))


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
