"""What a sweep's rows are of, what they are compared with, and how they are ranked."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyarrow as pa
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bounded import ran
from forked import command
from panda_cosim import InputError, Recording, Sweep, load_scenario, sweep
from panda_cosim.study.sweep.again import promote_row, scenario_of
from panda_cosim.study.sweep.convergence import convergence
from panda_cosim.study.sweep.packed import Loaded, identity, pack
from panda_cosim.study.sweep.store import Store
from panda_cosim.task.input_table import InputTable
from refusals import refused
from sweep_support import FORCE, pretended, rows_of, short_scenario, short_sweep

EXAMPLES = Path(__file__).parents[2] / "scenarios" / "examples"
pytestmark = pytest.mark.usefixtures("forked_workers")


def edit(folder: Path, *changes: tuple[str, str]) -> None:
    """Change the text of a scenario."""
    path = folder / "scenario.toml"
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")


def over_mass(*scenarios: Path, **keys: Any) -> Sweep:
    """Return a grid of two rows of each scenario."""
    vary: Any = {"plant.block_mass": {"values": [0.1, 0.2]}}
    names = tuple(map(str, scenarios))
    return Sweep(**{"scenario": names, "vary": vary, "design": "grid", **keys})


def test_scenarios_that_share_a_name_keep_their_own_runs(tmp_path):
    ours, theirs = short_scenario(tmp_path / "A/lift"), short_scenario(tmp_path / "B/lift")
    edit(theirs, ("20.0", "90.0"))
    out = sweep(over_mass(ours, theirs, keep="all"), tmp_path / "out", jobs=1).folder
    rows, store = rows_of(out), Store(out)
    assert [row["scenario"] for row in rows] == ["A/lift", "A/lift", "B/lift", "B/lift"]
    assert [row["status"] for row in rows] == ["success", "success", "missed", "missed"]
    for row in rows:
        digest = Recording.open(store.run_folder(row["index"])).sha256()
        assert digest == row["recording_sha256"]
    promote_row(out, 2, tmp_path / "mine")
    assert load_scenario(tmp_path / "mine").push[0].force == (0.0, 90.0, 0.0)


def test_a_sweep_goes_by_the_scenario_as_it_was_swept_and_by_the_same_code(tmp_path):
    folder, said = short_scenario(tmp_path / "short"), []  # type: ignore[var-annotated]
    values = {"plant.block_mass": [0.1, 0.2], "mismatch.seed": [1.0, 2.0]}
    definition = over_mass(folder, vary={key: {"values": each} for key, each in values.items()})
    out = sweep(definition, tmp_path / "out", jobs=1, remark=said.append).folder
    before = rows_of(out)
    idle = "vary: mismatch.seed changes no start value, no input and no criterion"
    assert said == [idle]
    assert Store(out).content.without_effect == ["mismatch.seed"]
    text = (out / "sweep.json").read_text()
    content = json.loads(text)
    content["origin"]["code"]["panda-cosim"] = "0123456789abcdef"
    (out / "sweep.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"code\.panda-cosim 0123456789abcdef -> "):
        sweep(definition, out, jobs=1)
    (out / "sweep.json").write_text(text)
    edit(folder, ("20.0", "90.0"))
    assert scenario_of(Store(out), 0)[1].push[0].force == (0.0, 20.0, 0.0)
    (out / "results" / "part-00000000.parquet").unlink()
    sweep(definition, out, jobs=1, remark=said.append)
    assert rows_of(out) == before
    assert said[1:-1] == [idle]
    assert f"scenario {folder}: has changed since the sweep began" in said[-1]
    shutil.rmtree(folder)
    done = command("sweep", "promote", out, "1", tmp_path / "mine", code=0)
    assert "cannot be used any more since the sweep began, which uses" in done.stderr
    assert load_scenario(tmp_path / "mine").push[0].force == (0.0, 20.0, 0.0)


@pytest.mark.parametrize("name", ["calibrated", "draw_circle"])
def test_a_scenario_stays_the_same_as_it_is_kept(name, tmp_path):
    packed = pack(Loaded(name, name, load_scenario(name)))
    Store(tmp_path).keep_scenarios([packed])
    again = Loaded(name, name, load_scenario(tmp_path / "scenarios" / "0" / name))
    assert again.scenario.name == name
    assert identity(pack(again)) == identity(packed)


def test_other_inputs_make_another_scenario():
    tables = (InputTable((0.0,), {"controller.vel_cmd[1]": (value,)}) for value in ("0.1", "0.2"))
    swept = (replace(load_scenario("push"), input_table=table) for table in tables)
    one, other = (identity(pack(Loaded("push", "push", scenario))) for scenario in swept)
    assert one != other


def test_rows_without_a_margin_are_worst_and_bad_ones_do_not_tie(tmp_path):
    outcomes = [("success", 0.5), ("missed", -1.5), ("timeout", None), ("missed", -7.0),
                ("success", None), ("unmeasured", None), ("unexpected", 0.2)]  # fmt: skip
    vary: Any = {FORCE: {"values": list(range(7))}}
    sweep = Sweep(scenario=("push",), design="grid", vary=vary)
    store = Store(pretended(tmp_path, sweep, lambda values: outcomes[int(values[FORCE])]))
    assert [row["index"] for row in store.worst(7, [])] == [2, 5, 3, 1, 6, 0, 4]


def test_rows_not_measured_and_expected_failures_are_what_they_are(tmp_path):
    bare, expecting = (short_scenario(tmp_path / name) for name in ("bare", "expecting"))
    edit(bare, ("[success]", "[success]\nmax_slip = 0.001"))  # nothing is held
    edit(expecting, ("= 0.1\n", '= 0.1\nexpect = "failure"\nexpect_reason = "no"\n'))
    vary: Any = {FORCE: {"values": [0.0, 100.0]}}
    definition = over_mass(bare, expecting, vary=vary, keep="failures")
    out = sweep(definition, tmp_path / "out", jobs=1).folder
    row, missed, calm, pushed = rows_of(out)
    assert (row["status"], row["missed"], row["margin"]) == ("unmeasured", None, None)
    assert row["error"].startswith("max_slip is not measured: ")
    assert row["margin.max_slip"] is None
    assert row["margin.tracking_max"] is not None
    with pytest.raises(InputError, match=r"row 0: max_slip is not measured: .*must have a verdict"):
        promote_row(out, 0, tmp_path / "mine")
    assert (missed["status"], missed["missed"]) == ("missed", "tracking_max")  # outranks max_slip
    assert missed["margin"] == missed["margin.tracking_max"]
    limit = tmp_path / "limit"
    assert limit / "reference.parquet" in promote_row(out, 1, limit, known_limit=True)
    assert (calm["status"], calm["missed"]) == ("unexpected", None)
    assert calm["margin"] > 0.0
    assert (pushed["status"], pushed["missed"]) == ("success", "tracking_max")
    assert sorted(path.name for path in (out / "runs").iterdir())[-1] == "0000002"  # of 3
    for index, is_as_expected in ((2, False), (3, True)):
        files = promote_row(out, index, tmp_path / "mine" / str(index))
        assert load_scenario(tmp_path / "mine" / str(index)).expect == "failure"
        assert (tmp_path / "mine" / str(index) / "reference.parquet" in files) == is_as_expected


def test_a_search_needs_a_margin(tmp_path):
    bare = short_scenario(tmp_path / "bare")
    edit(bare, ("tracking_max = 0.001\norientation_rms = 1.0\n", ""))
    definition = short_sweep(tmp_path, 2, design="search", scenario=(str(bare),))
    told = refused(sweep, definition, tmp_path / "out")
    assert "no margin to search by: it has no criteria" in told


@settings(max_examples=50, deadline=None)
@given(
    st.floats(0.5, 5.0), st.floats(-1.0, 1.0), st.floats(0.2, 5.0),
    st.permutations([1.0, 0.5, 0.2, 0.1]),
)  # fmt: skip
def test_margins_that_follow_a_power_of_the_step_have_its_order_and_limit(
    order, limit, size, steps
):
    assume(abs(size * 0.1**order) > 1e-6)  # of which rounding is no part
    margins = [limit + size * h**order for h in steps]
    columns = {"index": range(4), "step": steps, "margin.a": margins}
    content = SimpleNamespace(keys=["step"], nominal={"it": {}}, columns=["margin", "margin.a"])
    store: Any = SimpleNamespace(content=content, table=pa.table(columns).select)
    (found,) = convergence(store)
    assert found.criterion == "a"
    assert found.finest == limit + size * 0.1**order
    assert found.order == pytest.approx(order, abs=1e-6)
    assert found.limit == pytest.approx(limit, abs=1e-6)


@pytest.fixture(scope="module")
def studied(tmp_path_factory):
    """The folder of the example's study of steps, and what it says."""
    folder = tmp_path_factory.mktemp("steps") / "new"
    return folder, ran(["sh", EXAMPLES / "step_size.sh", folder], timeout=300).stdout


def test_the_study_of_steps_finds_order_and_limit_of_a_held_force(studied):
    folder, said = studied
    (line,) = (line.split() for line in said.splitlines() if line.startswith("place "))
    finest, order, limit = map(float, line[1:])
    store = Store(folder / "study")
    assert finest == pytest.approx(store.row(3)["margin.place"], rel=1e-5)
    assert order == pytest.approx(1.0, abs=0.05)
    assert limit == pytest.approx(-math.cos(2.0), abs=1e-4)  # [m] left of the middle


def test_steps_of_an_fmu_and_what_else_a_system_states_can_vary(studied, tmp_path):
    vary = [f"--vary={each}" for each in ("steps.spring=1,2", "tolerance=0,0.1")]
    done = command("sweep", studied[0] / "spring", *vary, "--out", tmp_path / "out", code=0)
    rows = rows_of(tmp_path / "out")
    assert "steps.spring" not in done.stderr
    assert [row["steps.spring"] for row in rows] == [1.0, 1.0, 2.0, 2.0]
    assert rows[0]["margin.place"] != rows[2]["margin.place"]
    assert rows[0]["margin.place"] == rows[1]["margin.place"]
