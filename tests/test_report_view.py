"""A report in 3D: the worst scenario opens by itself, at its worst tick, with its reference."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from browser import find_browser
from panda_cosim.result.judging.summary import Summary
from panda_cosim.result.recording import Recording
from panda_cosim.study.compare.against_reference import compare_with_reference
from panda_cosim.study.compare.between_runs import compare as compare_runs
from panda_cosim.study.compare.reference import Reference
from panda_cosim.study.compare.regress import Outcome
from panda_cosim.study.compare.report import write_report
from panda_cosim.task.scenario import load_scenario
from view_support import run_scenario_outside

SHIFT = "--set", "plant.block_pos[1]=0.46"  # a planted difference
LARGEST = 2e6  # [B] of a report of two scenarios

pytestmark = pytest.mark.skipif(find_browser() is None, reason="no Chromium here")


def judged(run: Path, name: str) -> Outcome:
    """Compare a run with the reference of pick_and_place."""
    scenario = load_scenario("pick_and_place")
    assert scenario.folder is not None
    path = scenario.folder / "reference.parquet"
    summary = Summary.open(run)
    compared = compare_with_reference(
        Recording.open(run), summary, Reference.read(path), scenario.regression
    )
    named = replace(scenario, name=name)
    return Outcome(named, "same" if compared.ok else "differs", run, 1.0, compared)


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    runs = [("good", ()), ("wrong", SHIFT)]
    return [judged(run_scenario_outside(folder / name, *how), name) for name, how in runs]


@pytest.fixture(scope="module")
def report(outcomes, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(outcomes, path, {})
    return path


NOW = "PandaView.viewer.clock.time"


def test_a_comparison_opens_at_the_worst_tick_with_the_first_run_as_a_ghost(
    outcomes, page, tmp_path
):
    found = compare_runs(*(outcome.run for outcome in outcomes))
    path = tmp_path / "compare.html"
    path.write_text(found.to_html(), encoding="utf-8")
    page.open(path, 760, 420)
    page.wait(SHOWN)
    assert page.value("PandaView.viewer.runs.map(({ name }) => name)") == ["wrong", "good"]
    assert page.value(NOW) == pytest.approx(found.signals[0].times[0], abs=1e-9)
    assert page.value("document.querySelectorAll('.view canvas').length") > 1
    assert page.errors == []
    assert page.requests == [path.as_uri()]


SHOWN = "window.PandaView?.viewer?.stage?.drawn > 0"


def test_a_report_opens_at_the_worst_tick_and_shows_one_scenario_at_a_time(page, report, outcomes):
    page.open(report, 760, 420)
    page.wait(SHOWN)
    comparison = outcomes[1].comparison
    assert comparison is not None
    assert comparison.worst is not None
    worst = comparison.worst
    assert page.value(NOW) == pytest.approx(worst.time, abs=1e-9)
    assert page.value("document.querySelectorAll('#s-wrong .view.open .pv').length") == 1
    assert page.value("PandaView.viewer.stage.figures.length") == 2
    width = "document.querySelector('.pv-picture').clientWidth"
    assert page.value(width) > 400  # [px]: the report's style leaves the viewer its place
    # The scene is at that tick: the arm's joints are those of the recording.
    row = round(worst.time / 1e-3)
    expected = Recording.open(outcomes[1].run)["plant.qpos"][row]
    shown = page.value(
        f"(q => (PandaView.viewer.runs[0].pose({NOW}, q), [...q]))(new Float64Array(16))"
    )
    assert np.abs(np.array(shown) - expected).max() < 2e-6  # [rad], [m], [1]
    titles = "[...document.querySelectorAll('#s-wrong .pv-chart h3')].map(h => h.textContent)"
    page.wait(f"{titles}.some(title => title.includes({json.dumps(worst.name)}))")
    assert page.requests == [report.resolve().as_uri()]
    assert report.stat().st_size <= LARGEST
    # Another scenario takes the viewer.
    page.value("document.getElementById('s-good').open = true")
    page.value("document.querySelector('#s-good .view button').click()")
    page.wait("document.querySelector('#s-good .view .pv canvas') !== null && " + SHOWN)
    assert page.value("document.querySelectorAll('.pv').length") == 1
    assert "Show in 3D" in page.value("document.querySelector('#s-wrong .view').textContent")
    # Keys belong to the viewer only while it has the focus.
    page.value("document.activeElement.blur()")
    at = page.value(NOW)
    page.press(".")
    assert page.value(NOW) == at
    page.value("document.querySelector('#s-good canvas').focus()")
    page.press(".")
    page.wait(f"{NOW} !== {at}")
    assert page.errors == []
