"""The examples run as they stand: four ways to use the project, from own parts to a kept result."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

from bounded import ran
from panda_cosim.result.recording import Recording
from panda_cosim.task.scenario import load_scenario

pytestmark = pytest.mark.long
EXAMPLES = Path(__file__).parent.parent / "scenarios" / "examples"
LIMIT = 500.0  # [s]


@pytest.fixture(autouse=True)
def activated(monkeypatch):
    """Find programs as in an activated environment."""
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)


def walk(name: str, folder: Path) -> str:
    """Run a script in a new folder, as its first lines say; returns what it printed."""
    done = ran(["sh", EXAMPLES / f"{name}.sh", folder], timeout=LIMIT)
    return done.stdout


def execute(name: str, folder: Path) -> dict[str, str]:
    """Run a notebook; returns the text that each cell printed or returned, by its last line."""
    pytest.importorskip("pandas")
    notebook = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    client = NotebookClient(notebook, timeout=LIMIT, resources={"metadata": {"path": folder}})
    client.execute()
    return {
        cell.source.splitlines()[-1]: "".join(
            output.get("text", "") or output.get("data", {}).get("text/plain", "")
            for output in cell.outputs
        )
        for cell in notebook.cells
        if cell.cell_type == "code"
    }


def test_a_law_of_ones_own_is_analysed_and_kept_by_a_test(tmp_path):
    said = execute("own_law", tmp_path)
    assert "2 passed" in said["!{sys.executable} -m pytest -q test_my_task.py"]
    margins = said["analysis.margins.disk_margin, stiff.margins.disk_margin"]
    usual, stiff = (float(each) for each in margins.strip("()").split(","))
    assert 0 < stiff < usual <= 2
    assert (tmp_path / "my_task" / "reference.parquet").exists()


def test_a_foreign_arm_runs_with_a_python_fmu_and_as_an_ssp(tmp_path):
    pytest.importorskip("gymnasium")
    said = walk("foreign_arm", tmp_path / "new")
    assert "1 of 1 scenarios match" in said
    first, second = (Recording.open(tmp_path / "new" / name) for name in ("first", "second"))
    angle = first["plant.qpos[4]"]
    assert np.abs(angle[-100:] + 0.8).max() < 0.02  # [rad]: the target of the controller's file
    np.testing.assert_array_equal(angle, second["plant.qpos[4]"])


def test_a_repository_has_a_nightly_gate_and_keeps_a_failure(tmp_path):
    said = walk("nightly", tmp_path / "new")
    assert "6 passed" in said
    suites = ET.parse(tmp_path / "new" / "nightly" / "junit.xml").getroot()
    cases = list(suites.iter("testcase"))
    assert len(cases) == 6  # five scenarios and the sweep
    assert not list(suites.iter("failure"))
    kept = load_scenario(tmp_path / "new" / "suite" / "pushed_too_hard")
    assert (kept.expect, kept.push[0].force[1]) == ("failure", 200.0)
    assert "6 of 6 scenarios match their references" in said


def test_a_scene_with_a_wall_is_pushed_by_hand_and_kept(tmp_path):
    execute("wall", tmp_path)
    runs = {path.parent for path in (tmp_path / "runs").glob("*/summary.json")}
    summaries = [json.loads((run / "summary.json").read_text()) for run in runs]
    nominal = next(s for s, r in zip(summaries, runs, strict=True) if (r / "video.mp4").exists())
    assert nominal["as_expected"]
    shift = next(c for c in nominal["criteria"] if c["name"] == "cylinder max_shift")
    assert shift["value"] < 0.002  # m
    kept = load_scenario(tmp_path / "pushed")
    (push,) = kept.push
    assert (push.start, push.duration, push.force) == (0.5, 0.2, (0.0, 30.0, 0.0))
    session, again = (
        Recording.open(next(r for r, s in zip(runs, summaries, strict=True) if s["scenario"] == name
                            and not (r / "video.mp4").exists()))
        for name in ("wall", "pushed")
    )  # fmt: skip
    np.testing.assert_array_equal(session["plant.qpos"], again["plant.qpos"])
    shutil.rmtree(tmp_path / "runs")
