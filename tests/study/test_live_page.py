"""`panda-cosim live --page`: pages that simulate by themselves, in Chromium and in Node."""

import gzip
import io
import json
import re
import shutil
import subprocess
import sys
import zipfile
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bounded import ran
from browser import Page
from fault_support import write_files
from forked import QUIET, command
from live_support import READY
from panda_cosim import Recording, Session, load_scenario, run_scenario
from panda_cosim.study.compare.reference import REFERENCE_FILE, Reference
from panda_cosim.study.compare.tubes import distances, widths
from panda_cosim.study.live.alone import refuse_outside
from panda_cosim.study.live.judged import criteria_of
from panda_cosim.study.live.page import offset_of
from panda_cosim.task.criteria import SignalCriterion
from panda_cosim.task.scenario import shipped_scenarios
from panda_cosim.task.trajectory import COMMANDS
from refusals import refused

ROOT = Path(__file__).parents[2]
EVERY = 20  # ticks between two rows
TICK = 0.001  # [s]
SAME = 1e-5  # [rad], [m] between two versions of MuJoCo, in contact
# Where they are further apart than a tube: times its width. Beyond its reach, the arm is all but
# singular; MuJoCo 3.14 leaves the tube as far (763 times) where it runs natively.
WIDER = {"beyond_reach": 1000.0}
PYTHON = ("--page: sensors", "--page: controller", "--page: a client")  # which has no module
LOCAL = ("file:", "blob:", "data:", "about:")
SERIES = "(name) => PandaView.viewer.runs[0].series(name).then(({ values }) => Array.from(values))"
FAST = """{
    const speed = document.querySelector('.pv-speed');
    speed.value = '4';
    speed.dispatchEvent(new Event('change'));
}"""
SPAN = "PandaView.viewer.runs[0].span[1]"
SCENARIOS = ROOT / "scenarios"
ALONE = [
    "beyond_reach", "collision", "elastic", "far_reach", "fast_circle", "heavy_block", "jacobi",
    "near_singular", "pick_and_place", "pick_and_place_fast", "pick_and_place_fast_fr3",
    "place_and_pick_again", "push", "push_block", "rotated_block", "slippery_block",
    "slow_controller", "stack_blocks", "tutorial",
]  # fmt: skip

# The others take minutes. These are of a spline, Jacobi, pushes, an FR3, and a scene of its own.
QUICK = ("fast_circle", "jacobi", "push", "pick_and_place_fast_fr3", "stack_blocks")
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="no Node here")


def quick(*names: str) -> list[Any]:
    """All scenarios, of which some are not long."""
    return [pytest.param(n, marks=() if n in names else pytest.mark.long) for n in ALONE]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Write the page of a scenario once."""
    folder = tmp_path_factory.mktemp("pages")

    @cache
    def write(name: str, *options: str) -> Path:
        path = folder / f"{name}{len(options)}.html"
        command("live", name, "--page", path, *options, code=0)
        return path

    return write


@pytest.fixture(scope="module")
def ended(written):
    """Run a scenario's page in Node to its end, once."""
    return cache(lambda name: told(written(name), *steps(load_scenario(name).ticks)))


class Told(SimpleNamespace):
    """What a page's worker told: columns, rows (n, columns), status, refused, journal."""

    def __getitem__(self, column: str) -> Any:
        return self.rows[:, self.columns.index(column)]


def told(page: Path, *commands: dict[str, object]) -> Told:
    """Give commands to a page's worker in Node, from its first row on."""
    asked = ["node", str(ROOT / "tests/page_in_node.mjs"), str(page), json.dumps(commands)]
    said = json.loads(subprocess.run(asked, check=True, capture_output=True, timeout=300).stdout)
    text = page.read_text(encoding="utf-8")
    begin = text.index("{", text.index('data-view="&quot;live&quot;"'))
    columns = json.JSONDecoder().raw_decode(text, begin)[0]["columns"]
    return Told(**said | {"columns": columns, "rows": np.array(said["rows"])})


def steps(ticks: int) -> list[dict[str, object]]:
    return [{"do": "step", "ticks": EVERY}] * -(-ticks // EVERY)


@needs_node
@pytest.mark.parametrize("name", quick(*QUICK))
def test_a_shipped_scenario_runs_to_its_end_within_the_tube_of_its_reference(ended, name):
    scenario, reference = load_scenario(name), Reference.read(SCENARIOS / name / REFERENCE_FILE)
    run = ended(name)
    assert run.status["message"].startswith("the scenario is over; ")
    assert run.status["over"]
    half, ticks = widths(reference, scenario.regression), scenario.regression.ticks(TICK)
    rows = np.rint(run["time"] / TICK).astype(int)
    inputs = {f"controller.{command}" for command in COMMANDS}
    shares = {}
    for column in (each for each in run.columns if each in half):
        # A leader's outputs in the last row are those of the tick before.
        leads = column.startswith("controller.") and column not in inputs
        at = rows - (leads and scenario.coupling == "gauss-seidel")
        known = (at >= 0) & (rows < scenario.ticks)
        rounding = reference.quanta.get(column, 0.0) / 2
        apart = distances(run[column][known], at[known], reference[column], rounding, ticks)
        shares[column] = apart.max() / half[column]
    assert len(shares) > 150
    assert max(shares.values()) < WIDER.get(name, 1.0), max(shares, key=shares.__getitem__)


JUDGED = """[success]
tracking_rms = 1e-6
tracking_max = 1.0
min_lift = 0.1
signal = [
    {signal = "plant.hand_xpos[3]", reduce = "min", above = 0.9, below = 2.0},
    {name = "late", signal = "plant.hand_xpos[3]", reduce = "max", from = 0.1, below = 0.9},
]
"""


@needs_node
def test_a_criterion_of_what_a_page_has_no_column_of_is_named_alone():
    """Else the length of nothing, 0, would be below its bound."""
    length = SignalCriterion(("norm", ("plant.jac", "plant.qpos")), "max", below=1.0, name="length")
    success = SimpleNamespace(signal=(length,), body=())
    session: Any = SimpleNamespace(
        scenario=SimpleNamespace(success=success), numbers=lambda: {"plant.qpos[1]": 0.0}
    )
    assert [{*each} for each in criteria_of(session)] == [{"name", "direction", "bound"}]


def test_simple_criteria_are_judged_in_the_page_and_the_others_named(tmp_path):
    push = "[[push]]\nforce = [20, 0, 0]\nstart = 0.02\nduration = 0.05\n"
    write_files(tmp_path / "it", f"duration = 0.2\n{push}{JUDGED}")
    command("live", tmp_path / "it", "--page", tmp_path / "page.html", code=0)
    said = told(tmp_path / "page.html", *steps(200)).status["message"].split("; ")
    missed = [each.partition(", ")[0].rpartition(" ") for each in said[1:3]]
    assert [name for name, _, _ in missed] == ["min plant.hand_xpos[3] above", "tracking_rms"]
    criteria = run_scenario(tmp_path / "it", tmp_path / "run").summary.criteria
    values = {each.name: each.value for each in criteria}
    for name, _, value in missed:
        assert float(value) == pytest.approx(values[name], rel=0.005)  # three digits
    assert said[3:] == ["2 of 4 criteria hold", "not judged here: min_lift, late"]


@needs_node
def test_what_is_held_moves_and_set_acts_as_in_a_session(written):
    page, place = written("rotated_block"), [0.5, -0.1, 0.5]
    acts = [
        {"do": "set", "name": "controller.kp", "value": 12},
        {"do": "set", "name": "controller.ik_gain", "value": 40.0},
        {"do": "set", "name": "controller.reaction", "value": "stop"},
        {"do": "set", "name": "plant.push_force", "value": [0, 20, 5]},
        {"do": "waypoint", "row": 4, "position": place},
    ]
    run = told(
        page, *steps(300), *acts, *steps(200), {"do": "release", "name": "plant.push_force"},
        {"do": "set_coupling", "coupling": "jacobi"}, *steps(700),
    )  # fmt: skip
    assert not run.refused
    with Session("rotated_block", values={}) as session:
        session.step(300)
        for act in acts[:4]:
            session.set(act["name"], act["value"])
        session.move_waypoint(4, position=offset_of(session, 4, place))
        session.step(200)
        session.release("plant.push_force")
        session.set_coupling("jacobi")
        session.step(700)
        there = session.state()
    apart = {c: abs(run[c][-1] - there[c]) for c in run.columns if c.startswith("plant.q")}
    assert max(apart[c] for c in apart if c.startswith("plant.qpos")) < SAME
    assert run.journal["session.jsonl"].count("\n") == 1 + 7 + 1


def test_shipped_scenarios_are_refused_by_name_or_are_tested():
    for name in set(shipped_scenarios()) - {*ALONE}:
        assert refused(refuse_outside, Session(name).prepared).startswith(PYTHON)


@needs_node
def test_bad_commands_are_refused_in_one_line_and_change_nothing(written):
    bad = [
        {"do": "set", "name": "controller.kp", "value": 1e9},
        {"do": "set", "name": "plant.block_mass", "value": 1.0},
        {"do": "set", "name": "plant.push_force", "value": [1.0]},
        {"do": "release", "name": "plant.push_force"},
        {"do": "waypoint", "row": 0, "position": [0.5, 0.0, 0.5]},
        {"do": "waypoint", "row": 99, "position": [0.5, 0.0, 0.5]},
        {"do": "keep", "name": "mine"},
    ]
    usual, run = told(written("push"), *steps(100)), told(written("push"), *bad, *steps(100))
    assert ["\n" in line for line in run.refused] == [False] * len(bad)
    assert (run.rows == usual.rows).all()


WILD = """<body pos="2 2 2">
    <joint name="wild" type="slide" stiffness="1e12" springref="1"/><geom size="0.01" mass="1e-6"/>
</body></worldbody>"""  # a spring that no time step suits


@needs_node
def test_a_failure_ends_the_run_in_a_line_and_restart_begins_another(tmp_path):
    folder = shutil.copytree(SCENARIOS / "stack_blocks", tmp_path / "wild")
    model = folder / "two_blocks.xml"
    model.write_text(model.read_text().replace("</worldbody>", WILD))
    command("live", folder, "--page", tmp_path / "page.html", code=0)
    failed = told(tmp_path / "page.html", *steps(100))
    assert re.match("t = 0.000 s: plant: .*diverged", failed.status["message"])
    assert len(failed.rows) == 1
    assert len(failed.refused) == 4  # later steps
    again = told(tmp_path / "page.html", *steps(100), {"do": "restart"})
    assert (again.status["run"], again.status["message"]) == (2, "")
    assert (again.rows[0] == again.rows[1]).all()


@needs_node
def test_replay_repeats_a_journal_and_says_how_far_it_is_from_the_page(written, tmp_path):
    run = told(
        written("push_block"), *steps(200), {"do": "set", "name": "controller.kp", "value": 5.0},
        {"do": "waypoint", "row": 3, "position": [0.6, 0.1, 0.45]}, *steps(600),
    )  # fmt: skip
    for path, text in run.journal.items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(text, encoding="utf-8")
    said = command("replay", tmp_path, "--out", tmp_path / "again", *QUIET)
    assert "the page" in said.stderr + said.stdout
    again = Recording.open(tmp_path / "again")
    assert again.time[-1] == pytest.approx(run["time"][-1])
    for i in range(1, 8):
        assert again[f"plant.qpos[{i}]"][-1] == pytest.approx(run[f"plant.qpos[{i}]"][-1], abs=SAME)


def test_a_page_is_small_and_allows_its_own_scripts_alone(written):
    page = written("pick_and_place").read_bytes()
    assert len(gzip.compress(page, 9)) < 2.0e6
    policy = re.search(rb'Content-Security-Policy" content="([^"]*)"', page)[1].decode()
    allowed = dict(part.split(" ", 1) for part in policy.split("; "))
    assert allowed["default-src"] == "'none'"
    assert allowed["worker-src"] == "blob:"
    assert "connect-src" not in allowed
    assert "unsafe-inline" not in allowed["script-src"]
    assert "'wasm-unsafe-eval'" in allowed["script-src"]


@needs_node
@pytest.mark.long
def test_the_modules_are_those_of_the_sources():
    ran([sys.executable, ROOT / ".ci/engine.py", "--check"])


@needs_node
@pytest.mark.parametrize("name", quick(*QUICK[-2:]))
def test_chromium_and_node_compute_the_same_bits(written, ended, page: Page, name):
    page.open(written(name))
    page.wait(READY)
    page.value(FAST)
    page.wait(f"{SPAN} >= {load_scenario(name).duration!r}")
    columns = [f"plant.qpos[{i}]" for i in range(1, 17)]
    seen = page.value(f"Promise.all({json.dumps(['time', *columns])}.map({SERIES}))")
    usual = ended(name)
    rows = {round(time / TICK): row for time, row in zip(usual["time"], usual.rows, strict=True)}
    shared = [at for at, time in enumerate(seen[0]) if round(time / TICK) in rows]
    assert len(shared) > 10
    for column, values in zip(columns, seen[1:], strict=True):
        index = usual.columns.index(column)
        there = [rows[round(seen[0][at] / TICK)][index] for at in shared]
        assert [values[at] for at in shared] == there
    assert not page.errors
    assert not [url for url in page.requests if not url.startswith(LOCAL)]


def test_a_page_begins_again_at_its_end_unless_it_is_told_not_to(written, page: Page):
    page.open(written("elastic"))
    page.wait(READY)
    page.value(FAST)
    gain = "document.querySelector('.pv-parameters input[aria-label=\"controller.ik_gain 1/s\"]')"
    page.value(f"{gain}.value = 20; {gain}.dispatchEvent(new Event('change'))")
    page.wait(f"{SPAN} > 1.0")
    page.wait(f"{SPAN} < 1.0")
    page.wait(f"{SPAN} > 0.2")
    assert page.value(f"{gain}.value") == "20"
    page.click(".pv-again input")
    page.wait("document.querySelector('.pv-says').textContent.startsWith('the scenario is over')")
    page.value("new Promise((done) => setTimeout(done, 3000))")
    assert page.value(SPAN) == pytest.approx(1.1)


def test_a_push_is_drawn_a_parameter_is_reset_and_the_journal_is_downloaded(written, page: Page):
    page.open(written("push"))
    page.wait(READY)
    page.click(".pv-run")  # pause
    page.wait("document.querySelector('.pv-run').textContent === 'Run'")
    shown = "document.querySelectorAll('.pv-newtons:not([hidden])')"
    sizes = f"Array.from({shown}, (e) => e.textContent)"
    assert page.value(sizes) == []
    ticks = round(0.55 / TICK) - round(page.value(SPAN) / TICK)
    page.value(f"for (let i = 0; i < {ticks}; i++) document.querySelector('.pv-tick-on').click()")
    page.wait(f"{SPAN} > 0.5499")
    page.wait(f"JSON.stringify({sizes}) === '[\"30.0 N\"]'")
    title = page.value("document.querySelector('.pv-chart h3').textContent")
    assert title.startswith("Tracking error")
    page.value("document.querySelectorAll('.pv-tab')[1].click()")
    field = "document.querySelector('.pv-parameters input[aria-label=\"controller.kp 1\"]')"
    back = f"{field}.parentElement.querySelector('.pv-reset')"
    page.value(f"{field}.value = 20; {field}.dispatchEvent(new Event('change'))")
    page.wait(f"!{back}.hidden")
    page.value(f"{back}.click()")
    page.wait(f"{back}.hidden && {field}.value === '8'")
    page.value("URL.createObjectURL = (blob) => ((window.saved = blob), 'blob:none')")
    page.click(".pv-journal")
    page.wait("window.saved !== undefined")
    content = page.value("saved.arrayBuffer().then((b) => Array.from(new Uint8Array(b)))")
    with zipfile.ZipFile(io.BytesIO(bytes(content))) as archive:
        assert archive.testzip() is None
        assert {"session.jsonl", "scenario/scenario.toml"} < {*archive.namelist()}


@pytest.mark.long
def test_the_tutorials_numbers_are_those_of_runs(tmp_path):
    text = (ROOT / "docs/learn/why.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (none|`.*`) \| (\S+) mm \| (\S+) mm \|$", text, re.M)
    assert len(rows) == 11
    for number, (changes, largest, rms) in enumerate(rows):
        values = [word for change in changes.split("`")[1::2] for word in ("--set", change)]
        folder = tmp_path / str(number)
        command("run", "pick_and_place", "--out", folder, *QUIET, *values)
        found = json.loads((folder / "summary.json").read_text())["tracking"]
        # Three digits; the half of the last one, and what rounding adds to runs that diverge.
        assert found["max_mm"] == pytest.approx(float(largest), rel=0.006), changes
        assert found["rms_mm"] == pytest.approx(float(rms), rel=0.006), changes
