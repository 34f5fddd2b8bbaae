"""Every figure of a sweep's report, computed again from the table's files alone."""

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray
from scipy.stats import beta, rankdata, spearmanr

from panda_cosim.study.sweep.definition import Sweep
from panda_cosim.study.sweep.report import write_report
from panda_cosim.study.sweep.results import influences
from sweep_support import FORCE, MASS, Outcome, pretended

PRESET = "mismatch.preset"
PRESETS = {"values": ["nominal", "calibrated", "worn"]}
SMALL = {MASS: {"uniform": [0.05, 2.0]}, FORCE: {"uniform": [0.0, 200.0]}}


def heavy(values: Mapping[str, Any]) -> tuple[str, float | None]:
    margin = (1.2 - values[MASS]) * (1.1 if values.get(FORCE, 0.0) < 119.5 else 7.0)
    return ("success" if margin >= 0 else "missed", margin)


def worn(values: Mapping[str, Any]) -> tuple[str, float | None]:
    margin = 0.4 - values[MASS] / 10 if values[PRESET] == "nominal" else -0.2 + values[MASS] / 100
    return ("success" if margin >= 0 else "missed", margin)


def partly(values: Mapping[str, Any]) -> tuple[str, float | None]:
    """The heaviest do not finish."""
    return ("timeout", None) if values[MASS] > 1.6 else heavy(values)


def second(values: Mapping[str, Any]) -> tuple[str, float | None]:
    bad = values["scenario"] == "jacobi"
    return ("missed", -0.5 - values[MASS]) if bad else ("success", 0.1 + values[MASS])


def contrary(values: Mapping[str, Any]) -> tuple[str, float | None]:
    """Of a scenario that expects a failure."""
    status, margin = heavy(values)
    return "unexpected" if status == "success" else "success", margin


def grid(steps: int, **more: Any) -> dict[str, Any]:
    vary = {key: each | {"steps": steps} for key, each in SMALL.items()}
    return {"design": "grid", "vary": vary | more}


WORDS = {MASS: SMALL[MASS], PRESET: PRESETS, "align": {"values": [True, False]}}
RANDOM = {"design": "random", "vary": SMALL, "samples": 300}
CASES: dict[str, tuple[dict[str, Any], Outcome, range | tuple[()]]] = {
    "grid": (grid(11), heavy, ()),
    "unfinished grid": (grid(12), heavy, range(120)),
    "grid of words": (grid(5) | {"vary": {PRESET: PRESETS, MASS: SMALL[MASS]}}, worn, ()),
    "list": ({"design": "list"}, heavy, ()),
    "random": (RANDOM, heavy, ()),
    "unfinished random": (RANDOM, heavy, range(200)),
    "words": ({"design": "sobol", "samples": 200, "vary": WORDS}, worn, ()),
    "no verdict": (RANDOM | {"samples": 150}, partly, ()),
    "two scenarios": (RANDOM | {"samples": 80, "scenario": ("push", "jacobi")}, second, ()),
    "expected failure": (RANDOM | {"samples": 90}, contrary, ()),
    "search": ({"design": "search", "vary": SMALL, "samples": 60}, partly, ()),
}


class Report:
    """A page, and the table that it is about."""

    def __init__(self, folder: Path) -> None:
        self.text = write_report(folder).read_text(encoding="utf-8")
        data = re.search(r'data-view="&quot;sweep&quot;">(.*?)</script>', self.text)
        assert data is not None
        self.data = json.loads(data[1])
        table = pq.read_table(folder / "results").to_pydict()
        self.column = {name: np.array(values) for name, values in table.items()}
        self.bad = self.column["status"] != "success"

    def tiles(self) -> str:
        """Return the text of the tiles."""
        source = self.text.partition('class="tiles"')[2].partition("</section>")[0]
        return " ".join(re.sub(r"<[^>]*>", " ", source).split())

    def names(self, key: str) -> NDArray[Any]:
        """A column as the page writes it."""
        return np.array(
            [str(v).lower() if isinstance(v, np.bool_) else v for v in self.column[key]]
        )


@pytest.fixture(scope="module", params=CASES)
def case(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("case")
    keys, outcome, rows = CASES[request.param]
    if keys["design"] == "list":
        drawn = np.random.default_rng(3).uniform([0.05, 0], [2, 200], (90, 2)).tolist()
        text = "\n".join([f"{MASS},{FORCE}", *(f"{m!r},{f!r}" for m, f in drawn)])
        (folder / "list.csv").write_text(text, encoding="utf-8")
        keys = keys | {"file": folder / "list.csv"}
    sweep = Sweep(**{"scenario": ("push",), "seed": 5} | keys)
    return request.param, Report(pretended(folder / "out", sweep, outcome, list(rows)))


def is_sampled(name: str) -> bool:
    return "grid" not in name and name not in ("list", "search")


def test_the_share_of_success_and_its_interval(case):
    name, report = case
    good, total = int((~report.bad).sum()), len(report.bad)
    if name.startswith("unfinished") or name == "search":
        bad = f"{total - good} rows without success among {total}"
        assert (bad if name == "search" else f"{good} of {total} rows so far") in report.tiles()
        assert "%" not in report.tiles()
        return
    assert f"{100 * good / total:.1f} % success: {good} of {total}" in report.tiles()
    # Ref: Clopper and Pearson, by quantiles of the beta distribution.
    low = beta.ppf(0.025, good, total - good + 1) if good else 0.0
    high = beta.ppf(0.975, good + 1, total - good) if good < total else 1.0
    interval = f"{100 * low:.2f} to {100 * high:.2f} %"
    assert (interval in report.tiles()) == ("Clopper" in report.tiles()) == is_sampled(name)


def test_rows_without_a_verdict_are_counted_and_no_missed_criterion(case):
    _, report = case
    said = {
        "missed": "missed a criterion",
        "unexpected": "met all criteria, though a failure is expected",
        "timeout": "stopped by the time limit; counted as failures, ranked lowest",
    }
    for status, words in said.items():
        count = int((report.column["status"] == status).sum())
        assert (f"{count} {words}" in report.tiles()) == (count > 0)
    first = report.text.partition("First missed criterion")[2].partition("</table>")[0]
    missed = sum(int(n) for n in re.findall(r'class="number">(\d+)</td>', first))
    assert missed == (report.column["status"] == "missed").sum()
    assert "timeout" not in first


def test_successes_beyond_a_limit_are_counted(case):
    _, report = case
    count = int((~report.bad & (report.column["summary.limits.torque_share[1]"] > 1)).sum())
    assert f"{count} of the {(~report.bad).sum()} successes exceeded a limit" in report.tiles()


def test_influences_are_rank_correlations_of_random_samples_alone(case):
    name, report = case
    found = report.data["influences"]
    assert (found is not None) == is_sampled(name)
    for margin, each in (found or {}).items():
        here = np.ones(len(report.bad), dtype=bool)
        if margin == "margin.max_slip":  # the second scenario has no such criterion
            here = report.column["scenario"] == "push"
        if not margin.startswith("margin"):  # of a metric, rows without it are left out
            here = np.array([v is not None for v in report.column[margin]])
        lowest = [-1e9 if v is None or math.isnan(v) else v for v in report.column[margin][here]]
        ranks, count = rankdata(lowest), len(lowest)
        for key, value, low, high in each:
            column = report.names(key)[here]
            if column.dtype.kind in "fi":
                assert value == pytest.approx(spearmanr(column, lowest).statistic, abs=1e-9)
                if name.startswith("unfinished"):
                    assert (low, high) == (None, None)
                else:
                    assert -1 <= low <= value <= high <= 1
                    if abs(value) > 0.9999:
                        continue
                    width = 1.96 * math.sqrt((1 + value**2 / 2) / (count - 3))
                    assert math.atanh(high) - math.atanh(low) == pytest.approx(2 * width, rel=1e-4)
            else:  # epsilon squared: between words, of all, with its bias taken off
                words = np.unique(column)
                within = sum(((r := ranks[column == w]) - r.mean()) @ (r - r.mean()) for w in words)
                mean = within / (count - len(words))
                share = 1 - mean * (count - 1) / ((ranks - ranks.mean()) @ (ranks - ranks.mean()))
                assert value == pytest.approx(math.sqrt(max(share, 0.0)), abs=1e-9)
                assert (low, high) == (None, None)


def test_bars_hold_the_rows_of_their_values(case):
    name, report = case
    for key, part in report.data["marginals"].items():
        labels = report.data["labels"].get(key)
        column = report.names(key)
        x = np.array([labels.index(v) for v in column]) if labels else column
        starts, ends = np.array(part["starts"]), np.array(part["ends"])
        last = np.where(ends == ends[-1], np.inf, ends)
        inside = (x[:, None] >= starts) & (x[:, None] < last)
        assert part["rows"] == inside.sum(axis=0).tolist()
        assert part["bad"] == inside[report.bad].sum(axis=0).tolist()
        assert sum(part["rows"]) == len(column)
        assert bool(part["bounds"]) == (is_sampled(name) and not name.startswith("unfinished"))
        if "grid" in name or labels:
            assert len(starts) == len(np.unique(column))
            middles = np.sort((starts + ends) / 2)
            assert middles == pytest.approx(np.unique(x), abs=1e-9)


def test_cells_hold_the_rows_of_their_values(case):
    _, report = case
    for each in report.data["maps"]:
        shape = tuple(map(len, each["names"]))
        rows, bad = (np.reshape(each[part], shape) for part in ("rows", "bad"))
        assert (rows.sum(), bad.sum()) == (len(report.bad), report.bad.sum())
        for axis, key in enumerate(each["keys"]):
            if key in report.data["labels"]:
                column = report.names(key)
                counts = [(column == word).sum() for word in each["names"][axis]]
                assert rows.sum(axis=1 - axis).tolist() == counts


def test_a_search_is_drawn_with_its_worst_so_far(page, tmp_path):
    keys, outcome, _ = CASES["search"]
    report = Report(pretended(tmp_path, Sweep(scenario=("push",), **keys), outcome))
    margin = np.array([-1e9 if v is None else v for v in report.column["margin"]], dtype=float)
    lowest = [min(margin[: i + 1]) for i in range(len(margin))]
    page.open(tmp_path / "report.html")
    page.wait("window.PandaSweep !== undefined")
    drawn = page.value("PandaSweep.bestSoFar(PandaSweep.data.points[PandaSweep.data.searched])")
    assert [-1e9 if v is None else v for v in drawn] == pytest.approx(lowest, rel=1e-4)
    assert page.value("document.querySelectorAll('#search circle').length") > 10


@pytest.mark.parametrize(
    ("there", "said"), [(range(99), "22 of 121 rows are missing: rows 99 to 120."),
                        (range(0, 121, 2), "60 of 121 rows are missing: among rows 1 to 119.")],
)  # fmt: skip
def test_an_unfinished_sweep_says_first_which_rows_are_missing(tmp_path, there, said):
    sweep = Sweep(scenario=("push",), **grid(11))
    report = Report(pretended(tmp_path, sweep, heavy, there))
    assert said in report.text.partition("<main>")[2].partition("</header>")[0]


def test_keys_without_influence_and_few_rows_have_no_correlation():
    result = np.linspace(-1.0, 1.0, 12)
    values = {"same": np.ones(12), "falls": -result}
    (found,) = influences(values, {}, result)
    assert (found.key, found.value) == ("falls", pytest.approx(-1.0))
    assert found.low is not None
    assert found.high is not None
    assert found.high - found.low > 0.02  # twelve rows in order do not make it certain
    (found,) = influences({"falls": np.arange(1e6)}, {}, -np.arange(1e6))
    assert (found.low, found.high) == (pytest.approx(-1.0), pytest.approx(-1.0))
    assert influences({"falls": -result[:9]}, {}, result[:9]) == []
    each_once = {"word": np.arange(12.0)}
    assert influences(each_once, {"word": list("abcdefghijkl")}, result)[0].value == 0.0
