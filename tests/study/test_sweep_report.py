"""What a sweep's report says, and its page in a browser."""

import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from browser import Page
from panda_cosim import InputError, Sweep, sweep
from panda_cosim.study.sweep.report import write_report
from panda_cosim.study.sweep.results import Results
from panda_cosim.study.sweep.store import Store
from sweep_support import FORCE, made_up, pretended, short_sweep


def test_many_rows_give_a_small_page_that_says_so(tmp_path):
    page = write_report(made_up(tmp_path / "many", 20_000))
    text = page.read_text(encoding="utf-8")
    assert page.stat().st_size < 5e6
    assert re.search(r"\(40\d\d of 20000 are drawn", text)
    assert "<b>plant" not in text.partition("<main>")[2]


def test_each_number_of_a_row_but_its_wall_time_is_on_the_page(tmp_path):
    results = Results(Store(made_up(tmp_path / "sweep", 4)))
    assert results.metrics == ["summary.limits.torque_share[1]", "reach_m"]


def test_commands_on_the_page_are_made_of_checked_fields(tmp_path):
    folder = made_up(tmp_path / "sweep", 30)
    part, evil = folder / "results" / "part-00000000.parquet", "panda-cosim; touch x"
    table = pq.read_table(part)
    column = table.column_names.index("command")
    pq.write_table(table.set_column(column, "command", pa.array([evil] * table.num_rows)), part)
    text = write_report(folder).read_text(encoding="utf-8")
    assert "touch x" not in text
    assert "panda-cosim run push --set plant.block_mass=" in text
    content = json.loads((folder / "sweep.json").read_text(encoding="utf-8"))
    content["origin"]["definition"]["scenario"] = ["--out=x"]
    (folder / "sweep.json").write_text(json.dumps(content), encoding="utf-8")
    text = write_report(folder).read_text(encoding="utf-8")
    assert "panda-cosim run --out" not in text
    assert "panda-cosim run ./--out=x --set" in text
    indices = pa.array([f"{i}; touch x" for i in range(table.num_rows)])
    pq.write_table(table.set_column(0, "index", indices), part)
    with pytest.raises(InputError, match=r"results: cannot be read: column index has no whole num"):
        write_report(folder)


def count_of(page: Page, selector: str) -> int:
    return int(page.value(f"document.querySelectorAll({json.dumps(selector)}).length"))


def texts_of(page: Page, selector: str) -> list[str]:
    texts = f"[...document.querySelectorAll({json.dumps(selector)})].map((e) => e.textContent)"
    return list(page.value(texts))


def select(page: Page, name: str, value: str) -> None:
    change = f"each.value = {json.dumps(value)}; each.dispatchEvent(new Event('change'))"
    page.value(f"(each => {{ {change} }})(document.getElementById({json.dumps(name)}))")


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 390)])
def test_the_page_draws_itself_and_asks_nobody(page, scheme, width, tmp_path):
    path = write_report(made_up(tmp_path / "sweep", 300))
    page.open(path, width, 844, scheme)
    page.wait("window.PandaSweep !== undefined")
    bad = page.value("PandaSweep.data.bad.filter(Boolean).length")
    assert count_of(page, "#chart .cross") == bad > 100
    assert count_of(page, "#chart .dot") == 300 - bad
    assert page.value("document.documentElement.scrollWidth") <= width
    assert page.value("document.querySelector('#chart svg').clientWidth") > 0.8 * width - 40
    assert count_of(page, "#map [data-row]") == 300
    assert count_of(page, "#worst tbody tr") == 20
    assert count_of(page, "main section.tiles b") == 4
    unnamed = "e => !(e.labels?.length || e.textContent.trim() || e.getAttribute('aria-label'))"
    controls = "[...document.querySelectorAll('select, button, svg, canvas')]"
    assert page.value(f"{controls}.filter(e => !e.closest('[hidden]')).filter({unnamed})") == []
    select(page, "metric", "failures")
    assert count_of(page, "#chart .bar") > 5
    assert page.errors == []
    assert [r for r in page.requests if not r.startswith(("file:", "data:", "about:"))] == []


def test_a_grid_is_drawn_at_its_values(page, tmp_path):
    vary = {FORCE: {"values": [1, 2, 4, 100]}, "mismatch.preset": {"values": ["a", "b"]}}
    sweep = Sweep(scenario=("push",), design="grid", vary=vary)  # type: ignore[arg-type]

    def outcome(values: Mapping[str, Any]) -> tuple[str, float]:
        return "missed" if values[FORCE] == 100 else "success", -3.0 * values[FORCE]

    page.open(write_report(pretended(tmp_path, sweep, outcome)))
    page.wait("window.PandaSweep !== undefined")
    for key, names in ((FORCE, ["1", "2", "4", "100"]), ("mismatch.preset", ["a", "b"])):
        select(page, "key", key)
        assert [text for text in texts_of(page, "#chart text") if text in names] == names
        across = "[...document.querySelectorAll('#chart line.axis')].map(e => e.getAttribute('x1'))"
        places = sorted({float(x) for x in page.value(across)})[1:]  # without the axis itself
        assert np.ptp(np.diff(places[: len(names)])) < 1e-6  # [px]: no holes
    select(page, "key", FORCE)
    assert count_of(page, "#chart .curve") == 2  # one for each preset
    assert count_of(page, "#chart .cross") == 2
    cells = [text for text in texts_of(page, "#map text") if "\u2212" in text]
    assert sorted(cells) == sorted(2 * ["\u22123", "\u22126", "\u221212", "\u00d7 \u2212300"])
    assert "push[1].force[2] [N]" in texts_of(page, "#chart text")
    assert page.value("document.getElementById('influence')") is None
    assert page.errors == []


@pytest.mark.usefixtures("forked_workers")
def test_any_metric_is_drawn_with_its_unit_and_a_kept_row_opens_in_3d(page, tmp_path):
    gains = {"vary": {"controller.kp": {"values": [6.0, 8.0, 12.0]}}}
    definition = short_sweep(tmp_path, 0, design="grid", keep="all", **gains)
    folder = sweep(definition, tmp_path / "out", jobs=1).folder
    page.open(write_report(folder))
    page.wait("window.PandaSweep !== undefined")
    select(page, "metric", "summary.tracking.max_mm")
    assert "tracking.max [mm]" in texts_of(page, "#chart text")
    assert count_of(page, "#chart .curve") == 1
    assert count_of(page, "#chart .cross") == 0
    runs = [folder / "runs" / f"{i:07d}" for i in range(3)]
    errors = [json.loads((r / "summary.json").read_text())["tracking"]["max_mm"] for r in runs]
    dots = "[...document.querySelectorAll('#chart .dot')]"
    heights = np.array(page.value(f"{dots}.map((dot) => -dot.getAttribute('cy'))"), dtype=float)
    rise, of = np.diff(heights), np.diff(errors)
    assert rise[0] / rise[1] == pytest.approx(of[0] / of[1], rel=1e-3)
    link = page.value("document.querySelector('#worst a').href")
    page.visit(link)
    page.wait("window.PandaView?.viewer?.stage?.drawn > 0")
    assert page.errors == []


def test_brushing_an_axis_chooses_rows(page, tmp_path):
    page.open(write_report(made_up(tmp_path / "sweep", 300, third=True)))
    page.wait("window.PandaSweep !== undefined")
    page.value(
        """(() => {
        const canvas = document.getElementById("parallel"), box = canvas.getBoundingClientRect();
        const fire = (kind, y) => canvas.dispatchEvent(new PointerEvent(kind,
            { clientX: box.left + 80, clientY: box.top + y, pointerId: 1, bubbles: true }));
        canvas.setPointerCapture = () => {};
        fire("pointerdown", 46); fire("pointermove", 128); fire("pointerup", 128);
        })()"""
    )
    said = str(page.value("document.getElementById('brushed').textContent"))
    count, failing = (int(said.split()[i]) for i in (0, 6))
    # The upper 29 % of the axis: the heaviest, which all fail.
    assert 0 < count < 200
    assert failing == count


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"nominal"', '"nominals"', "nominal: Field required"),
        ("{", "[", "Invalid JSON"),
        ('"format": 2', '"format": 1', "format: Input should be 2"),
    ],
)
def test_a_sweep_json_that_was_changed_is_refused(tmp_path, old, new, message):
    folder = made_up(tmp_path / "swept", 4)
    path = folder / "sweep.json"
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        write_report(folder)
