"""What a sweep's report says, and its page in a browser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from browser import Page
from panda_cosim.fmus.errors import InputError
from panda_cosim.scenarios.sweep.definition import Sweep
from panda_cosim.scenarios.sweep.report import write_report
from panda_cosim.scenarios.sweep.statistics import failure_tree, share_bounds
from sweep_support import FORCE, HEAVY, MASS, made_up, pretended


def test_bounds_hold_the_share_with_their_confidence() -> None:
    # Ref: Clopper and Pearson 1934: of 0 in n the upper bound solves (1 - p)^n = 0.025.
    low, high = share_bounds(0, 300)
    assert low == 0.0
    assert (1 - high) ** 300 == pytest.approx(0.025, rel=1e-6)
    drawn = np.random.default_rng(0).binomial(50, 0.9, 100)
    held = [share_bounds(int(k), 50)[0] <= 0.9 <= share_bounds(int(k), 50)[1] for k in drawn]
    assert np.mean(held) >= 0.95


def test_the_tree_finds_where_failures_are() -> None:
    drawn = np.random.default_rng(2)
    values = {"mass": drawn.uniform(0, 2, 4000), "other": drawn.uniform(0, 1, 4000)}
    bad = (values["mass"] > HEAVY) & (values["other"] < 0.5)
    leaf = failure_tree(values, {}, bad, {})[0]
    assert leaf.share > 0.9
    assert leaf.bad / leaf.rows > 0.9
    words = leaf.rule.split()
    assert words[:2] == ["mass", ">"]
    assert float(words[2]) == pytest.approx(HEAVY, abs=0.05)
    assert words[4:6] == ["other", "<="]
    assert failure_tree(values, {}, np.zeros(4000, dtype=bool), {}) == []


def test_many_rows_give_a_small_page_that_says_so(tmp_path: Path) -> None:
    page = write_report(made_up(tmp_path / "many", 100_000))
    text = page.read_text(encoding="utf-8")
    assert page.stat().st_size < 5e6
    assert "2000 of 100000 rows" in text
    assert "<b>plant" not in text.partition("<main>")[2]


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 390)])
def test_the_page_draws_itself_and_asks_nobody(
    page: Page, scheme: str, width: int, tmp_path: Path
) -> None:
    path = write_report(made_up(tmp_path / "sweep", 300))
    page.errors.clear()
    page.requests.clear()
    page.open(path, width, 844, scheme)
    page.wait("window.sweepReport !== undefined")
    assert page.value("document.querySelectorAll('#scatter svg').length") == 2
    assert page.value("document.documentElement.scrollWidth") <= width
    size = "document.querySelector('#influence text').getBoundingClientRect().height"
    assert page.value(size) > 10  # px
    assert page.value("document.querySelectorAll('#map rect').length") >= 25
    assert page.value("document.querySelectorAll('#worst tbody tr').length") == 20
    assert page.value("document.querySelectorAll('#tree tbody tr').length") >= 1
    tree = str(page.value("document.querySelector('#tree tbody td').textContent"))
    assert tree.startswith(f"{MASS} > 1.")
    assert tree.endswith(" kg")
    assert page.value("document.querySelectorAll('main section b').length") == 4  # the tiles' own
    assert page.errors == []
    assert [r for r in page.requests if not r.startswith(("file:", "data:", "about:"))] == []


def test_a_grid_is_drawn_at_its_values(page: Page, tmp_path: Path) -> None:
    vary = {FORCE: {"uniform": [100, 140], "steps": 7}, "mismatch.preset": {"values": ["a", "b"]}}
    sweep = Sweep(scenario=("push",), design="grid", vary=vary)  # type: ignore[arg-type]
    page.open(write_report(pretended(tmp_path, sweep, lambda _: ("missed", -3.0))))
    page.wait("window.sweepReport !== undefined")
    for key, names in ((FORCE, "100 107 113 120 127 133 140"), ("mismatch.preset", "a b")):
        plot = f"document.querySelector('#scatter svg[data-key=\"{key}\"]')"
        assert page.value(f"{plot}.querySelectorAll('rect').length") == len(names.split())
        texts = f"[...{plot}.querySelectorAll('text')].map((each) => each.textContent).join(' ')"
        assert str(page.value(texts)).endswith(names)
    assert page.value("document.querySelectorAll('#map rect').length") == 14
    assert page.value("document.getElementById('influence')") is None
    assert page.errors == []


def test_brushing_an_axis_chooses_rows(page: Page, tmp_path: Path) -> None:
    page.open(write_report(made_up(tmp_path / "sweep", 300)))
    page.wait("window.sweepReport !== undefined")
    page.value(
        """(() => {
        const canvas = document.getElementById("parallel"), box = canvas.getBoundingClientRect();
        const fire = (kind, y) => canvas.dispatchEvent(new PointerEvent(kind,
            { clientX: box.left + 70, clientY: box.top + y, pointerId: 1, bubbles: true }));
        canvas.setPointerCapture = () => {};
        fire("pointerdown", 42); fire("pointermove", 128); fire("pointerup", 128);
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
def test_a_sweep_json_that_was_changed_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    folder = made_up(tmp_path / "swept", 4)
    path = folder / "sweep.json"
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        write_report(folder)
