"""Users' scenarios as tests: with criteria alone, expected to fail, broken, in xdist."""

import json
import re
import shutil
from xml.etree import ElementTree as ET

import pytest

from fault_support import write_files
from forked import command, run_pytest
from panda_cosim.fmus.atomic import TEMPORARY

HAND = '[[success.signal]]\nsignal = "plant.hand_xpos[3]"\nreduce = "min"\n'
FAILING = "duration = 0.2\n[success]\ntracking_rms = 1e-9\n"
EXPECTED = 'expect = "failure"\nexpect_reason = "no arm tracks to a nanometre"\n' + FAILING
SCENARIOS = {
    "good": f"duration = 0.2\n{HAND}above = 0.3\n",
    "failing": FAILING,
    "expected": f"{EXPECTED}max_slip = 0.001\n",  # not measured, which a missed one outranks
    "surprise": EXPECTED.replace("1e-9", "1.0"),
    "unmeasured": EXPECTED.replace("tracking_rms = 1e-9", "max_slip = 0.001"),
    "broken": f"duration = 0.2\n{HAND.replace('hand_xpos', 'hand_xpso')}above = 0.3\n",
}


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mine")
    for name, settings in SCENARIOS.items():
        write_files(folder / name, settings, "0,home,0,0,0,0.08", "0.15,home,0,0.005,0,0.06")
    return folder


MISSED = r"tracking_rms \S+ mm, allowed 1e-06 mm"


def test_regress_judges_each_scenario_by_itself(mine, tmp_path):
    report = tmp_path / "report"
    asked = ("regress", "--jobs", 1, "--scenarios", mine, "--json", "--report", report)
    done = command(*asked, cwd=tmp_path, code=1)
    found = {case["name"]: case for case in json.loads(done.stdout)["scenarios"]}
    verdicts = ["holds", "missed", "holds", "missed", "failed", "failed"]
    assert [found[name]["verdict"] for name in SCENARIOS] == verdicts
    assert re.fullmatch(MISSED, found["failing"]["reason"])
    assert found["surprise"]["reason"].endswith("is expected: no arm tracks to a nanometre")
    assert found["unmeasured"]["reason"].startswith("max_slip not measured")
    assert "did you mean 'plant.hand_xpos[3]'" in found["broken"]["reason"]
    assert found["good"]["criteria"][0]["margin"] > 0.0

    suite = ET.parse(report / "junit.xml").getroot()[0]
    cases = {str(case.get("name")): case for case in suite}
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("6", "2", "2")
    assert re.fullmatch(MISSED, str(cases["failing"].find("failure").get("message")))
    assert float(str(cases["failing"].get("time"))) > 0.0
    assert re.search(r"margin -\d\S* x", str(cases["failing"].find("failure").text))
    page = (report / "report.html").read_text(encoding="utf-8")
    assert "2 of 6 scenarios pass" in page
    assert "min plant.hand_xpos[3]" in page


def test_regress_makes_the_references_that_it_can_and_names_the_others(mine, tmp_path):
    for name in ("good", "failing", "expected", "surprise"):
        shutil.copytree(mine / name, tmp_path / "mine" / name)
    asked = ("regress", "--jobs", 1, "--scenarios", tmp_path / "mine")
    made = command(*asked, "--update", cwd=tmp_path, code=1)
    assert {path.parent.name for path in tmp_path.glob("mine/*/*.parquet")} == {"good", "expected"}
    assert "the run cannot become a reference: missed: tracking_rms" in made.stderr
    assert "the run cannot become a reference: unexpected success" in made.stderr
    assert TEMPORARY not in made.stdout + made.stderr, "a folder that is gone"

    same = command(*asked, "good", "expected", cwd=tmp_path, code=0)
    assert "2 of 2 scenarios match their references" in same.stdout


@pytest.mark.parametrize("more", [(), pytest.param(("-n", "1"), marks=pytest.mark.long)])
def test_pytest_says_each_criterion_in_a_line_also_in_xdist(mine, tmp_path, more):
    tests = run_pytest(tmp_path, "-v", "--panda-scenarios", mine, *more)
    assert tests.returncode == 1, tests.stdout + tests.stderr
    assert "4 failed, 2 passed" in tests.stdout
    assert re.search(rf"\n  missed  {MISSED}, margin -\d\S* x\n", tests.stdout)
    assert re.search(r"surprise: missed: is a success, but.*\n  ok      tracking_rms", tests.stdout)
    assert "broken" in tests.stdout
    assert "did you mean 'plant.hand_xpos[3]'" in tests.stdout
