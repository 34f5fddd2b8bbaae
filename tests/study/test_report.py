"""The report names what is wrong first, and works in a browser without a network."""

import json
import re
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from browser import find_browser
from panda_cosim import Recording, Scenario, TableRow, TrajectoryTable, load_scenario
from panda_cosim.result.judging.summary import SUMMARY_FILE, Summary
from panda_cosim.study.compare.against_reference import compare_with_reference
from panda_cosim.study.compare.causes import changed
from panda_cosim.study.compare.outcome import Outcome
from panda_cosim.study.compare.reference import Reference, kept_metadata
from panda_cosim.study.compare.report import write_report
from regress_support import CONTENT, MISSED_CONTENT, SUMMARY, columns, record
from view_support import run_scenario_outside

TABLE = TrajectoryTable(tuple(TableRow(time, "home", (0.0, 0.0, 0.0), 0.08) for time in (0.0, 1.0)))


def outcome(folder: Path, name: str, *, offset: float, nan: bool = False) -> Outcome:
    """Return an outcome of a small run that is off by a number of tolerances."""
    place = folder / name
    scenario = Scenario(name, TABLE, 0.4, purpose=f"<Tests> {name} & 'more'", folder=place)
    before = record(place / "before", columns())
    reference = Reference.of(before, SUMMARY, scenario.regression)
    reference.write(place / "reference.parquet", before)
    values = columns()
    values["controller.dq[2]"][150:250] += offset * 3e-7
    if nan:
        values["plant.qpos[1]"][300] = np.nan
    summary = MISSED_CONTENT if nan else {**CONTENT, "tracking": {"rms_mm": 101.0, "max_mm": None}}
    run = place / "now"
    recording = record(run, values, metadata={"versions": {"numpy": "</script>"}})
    (run / SUMMARY_FILE).write_text(json.dumps(summary))
    compared = compare_with_reference(
        Recording.open(run), Summary.read(summary), reference, scenario.regression
    )
    causes = changed(reference.metadata, kept_metadata(recording))
    compared = replace(compared, causes=tuple(causes))
    return Outcome(scenario, "same" if compared.ok else "differs", run, 1.5, compared)


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    good = outcome(folder, "good", offset=0.1)
    return [
        good,
        outcome(folder, "bad", offset=30.0),
        outcome(folder, "worse", offset=500.0, nan=True),
        replace(good, scenario=replace(good.scenario, name="dead"), verdict="failed",
                comparison=None, error="its process ended with signal 11"),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def report(outcomes, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(outcomes, path, {"controller.kp": 7.6})
    return path


def test_the_verdicts_come_first_and_name_what_has_changed(report):
    text = report.read_text(encoding="utf-8")
    names = re.findall(r'<td data-label=Scenario><a href="#s-(\w+)">', text)
    assert names == ["worse", "bad", "dead", "good"]  # an error hides no difference
    first_screen = text.partition("</table>")[0]
    assert "1 of 4 scenarios match their references" in first_screen
    assert "controller.kp = 7.6" in first_screen
    assert "its process ended with signal 11" in first_screen
    assert "plant.qpos[1] is nan at 0.300 s" in first_screen
    assert "is not a success, the reference is a success" in first_screen
    assert re.search(r"controller\.dq\[2\] off by \S+ rad at 0\.\d+ s", first_screen)
    # Metrics and origins stand there with their change.
    assert "<code>tracking.rms_mm</code></td><td class=num>100</td><td class=num>101</td>" in text
    assert "<code>tracking.max_mm</code></td><td class=num>150</td><td class=num>\u2013" in text
    assert "<code>versions.numpy</code></td><td class=num>1</td>" in text
    assert "timing.wall_s" not in text


def drawn(within: str, colour: str) -> str:
    """Return JavaScript that counts the plots in which a line of a colour is to be seen."""
    plots = f"[...document.querySelectorAll({json.dumps(within + ' .chart canvas')})]"
    # By 56, as a tube may lie over the line.
    return f"""{plots}.filter((each) => {{
        const {{ data }} = each.getContext("2d").getImageData(0, 0, each.width, each.height);
        const name = getComputedStyle(each).getPropertyValue("{colour}");
        const wanted = [1, 3, 5].map((at) => parseInt(name.slice(at, at + 2), 16));
        for (let i = 0; i < data.length; i += 4) {{
            if (wanted.every((value, c) => Math.abs(value - data[i + c]) < 56) && data[i + 3] > 100)
                return true;
        }}
    }}).length"""


@pytest.mark.parametrize(("width", "height", "scheme"), [(1280, 900, "dark"), (390, 844, "light")])
def test_the_page_shows_verdicts_and_plots(page, report, width, height, scheme):
    page.open(report, width, height, scheme)
    rows = "[...document.querySelectorAll('#verdicts tr')].filter(row => row.offsetHeight).length"
    assert page.value(rows) >= 4
    assert page.value("document.documentElement.scrollWidth") <= width
    page.value("document.getElementById('s-worse').scrollIntoView()")
    page.wait(f"{drawn('#s-worse', '--curve-1')} === 4")  # value and difference of two signals
    gaps = "[...PandaDifferences.figures.values()].flatMap(({ curve }) => curve.gaps)"
    assert page.value(f"{gaps}.length") == 1  # the one value that is none
    paper = page.value("getComputedStyle(document.body).backgroundColor")
    assert (paper == "rgb(255, 255, 255)") is (scheme == "light")
    assert page.errors == []
    assert all(address.startswith(("file:", "data:")) for address in page.requests)


def test_a_failing_scenario_is_found_and_zoomed(page, report):
    page.open(report)
    page.value("document.querySelector('#verdicts a[href=\"#s-bad\"]').click()")
    page.wait("location.hash === '#s-bad' && document.getElementById('s-bad').open")
    chart = "document.querySelector('#s-bad .chart')"
    page.wait(f"{drawn('#s-bad', '--curve-1')} > 0")
    page.value(f"{chart}.scrollIntoView({{behavior: 'instant', block: 'center'}})")

    def view() -> tuple[float, float]:
        return tuple(page.value(f"[+{chart}.dataset.from, +{chart}.dataset.to]"))  # type: ignore[return-value]

    assert view() == pytest.approx((0.0, 0.4))
    box, before = f"(b => [b.x, b.y, b.width])({chart}.getBoundingClientRect())", None
    while before != (now := page.value(box)):  # until the page has come to rest
        time.sleep(0.3)
        before = now
    x, y, width = now
    page.drag((x + 0.4 * width, y + 60), (x + 0.7 * width, y + 80))
    page.wait(f"+{chart}.dataset.from > 0")
    start, end = view()
    assert 0.05 < start < 0.2 < end < 0.35
    page.value(f"{chart}.querySelectorAll('button')[0].click()")
    assert view()[1] - view()[0] == pytest.approx((end - start) / 2)
    page.value(f"{chart}.querySelectorAll('button')[2].click()")
    assert view()[1] - view()[0] < 0.1  # about the worst instant
    page.value(f"{chart}.querySelectorAll('button')[3].click()")
    assert view() == pytest.approx((0.0, 0.4))
    # Its tube and a criterion are tried, and give the lines for scenario.toml.
    name = page.value(f"{chart}.closest('figure').querySelector('b').textContent")
    edit = f"{chart}.querySelector('.edit')"
    page.value(f"{edit}.open = true")
    page.wait(f"{edit}.querySelector('.lines').textContent.startsWith('[regression]')")
    outside = page.value(f"parseInt({edit}.querySelector('.says').textContent.match(/\\d+/)[0])")
    assert outside > 0
    typed = "f.value = '1e3'; f.dispatchEvent(new Event('input'))"
    page.value(f"(f => {{ {typed} }})({edit}.querySelector('input'))")
    says, lines = (f"{edit}.querySelector('.{part}').textContent" for part in ("says", "lines"))
    assert page.value(says).startswith("outside at 0 of")
    assert tomllib.loads(page.value(lines)) == {"regression": {name: 1e3}}
    page.value(f"{edit}.querySelector('select').dispatchEvent(new Event('input'))")
    (criterion,) = tomllib.loads(page.value(lines))["success"]["signal"]
    assert (criterion["signal"], criterion["reduce"]) == (name, "max")
    assert page.errors == []


@pytest.fixture(scope="module")
def outcomes_in_3d(tmp_path_factory):
    """Runs compared with the reference of pick_and_place."""
    folder, found = tmp_path_factory.mktemp("runs"), []
    scenario = load_scenario("pick_and_place")
    reference = Reference.read(scenario.folder / "reference.parquet")
    for name, how in (("good", ()), ("wrong", ("--set", "plant.block_pos[1]=0.46"))):
        run = run_scenario_outside(folder / name, *how)
        read = Recording.open(run), Summary.open(run), reference, scenario.regression
        compared = compare_with_reference(*read)
        verdict = "same" if compared.ok else "differs"
        found.append(Outcome(replace(scenario, name=name), verdict, run, 1.0, compared))
    return found


NOW = "PandaView.viewer.clock.time"
SHOWN = "window.PandaView?.viewer?.stage?.drawn > 0"


@pytest.mark.skipif(find_browser() is None, reason="no Chromium here")
def test_a_report_opens_at_the_worst_tick_and_shows_one_scenario(page, outcomes_in_3d, tmp_path):
    report_in_3d = tmp_path / "report.html"
    write_report(outcomes_in_3d, report_in_3d, {})
    page.open(report_in_3d, 760, 420)
    page.wait(SHOWN)
    worst = outcomes_in_3d[1].comparison.worst
    assert page.value(NOW) == pytest.approx(worst.time, abs=1e-9)
    assert page.value("document.querySelectorAll('#s-wrong .view.open .pv').length") == 1
    assert page.value("PandaView.viewer.stage.figures.length") == 2
    width = "document.querySelector('.pv-picture').clientWidth"
    assert page.value(width) > 400  # [px]: the report's style leaves the viewer its place
    # The scene is at that tick: the arm's joints are those of the recording.
    row = round(worst.time / 1e-3)
    expected = Recording.open(outcomes_in_3d[1].run)["plant.qpos"][row]
    shown = page.value(
        f"(q => (PandaView.viewer.runs[0].pose({NOW}, q), [...q]))(new Float64Array(16))"
    )
    assert np.abs(np.array(shown) - expected).max() < 2e-6  # [rad], [m], [1]
    titles = "[...document.querySelectorAll('#s-wrong .pv-chart h3')].map(h => h.textContent)"
    page.wait(f"{titles}.some(title => title.includes({json.dumps(worst.name)}))")
    assert page.requests == [report_in_3d.resolve().as_uri()]
    assert report_in_3d.stat().st_size <= 2e6  # [B]
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
