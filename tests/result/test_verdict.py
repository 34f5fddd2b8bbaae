"""A run comes to one verdict, whichever way one looks at it."""

import json
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import nullcontext, suppress
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st

from panda_cosim import InputError, Run, SimulationError, compare, load_scenario
from panda_cosim.cli import outcome as door
from panda_cosim.result.judging.summary import SUMMARY_FILE, Summary
from panda_cosim.result.judging.verdicts import INCOMPLETE, VERDICTS
from panda_cosim.result.view.facts import criteria_of, limits_of, refusals_of
from panda_cosim.result.view.run import Shown, describe
from panda_cosim.study.compare import outcome as outcomes
from panda_cosim.study.compare import regress
from panda_cosim.study.compare.junit import write_junit
from panda_cosim.study.compare.pytest_plugin import TestedRun
from panda_cosim.study.compare.reference import Reference
from panda_cosim.study.sweep.row import STATUSES, measured
from panda_cosim.task.tolerances import Tolerances
from regress_support import columns, record

SIGTERM = 15
# What the readers of each verdict rely on: exit code, status of a row, JUnit, whether it is good.
CONTRACT: dict[str, tuple[int, str, str | None, str]] = {
    "success": (0, "success", None, "good"),
    "failure, as expected": (0, "success", None, "good"),
    "no success criteria": (0, "success", None, "plain"),
    "missed": (3, "missed", "failure missed", "bad"),
    "unexpected success": (3, "unexpected", "failure missed", "bad"),
    "not measured": (3, "unmeasured", "error not measured", "bad"),
    "ended early": (3, "failed", "error ended early", "bad"),
    "timeout": (3, "timeout", "error ended early", "bad"),
    "stopped": (128 + SIGTERM, "failed", "error stopped", "bad"),
    "failed": (1, "failed", "error failed", "bad"),
}
assert list(CONTRACT) == [verdict.word for verdict in VERDICTS]
VALUES = {"ok": 0.5, "missed": 2.0, "not measured": None}


def expected_word(complete: bool, end: str, expect: str, outcomes: list[str]) -> str:
    """The precedence once more, in words."""
    if not complete:
        return end
    for outcome in ("missed", "not measured"):
        if outcome in outcomes:
            is_wanted = outcome == "missed" and expect == "failure"
            return "failure, as expected" if is_wanted else outcome
    if expect == "failure":
        return "unexpected success"
    return "success" if outcomes else "no success criteria"


def content(complete: bool, end: str, expect: str, outcomes: list[str]) -> dict[str, Any]:
    """The content of a summary.json."""
    criteria = [
        {"name": f"c{i}", "value": VALUES[each], "bound": 1.0, "unit": "m", "ok": each == "ok"}
        for i, each in enumerate(outcomes)
    ]
    return {
        "scenario": "made_up", "complete": complete, "reason": None if complete else "cut",
        "verdict": "" if complete else end, "expect": expect, "expect_reason": "too heavy",
        "criteria": criteria, "timing": {"simulated_s": 0.4},
    }  # fmt: skip


SUMMARIES = {
    word: content(word not in [v.word for v in INCOMPLETE], word, expect, outcomes)
    for word, expect, outcomes in [
        ("success", "success", ["ok", "ok"]),
        ("failure, as expected", "failure", ["not measured", "missed"]),
        ("no success criteria", "success", []),
        ("missed", "success", ["not measured", "missed", "ok"]),
        ("unexpected success", "failure", ["ok"]),
        ("not measured", "success", ["ok", "not measured"]),
        ("ended early", "success", ["ok"]),
        ("timeout", "success", []),
        ("stopped", "failure", ["missed"]),
        ("failed", "success", ["missed"]),
    ]
}


MODEL = {"nq": 1, "bodies": []}


class AtOnce:
    """Workers that work where they are asked."""

    def submit(self, judge: Callable[[Any], Any], scenario: Any, **_: Any) -> Future[Any]:
        """Return what is done at once."""
        future: Future[Any] = Future()
        future.set_result(judge(scenario))
        return future


def fault_in(junit: Path) -> str | None:
    """Problem and kind of the one case of a JUnit file."""
    (case,) = ET.parse(junit).iter("testcase")
    return next((f"{each.tag} {each.get('type')}" for each in case.iterfind("*[@type]")), None)


@given(
    st.booleans(),
    st.sampled_from([verdict.word for verdict in INCOMPLETE]),
    st.sampled_from(["success", "failure"]),
    st.lists(st.sampled_from(list(VALUES)), max_size=4),
)
def test_one_precedence_decides_and_a_summary_comes_back(complete, end, expect, outcomes):
    summary = Summary.read(content(complete, end, expect, outcomes))
    word = expected_word(complete, end, expect, outcomes)
    code, status, fault, level = CONTRACT[word]
    verdict = summary.verdict
    assert (verdict.word, verdict.level, verdict.status) == (word, level, status)
    assert verdict.exit_code == code - (SIGTERM if word == "stopped" else 0)
    assert (verdict.fault and " ".join(verdict.fault)) == fault
    assert summary.as_expected == (level != "bad") == (code == 0)
    assert summary.success == (complete and set(outcomes) <= {"ok"})
    assert Summary.read(json.loads(json.dumps(summary.to_dict()))) == summary


@pytest.mark.parametrize("word", SUMMARIES)
def test_every_door_says_the_same(word, tmp_path, capsys, monkeypatch):
    code, status, fault, level = CONTRACT[word]
    raw = SUMMARIES[word]
    summary, folder = Summary.read(raw), tmp_path / "made_up"
    record(folder, columns(), reason=raw["reason"])
    (folder / SUMMARY_FILE).write_text(json.dumps(raw))
    run = Run(folder, summary, SIGTERM if word == "stopped" else 0)

    # The command line, with its JUnit file.
    junit = tmp_path / "junit.xml"
    output = door.Output(None, video=False, plot=False, view=False, junit=junit, json=True)
    try:
        door.conclude(run, output, ours=True)
        left = 0
    except typer.Exit as end:
        left = end.exit_code
    printed = json.loads(capsys.readouterr().out)
    assert (left, printed["exit_code"], printed["summary"]["verdict"]) == (code, code, word)
    _, style = next(door.outcome_lines(summary, run.recording, realtime=False))
    assert style == {"good": "bold green", "plain": "bold", "bad": "bold red"}[level]
    assert fault_in(junit) == fault

    # The page and the notebook.
    shown = Shown("run", run.recording, MODEL, summary=Summary.of(run.recording))
    about = describe(shown, "model")["verdict"]
    assert (about["state"], about["words"].partition(":")[0]) == (level, word)
    assert f": {word}" in run._repr_html_()

    # `compare`, and a row of a sweep.
    compared = compare(folder, folder)
    assert compared.to_dict()["verdicts"] == [word, word]
    assert compared.unmet == (level == "bad")
    row = measured(run)["status"]
    assert row == status
    assert row in STATUSES

    # `regress` of a scenario without a reference, its JUnit file, and pytest.
    def run_scenario(*_: Any) -> Run:
        if word == "failed":
            raise SimulationError("cut")
        return run

    monkeypatch.setattr(regress, "run_scenario", run_scenario)
    scenario = replace(load_scenario("pick_and_place"), folder=tmp_path)
    outcome = regress.start(AtOnce(), scenario, folder).result()  # type: ignore[arg-type]
    assert outcome.ok == (level == "good")
    assert outcomes.exit_code([outcome]) == {"good": 0, "plain": 2, "bad": 1}[level]
    write_junit([outcome], junit)
    if level != "plain":  # `regress` must have something to judge by
        assert (fault_in(junit) or "").partition(" ")[0] == (fault or "").partition(" ")[0]
    with nullcontext() if level == "good" else pytest.raises(pytest.fail.Exception):
        TestedRun(outcome).assert_success()


def test_no_reference_is_made_of_a_bad_run(tmp_path):
    run = record(tmp_path, columns())
    for raw in SUMMARIES.values():
        summary = Summary.read(raw)
        is_bad = summary.verdict.level == "bad"
        with pytest.raises(InputError, match=summary.verdict.word) if is_bad else nullcontext():
            Reference.of(run, summary, Tolerances())


LOW = {"name": "min_lift", "value": 0.1, "bound": 0.2, "unit": "m"}


@pytest.mark.parametrize("number", [1, 2, 3])
def test_old_summaries_are_read(number):
    summary = Summary.read({"format": number, "success": False, "criteria": [LOW]})
    assert (summary.verdict.word, summary.margin) == ("missed", pytest.approx(-0.5))
    assert Summary.read({"complete": False, "reason": "cut"}).brief == "ended early: cut"


@pytest.mark.parametrize(("text", "told"), [
    ("{", "Expecting property name"),
    ("[]", ".*must be the content of a summary.json"),
    ('{"criteria": {"a": 1}}', "criteria: value .*; must be a list"),
    ('{"limits": [1]}', "limits: value .*; must be a table of values"),
    ('{"complete": 0}', "complete: value 0; must be true or false"),
])  # fmt: skip
def test_a_damaged_summary_is_refused_with_its_place(text, told, tmp_path):
    (tmp_path / SUMMARY_FILE).write_text(text)
    with pytest.raises(InputError, match=f"{SUMMARY_FILE}: cannot be read: {told}"):
        Summary.open(tmp_path)


WHOLE = SUMMARIES["missed"] | {
    "limits": {"torque_share": [0.5]}, "first_limit": None, "tracking": {"rms_mm": 1.0},
    "preflight": {
        "robot": "fer", "interface": "joint", "refusals": 1, "joint_jerk_share": [0.1],
        "late": {}, "joint_refusals": 1, "lost_packets": 1, "findings": [
            {"error": "e", "time_s": 0.1, "row": 1, "what": "jerk of joint", "joint": 1,
             "value": 1.0, "unit": "m", "bound": 1.0, "remedy": "r",
             "necessary": True, "interface": "joint"},
        ],
    },
}  # fmt: skip
JUNK = [None, 0, -1.5, 1e308, "x", True, [], [1], ["a"], [{}], {}, {"a": 1}]


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Each place in plain values, by keys and indices."""
    yield path
    inside = enumerate(value) if isinstance(value, list) else getattr(value, "items", tuple)()
    for key, item in inside:
        yield from places(item, (*path, key))


@given(st.sampled_from(list(places(WHOLE))[1:]), st.sampled_from(JUNK))
def test_what_is_damaged_is_refused_or_shown(place, junk):
    content = deepcopy(WHOLE)
    inner: Any = content
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = junk
    with suppress(InputError):
        summary = Summary.read(content)
        told = summary.headline, summary.brief, dict(summary.numbers()), summary.to_dict()
        shown = criteria_of(summary), limits_of(summary), refusals_of(summary)
        json.dumps([told[-1], shown], allow_nan=False)
