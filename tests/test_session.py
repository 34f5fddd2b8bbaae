"""Sessions: stepped from outside, journalled, and run again bit for bit."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import session_jobs
from bounded import line_of
from fmu_support import in_process
from forked import command
from panda_cosim import InputError, Recording, Session
from panda_cosim.scenarios.run.journal import Action, Journal, JournalWriter

pytestmark = pytest.mark.fmu
HEAD = {"scenario": "pick_and_place", "kind": "native", "fmus": {}}


def job(name: str, folder: Path) -> Any:
    return in_process(getattr(session_jobs, name), str(folder))


def test_a_session_is_run_again_bit_for_bit(tmp_path: Path) -> None:
    found = job("replayed", tmp_path)
    assert found["same"]
    assert found["changed"], "the actions acted"
    assert found["rows"] == 901
    assert found["journals"], "a session that is run again writes the same journal"
    assert found["reason"] == "the session was ended at t = 0.900 s"
    assert found["warnings"] == []
    assert found["kp"] == [6, 6, 7.5, 6, 6, 6, 6]


def test_isolated_fmus_give_the_same_session(tmp_path: Path) -> None:
    assert job("isolated", tmp_path)["same"]


def test_a_session_of_other_parts_is_run_again_and_kept(tmp_path: Path) -> None:
    found = in_process(session_jobs.of_other_parts, str(tmp_path))
    assert found["same"]
    assert found["kept"]
    assert found["tunable"] == ["controller.kd", "controller.kp"]


def test_inputs_of_a_system_are_set_from_outside(tmp_path: Path) -> None:
    found = in_process(session_jobs.inputs_of_a_system, str(tmp_path))
    assert found["outputs"] == pytest.approx([5.01, 0.02])  # y = k u + t [N]
    assert "without a trajectory" in found["refused"]


def test_a_session_in_which_nothing_is_done_is_the_plain_run(tmp_path: Path) -> None:
    assert job("untouched", tmp_path) == {"same": True, "success": True, "metrics": True}


def test_a_session_of_pushes_start_values_and_waypoints_is_a_scenario(tmp_path: Path) -> None:
    assert job("kept", tmp_path) == {"same": True, "pushes": True}


def test_what_no_scenario_can_say_is_named(tmp_path: Path) -> None:
    said = job("refused_as_scenario", tmp_path)
    assert "with Jacobi coupling acts a tick later than a start value" in said["start"]
    assert "controller.kp was set at t = 0.100 s" in said["parameter"]
    assert "the coupling was changed at t = 0.100 s" in said["coupling"]
    assert "controller.pos_cmd was held from t = 0.100 s on" in said["command"]
    assert "waypoint 1 was moved at t = 0.100 s, when the hand was on its way" in said["waypoint"]


def test_bad_input_is_refused_in_one_line_and_changes_nothing(tmp_path: Path) -> None:
    found = job("refused", tmp_path)
    said = found["said"]
    assert found["same"]
    assert said.pop("actions") == "0"
    expected = {
        "name": "controller.kpp: no such parameter",
        "instance": "control.kp: no instance 'control'",
        "bound": "must be between",
        "fixed": "plant.block_mass: is a fixed parameter",
        "length": "plant.push_force: value of 2 items; must be 3 numbers",
        "force": "must be a number from -1000 to 1000 N",
        "nan": "must be a finite number m",
        "release": "plant.push_force: is not held",
        "over": "move_waypoint: row 0: time 0 s has passed; must be after t = 0.01 s",
        "row": "move_waypoint: row 99; must be a whole number from 0 to",
        "key": "move_waypoint: 'grp'",
        "grip": "move_waypoint: row 5: grip: value 3.0",
        "coupling": "valid: gauss-seidel, jacobi",
        "steps": "step: -1 steps",
        "open": "is already open",
    }
    assert said.keys() == expected.keys()
    for name, message in expected.items():
        assert message in said[name]
        assert "\n" not in said[name]


def test_a_session_that_was_never_opened_says_so(tmp_path: Path) -> None:
    session = Session("push", tmp_path / "run")
    asked = {
        "tick": lambda: session.tick,
        "time": lambda: session.time,
        "coupling": lambda: session.coupling,
        "scenario": session.as_scenario,
        "keep": lambda: session.keep(tmp_path / "kept"),
    }
    for ask in asked.values():
        with pytest.raises(InputError, match="session: is not open"):
            ask()


def test_a_restart_begins_anew_in_another_folder(tmp_path: Path) -> None:
    found = job("restarted", tmp_path)
    assert found.pop("kp") != 4
    assert found == {"folder": "run-2", "tick": 0, "actions": 0, "same": True, "first": 301}


SCRIPT = """
import sys, time
from panda_cosim import Session
with Session("pick_and_place", sys.argv[1]) as session:
    session.step(200)
    session.set("controller.kp", 6)
    session.step(800)
    time.sleep(0.4)
    session.step(200)
    print("ready", flush=True)
    if sys.argv[2] == "raise":
        raise ValueError("no more")
    while True:
        session.step(1) if session.tick < 2000 else time.sleep(0.01)
"""


def run_script(out: Path, what: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(out), what], stdout=subprocess.PIPE, text=True,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    assert line_of(process) == "ready\n"
    return process


@pytest.mark.parametrize("what", ["raise", "interrupt"])
def test_whatever_ends_the_block_the_run_is_kept(tmp_path: Path, what: str) -> None:
    process = run_script(tmp_path / "run", what)
    if what == "interrupt":
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) != 0
    recording = Recording.open(tmp_path / "run")
    assert recording.path.name == "recording.parquet"
    assert not recording.complete
    reason = "ValueError: no more" if what == "raise" else "KeyboardInterrupt"
    assert recording.reason == reason
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["reason"] == reason
    assert Journal.read(tmp_path / "run").actions[-1].name == "end"


def test_a_killed_session_is_run_again_to_the_end(tmp_path: Path) -> None:
    process = run_script(tmp_path / "run", "wait")
    os.kill(process.pid, signal.SIGKILL)
    process.wait(timeout=60)
    again = tmp_path / "again"
    done = command("replay", tmp_path / "run", "--no-video", "--no-view", "--out", again)
    assert done.returncode == 0, done.stderr
    killed, whole = Recording.open(tmp_path / "run"), Recording.open(again)
    assert whole.complete
    assert 1000 <= killed.rows < whole.rows
    for name in ("plant.qpos", "controller.ctrl"):
        assert killed[name].tobytes() == whole[name][: killed.rows].tobytes()


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "format None; must be 1"),
        (['{"format": 2}'], "line 1: format 2; must be 1"),
        (['{"format": 1, "scenario": "x", "kind": "native"}'], "line 1: fmus"),
        ([json.dumps({"format": 1, **HEAD, "kind": "fast"})], "must be one of native, python"),
        (["[1]"], "line 1: '\\[1\\]'; must be a JSON object"),
        ([None, "{"], "line 2: '{'; must be a JSON object"),
        ([None, '{"tick": -1, "action": "end"}'], "line 2: tick -1; must be a whole number from 0"),
        ([None, '{"tick": true, "action": "end"}'], "line 2: tick True"),
        ([None, '{"tick": 5}'], "line 2: action None; must be a name"),
        ([None, '{"tick": 5, "action": "set", "name": 7}'], "line 2: name 7; must be that of"),
        ([None, '{"tick": 5, "action": "end"}', '{"tick": 4, "action": "set"}'], "line 3: tick 4"),
        ([None, '{"tick": 5, "action": "end"}', '{"tick": 5, "action": "set"}'], "after the end"),
    ],
)
def test_a_damaged_journal_is_refused_with_its_line(
    tmp_path: Path, lines: list[str | None], message: str
) -> None:
    path = tmp_path / "session.jsonl"
    head = json.dumps({"format": 1, **HEAD})
    path.write_text("".join(f"{head if line is None else line}\n" for line in lines) or "{}\n")
    with pytest.raises(InputError, match=message):
        Journal.read(tmp_path)


def test_a_journal_is_read_as_it_was_written(tmp_path: Path) -> None:
    actions = (Action(0, "set", {"name": "controller.kp", "value": 0.1}), Action(7, "end", {}))
    writer = JournalWriter(tmp_path / "session.jsonl", HEAD)
    for action in actions:
        writer.append(action)
    journal = Journal.read(tmp_path / "session.jsonl")
    assert journal.actions == actions
    assert journal.head == {"format": 1, **HEAD}
    with pytest.raises(InputError, match="cannot be written to"):
        JournalWriter(tmp_path / "session.jsonl", HEAD)


def test_a_journal_stays_where_it_is_if_an_fmu_changes_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    writer = JournalWriter(Path("session.jsonl"), HEAD)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    writer.append(Action(0, "end", {}))
    assert Journal.read(tmp_path / "session.jsonl").actions == (Action(0, "end", {}),)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["tutorial"], "Got unexpected extra argument(s) (tutorial)"),
        (["--set", "controller.kp=6"], "No such option: --set"),
        (["--kind", "python"], "No such option: --kind"),
        ([], "session.jsonl: there is no such file"),
    ],
)
def test_what_does_not_go_with_a_session_is_bad_input(
    tmp_path: Path, arguments: list[str], message: str
) -> None:
    done = command("run", "--session", tmp_path, *arguments)
    assert done.returncode == 2
    assert message in " ".join(done.stderr.split())


UNDOABLE = {  # the journal's third line, and what is said of it
    "action 'jump'; valid: set, release": {"action": "jump"},
    "set: value is missing": {"action": "set", "name": "controller.kp"},
    "tick 1000000000; must be at most": {"tick": 10**9, "action": "end"},
    "plant.push_force: value 'x'": {"action": "set", "name": "plant.push_force", "value": "x"},
    "must be between 0 and": {"action": "set", "name": "controller.kp", "value": -1},
    "is a fixed parameter": {"action": "set", "name": "plant.block_mass", "value": 0.2},
    "plant.push_force: is not held": {"action": "release", "name": "plant.push_force"},
    "coupling: [1]; valid": {"action": "set_coupling", "coupling": [1]},
    "row 0: time 0 s has passed": {"action": "move_waypoint", "row": 0},
    "end: reason [1]; must be text": {"action": "end", "reason": [1]},
    "end: 'why'; must be as": {"action": "end", "why": 1},
}


def test_an_action_that_cannot_be_done_is_named_by_its_line_before_the_run(
    tmp_path: Path,
) -> None:
    lines = [{"tick": 3, **line} for line in UNDOABLE.values()]
    said = in_process(session_jobs.damaged, str(tmp_path), lines)
    for message, line in zip(UNDOABLE, said, strict=True):
        assert "session.jsonl: line 3: " in line
        assert message in line
        assert "\n" not in line
