"""Shipped scenarios match their reference recordings; differences are reported with exit codes."""

import json
import os
import pty
import re
import shutil
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from fault_support import write_files
from forked import command as cli
from forked import run_pytest, script
from panda_cosim import load_scenario, shipped_scenarios
from panda_cosim.fmus.sources.targets import build
from panda_cosim.study.compare.history import Night
from panda_cosim.study.compare.outcome import MEANINGS, Outcome
from panda_cosim.study.compare.reference import REFERENCE_FILE, Reference
from panda_cosim.study.compare.regress import find_scenarios, start
from panda_cosim.study.compare.repeats import merged
from panda_cosim.study.work import Workers

pytestmark = pytest.mark.usefixtures("forked_workers")

SETTINGS = "duration = 0.2\n[success]\ntracking_max = 0.005\n"


@pytest.fixture(scope="module")
def outcomes(forked_workers, tmp_path_factory):
    """Run all shipped scenarios, two at a time."""
    build()  # once, not in each process
    folder = tmp_path_factory.mktemp("runs")
    longest_first = sorted(find_scenarios(), key=lambda scenario: -scenario.duration)
    with Workers(2) as workers:
        yield {s.name: start(workers, s, folder / s.name) for s in longest_first}


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_shipped_scenario_is_as_its_reference(outcomes, name):
    outcome = outcomes[name].result()
    if outcome.verdict == "skipped":
        pytest.skip(outcome.reason)
    assert outcome.ok, f"{outcome.verdict}: {outcome.reason}"


def test_a_reference_is_compact_and_says_what_made_it():
    for name, folder in shipped_scenarios().items():
        path = folder / REFERENCE_FILE
        assert path.stat().st_size <= 500_000  # bytes; noise compresses badly
        metadata = Reference.read(path).metadata
        assert metadata["scenario"] == name
        assert {"panda-cosim", "mujoco", "numpy"} <= metadata["versions"].keys()
        assert {"plant", "controller"} <= metadata["fmus"].keys()


@pytest.fixture
def mine(tmp_path):
    """Return a folder of scenarios with a short one in it."""
    return write_short(tmp_path / "mine" / "short").parent


def write_short(folder: Path, y: float = 0.005) -> Path:
    """Write a scenario in which the hand moves a little."""
    return write_files(folder, SETTINGS, "0,home,0,0,0,0.08", f"0.15,home,0,{y},0,0.06")


@pytest.fixture(scope="module")
def approved(tmp_path_factory):
    """Return the short scenario with a reference, to be copied."""
    folder = write_short(tmp_path_factory.mktemp("approved") / "short")
    new = cli("regress", "--scenarios", folder, "--update", code=0)
    assert "short: is new" in new.stdout
    return folder


AT_A_TERMINAL = """
import os, sys
sys.stdin = open(sys.argv.pop(1))
os.dup2(sys.stdin.fileno(), 0)
os.chdir(sys.argv.pop(1))
from panda_cosim.cli import main
main()
"""


def test_a_scenario_without_a_reference_is_judged_by_its_criteria(mine):
    judged = cli("regress", "--scenarios", mine, code=0)
    assert "Without a reference, judged by their criteria alone: short" in judged.stdout
    path = mine / "short" / "scenario.toml"
    path.write_text(SETTINGS.replace("tracking_max", "# tracking_max"))
    missing = cli("regress", "--scenarios", mine, code=2)
    advice = f"does not exist; `panda-cosim regress {mine / 'short'} --update` makes it"
    assert advice in " ".join(missing.stdout.split())


def test_a_report_keeps_runs_that_differ_and_replaces_only_what_regress_made(approved, tmp_path):
    """Recordings in ./runs and whatever else lies there are not lost to `--report .`."""
    precious = tmp_path / "runs" / "first" / "recording.parquet"
    precious.parent.mkdir(parents=True)
    precious.write_text("not to be made again")
    arguments = ("regress", "--scenarios", approved, "--report", tmp_path)
    taken = shutil.copytree(precious.parent, tmp_path / "runs" / "short")
    refused = cli(*arguments, code=2)
    assert "runs/short: was not made by regress" in refused.stderr
    assert "Running" not in refused.stderr
    shutil.rmtree(taken)
    other = cli(*arguments, "--set", "controller.gravity_feedforward=0.9", code=1)
    assert "controller.dq" in other.stdout
    case = ET.parse(tmp_path / "junit.xml").getroot()[0]
    assert (case.get("tests"), case.get("failures"), case.get("errors")) == ("1", "1", "0")
    assert "times its" in case.findtext("testcase/failure", "")
    kept = tmp_path / "runs" / "short"
    assert (kept / "recording.parquet").is_file()
    (kept / "notes.txt").write_text("mine")

    same = cli(*arguments, "--exact", code=0)
    assert "1 of 1 scenarios match their references" in same.stdout
    assert "short" in same.stderr  # the progress
    assert [path.name for path in kept.iterdir()] == ["notes.txt"]
    assert precious.read_text() == "not to be made again"
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_a_reference_is_overwritten_if_asked_for_after_a_page_of_differences(approved, tmp_path):
    folder = shutil.copytree(approved, tmp_path / "renamed")
    words = ("regress", "--scenarios", str(folder), "--update")
    assert "renamed: is unchanged" in cli(*words).stdout
    assert "renamed: is rounded anew" in cli(*words, "--noise", "--yes", code=0).stdout
    change = ("--set", "controller.gravity_feedforward=0.99999")  # too small for the defaults
    assert "controller.dq" in cli(*words[:-1], *change, code=1).stdout
    write_short(folder, 0.006)
    before = (folder / REFERENCE_FILE).read_bytes()
    assert "--yes" in cli(*words, code=2).stderr
    for answer, code in (("n", 1), ("y", 0)):
        keyboard, terminal = pty.openpty()
        os.write(keyboard, f"{answer}\n".encode())
        asked = script(AT_A_TERMINAL, os.ttyname(terminal), str(tmp_path), *words)
        assert asked.returncode == code, asked.stderr
        assert ((folder / REFERENCE_FILE).read_bytes() == before) == (answer == "n")
        told = re.search(r"runs/update-.*/report.html", asked.stdout)
        assert told
        page = (tmp_path / told[0]).read_text()
        assert re.search(r"renamed: controller\.\w+_cmd\[2\] off by", asked.stdout)
        assert asked.stdout.index(told[0]) < asked.stdout.index("Overwrite 1 of 1")
        assert "vel_cmd" in page
        assert "times its tolerance" in page


def test_a_damaged_or_too_coarse_reference_ends_no_suite_and_is_replaced(approved, tmp_path):
    _, damaged, coarse = (
        shutil.copytree(approved, tmp_path / name) for name in ("good", "damaged", "coarse")
    )
    content = (damaged / REFERENCE_FILE).read_bytes()
    (damaged / REFERENCE_FILE).write_bytes(content.replace(b'"success"', b'"succesr"'))
    settings = coarse / "scenario.toml"
    settings.write_text(settings.read_text() + "[regression]\nscale = 0.1\n")
    regress = ("regress", "--jobs", 1, "--scenarios", tmp_path)
    refused = cli(*regress, code=2)
    words = " ".join(refused.stdout.split())
    assert "reference.parquet: is not a reference" in words
    assert "too coarse for a tolerance of 1e-07 m; must be recorded again" in words
    assert "1 of 3 scenarios" in words
    updated = cli(*regress, "damaged", "coarse", "--update", "--yes", code=0)
    assert "coarse: is rounded anew, as its tolerances have changed" in updated.stdout
    results = json.loads(cli(*regress, "--json").stdout)["scenarios"]
    assert [(each["verdict"], each["worst"]["share"]) for each in results] == [("same", 0.0)] * 3


SWEEP = """scenario = "."
design = "grid"
min_success = 0.75
vary."success.tracking_max".values = [1e-9, 0.01, 0.02, 0.03]
"""


def test_a_suite_judges_the_sweeps_in_it(mine, tmp_path):
    """Of this one's four rows, three succeed."""
    sweep = mine / "short" / "sweep.toml"
    sweep.write_text(SWEEP)
    regress = ("regress", "--jobs", 1, "--scenarios", mine)
    good = cli(*regress, code=0)
    assert "2 of 2 scenarios and sweeps pass" in good.stdout
    sweep.write_text(SWEEP.replace("0.75", "0.76"))
    bad = cli(*regress, "--report", tmp_path / "report", code=1)
    assert "success rate 75 %, required 76 %" in bad.stdout
    assert (tmp_path / "report" / "runs" / "short (sweep)" / "report.html").is_file()
    assert "success rate 75 %" in (tmp_path / "report" / "junit.xml").read_text()
    assert cli(*regress, "--no-sweeps").returncode == 0
    tests = run_pytest(tmp_path, "-v", "--panda-scenarios", "mine", "mine")
    assert "1 failed, 1 passed" in tests.stdout, tests.stdout + tests.stderr
    assert "short (sweep): missed: success rate 75 %, required 76 %" in tests.stdout
    sweep.write_text(SWEEP.replace("min_success", "# min_success"))
    for more, code, words in (
        ((), 1, "sweep.toml: min_success is missing; must be above 0 in a suite"),
        (("--set", "controller.kp=7"), 2, "add --no-sweeps"),
    ):
        refused = cli(*regress, *more, code=code)
        assert words in " ".join((refused.stdout + refused.stderr).split())


def test_nested_scenarios_are_found_and_a_stray_sweep_is_named(approved, tmp_path):
    """As pytest finds them; what a run keeps of its scenario, and what is hidden, is none."""
    for place in ("same", "group/same", "group/deep/other", "runs/first/scenario", ".old/same"):
        shutil.copytree(approved, tmp_path / "mine" / place)
    (tmp_path / "mine" / "runs" / "first" / "recording.parquet").touch()
    (tmp_path / "mine" / "group" / "sweep.toml").write_text("[vary]\n")
    done = cli("regress", "--scenarios", tmp_path / "mine", "--json", code=0)
    results = json.loads(done.stdout)["scenarios"]
    assert [each["name"] for each in results] == ["other", "group/same", "same"]
    assert all(each["compared"] == 162 for each in results)
    assert "sweep.toml: has no scenario.toml beside it, so that it is not run" in done.stderr
    report = ("--report", tmp_path, "--set", "controller.gravity_feedforward=0.9")
    cli("regress", "--scenarios", tmp_path / "mine", *report, code=1)
    kept = [each.parent for each in (tmp_path / "runs").rglob("recording.parquet")]
    places = sorted(each.relative_to(tmp_path / "runs").as_posix() for each in kept)
    assert places == sorted(each["name"] for each in results)
    tests = run_pytest(tmp_path, "-v", "--panda-scenarios", "mine", "mine")
    assert "3 passed" in tests.stdout
    assert "has no scenario.toml beside it" in tests.stdout


def test_a_new_scenario_notices_what_its_template_used_to_hide(tmp_path):
    assert cli("new", tmp_path / "lift").returncode == 0
    regress = ("regress", "--scenarios", tmp_path)
    assert cli(*regress, "--update", "--yes").returncode == 0
    for change in ("plant.block_friction=0.5", "plant.payload=0.05", "controller.kp=7.5"):
        cli(*regress, "--set", change, code=1)


OWN_TESTS = """
import pytest

FOLDER = "mine/short"

def test_good(scenario_run):
    run = scenario_run(FOLDER, {"controller.kp": 8.0})
    run.assert_matches_reference()
    run.assert_success()
    assert run.recording["time"][-1] == 0.2
    assert run.summary["success"]

@pytest.mark.parametrize(("folder", "values", "kind"), [
    (FOLDER, {"table.rows[2].y": 0.006}, "matches_reference"),
    (FOLDER, {"success.tracking_max": 1e-9}, "success"),
    ("mine/bare", {}, "success"),
    ("mine/bare", {}, "matches_reference"),
])
def test_bad(scenario_run, folder, values, kind):
    getattr(scenario_run(folder, values), f"assert_{kind}")()

def test_dies(scenario_run):
    with pytest.raises(Exception, match="its process ended with signal 11"):
        scenario_run("mine/dies")
"""


def test_a_fixture_runs_scenarios_with_other_values(approved, tmp_path):
    shutil.copytree(approved, tmp_path / "mine" / "short")
    bare, dies = (write_short(tmp_path / "mine" / name) for name in ("bare", "dies"))
    (bare / "scenario.toml").write_text("duration = 0.2\n")
    (dies / "scenario.toml").write_text('duration = 0.2\n[fmus]\ncontroller = "dies.py:Dies"\n')
    law = "class Dies:\n    def update(self, time, qpos):\n        os.kill(os.getpid(), 11)\n"
    (dies / "dies.py").write_text(f"import os\n{law}")
    (tmp_path / "test_own.py").write_text(OWN_TESTS)
    tests = run_pytest(tmp_path, "test_own.py")
    assert "4 failed, 2 passed" in tests.stdout, tests.stdout + tests.stderr
    for words in (
        "short: expected a reference that it matches",
        r"controller.pos_cmd\[2\]: [\d,.]+ times its",
        r"short: expected success by criteria of its own\n+ *missed  tracking_max .* 1e-06 mm",
        "bare: expected success by criteria of its own",
        "bare: expected a reference that it matches",
        "reference.parquet: does not exist",
    ):
        assert re.search(words, tests.stdout), tests.stdout


def test_pytest_refuses_a_folder_of_which_it_collects_nothing(tmp_path):
    """Even beside tests that pass: pytest looks into no folder called build."""
    write_short(tmp_path / "build" / "short")
    (tmp_path / "test_own.py").write_text("def test_own():\n    pass\n")
    for name, message in (("build", "no scenario was collected"), ("nowhere", "no such folder")):
        refused = run_pytest(tmp_path, ".", "--panda-scenarios", name)
        assert refused.returncode == pytest.ExitCode.USAGE_ERROR, refused.stdout
        assert f"--panda-scenarios: {name}: {message}" in refused.stderr


RANDOM = """import numpy as np
class Law:
    def update(self, time, qpos):
        return np.hstack((qpos + 1e-3 * (time > 0.1) * np.random.default_rng().random(), 0.0))
"""


def test_a_case_whose_repeats_or_nights_differ_is_flaky(approved, tmp_path):
    shutil.copytree(approved, tmp_path / "mine" / "short")
    settings = 'duration = 0.2\nfmus.controller = "law.py:Law"\nsuccess.max_unwanted_force = 1e3\n'
    folder = write_files(tmp_path / "mine" / "random", settings)
    (folder / "law.py").write_text(RANDOM)
    regress = ("regress", "-j1", "--scenarios", folder.parent, "--report", tmp_path, "--overwrite")
    said = "2 of 2 repeats differ from the first run: the recording from tick 10"
    assert re.search(f"random +flaky +{said}", cli(*regress, "--repeat", 3, code=1).stdout)
    assert f'<failure type="flaky" message="{said}' in (tmp_path / "junit.xml").read_text()
    runs = [Outcome(load_scenario("push"), v, tmp_path, 1.0) for v in ("same", "differs", "same")]
    assert merged(*runs).reason.endswith("one is 'differs', the first 'same'")
    assert merged(runs[0], runs[2]) is runs[0]

    nights = tmp_path / "nights" / "history.jsonl"
    regress = (*regress, "--history", nights)
    told = [cli(*regress, code=0).stdout for _ in range(2)][1]
    assert "random: flaky: 2 results in 2 nights of the same code and scenario" in told
    assert "short: flaky" not in told
    assert (tmp_path / "report.html").read_text().count('"badge warn">flaky') == 2
    assert "flaky" not in (tmp_path / "junit.xml").read_text()
    (folder / "law.py").write_text(RANDOM.replace("0.1)", "0.11)"))
    assert "flaky" not in cli(*regress, code=0).stdout
    assert nights.read_text().count('"verdict":"holds","share":null,') == 3
    marks = [Night("", "", "", verdict, None, "", "").mark for verdict in MEANINGS]
    assert "".join(marks) == "✗✗✗✗??✓✓"  # the worst come first
    nights.write_text("{}")
    refused = "history.jsonl: line 1: value '{}'; must be one that regress --history wrote"
    assert refused in cli(*regress, code=2).stderr
    assert "history.jsonl" in cli(*regress[:-1], nights / "below", code=2).stderr
