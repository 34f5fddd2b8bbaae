"""Requirements: scenarios and criteria name those that they prove, and reports say whether."""

from xml.etree import ElementTree as ET

import pytest

from fault_support import write_scenario
from forked import command
from panda_cosim.task.scenario import Scenario

CRITERIA = """
[[success.signal]]
name = "high enough"
signal = "plant.hand_xpos[3]"
reduce = "min"
above = 0.1
below = 2.0
requirements = ["REQ-2"]
[[success.signal]]
name = "too slow"
signal = "plant.qvel[4]"
reduce = "peak"
below = 1e-9
requirements = ["REQ-2", "REQ-3"]
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The report of two scenarios, one of which misses a criterion."""
    folder = tmp_path_factory.mktemp("suite")
    whole = 'requirements = ["REQ-1"]\n[success]\ntracking_max = 0.1\n'
    write_scenario(folder / "good", 0.02, whole)
    write_scenario(folder / "bad", 0.02, CRITERIA)
    command("regress", "--scenarios", folder, "--report", folder / "report")
    return folder / "report"


def test_criteria_state_their_requirements_by_their_names_in_results(tmp_path):
    scenario = Scenario.read(write_scenario(tmp_path / "s", 0.02, CRITERIA))
    assert scenario.success.required == {
        "high enough above": ("REQ-2",),
        "high enough below": ("REQ-2",),
        "too slow": ("REQ-2", "REQ-3"),
    }


def test_each_requirement_has_what_proves_it_and_the_verdict(report):
    root = ET.parse(report / "junit.xml").getroot()
    stated = {
        case.get("name"): [
            e.get("value") for e in case.iterfind(".//property[@name='requirement']")
        ]
        for case in root.iter("testcase")
    }
    assert stated == {
        "bad": ["REQ-2: ok", "REQ-2: ok", "REQ-2: missed", "REQ-3: missed"],
        "good": ["REQ-1: holds"],
    }
    names = {each.get("name") for each in root.iter("property")}
    assert {"criterion high enough above", "criterion too slow"} <= names
    page = (report / "report.html").read_text()
    places = [page.index(word) for word in ("What proves them", "REQ-1", "REQ-2", "REQ-3")]
    assert places == sorted(places)
