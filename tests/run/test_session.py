"""Sessions: stepped from outside, journalled, and run again bit for bit."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bounded import line_of, running
from fmu_support import in_process
from forked import command
from panda_cosim import InputError, Options, Recording, Session, load_scenario, replay, run_scenario
from panda_cosim.fmus.interface.plant import FORCES
from panda_cosim.run.journal import Journal
from parts_jobs import session_of_other_parts
from refusals import refused
from toy_fmu import toy_fmu

HEAD = {"scenario": "pick_and_place", "kind": "native", "fmus": {}}
SCENARIO = replace(load_scenario("pick_and_place"), duration=1.4)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return run_scenario(SCENARIO, tmp_path_factory.mktemp("plain") / "run")


def bits(folder: Path, rows: int | None = None) -> bytes:
    """The first rows of a recording, push forces left out, which plain runs need not have."""
    recording = Recording.open(folder)
    forces = tuple(f"plant.{name}" for name in FORCES.values())
    names = [n for n in recording.columns if not n.startswith(forces)]
    return np.vstack([recording[name][:rows] for name in names]).tobytes()


def act(session: Session) -> None:
    """Do everything that can be done."""
    session.set("controller.ik_gain", 12.0)
    session.step(100)
    session.set("controller.kp", 6)
    session.set("controller.kp[3]", 7.5)
    session.set("plant.push_force", (0, 5, 0))
    assert session.step(100) == 100
    session.release("plant.push_force")
    session.set("plant.block_force", np.array([0.5, -0.0, 2]))
    session.set_coupling("jacobi")
    session.step(57)
    session.set("controller.pos_cmd[3]", 0.55)
    session.step(43)
    session.release("controller.pos_cmd")
    session.set_coupling("gauss-seidel")
    session.set("controller.use_reference", False)
    session.step(50)
    session.set("controller.use_reference", True)
    session.move_waypoint(2, position=(0.02, 0.05, 0.1))
    session.step(550)


def test_a_session_is_run_again_bit_for_bit_also_isolated(tmp_path, plain):
    with Session(SCENARIO, tmp_path / "first") as session:
        act(session)
        kp = session.parameters["controller"]
        assert [kp[f"kp[{i}]"] for i in range(1, 8)] == [6, 6, 7.5, 6, 6, 6, 6]
    again = replay(tmp_path / "first", tmp_path / "again", Options(isolate=True))
    assert again.recording.rows == 901
    assert bits(tmp_path / "first") == bits(tmp_path / "again") != bits(plain.folder, 901)
    journals = [(tmp_path / name / "session.jsonl").read_text() for name in ("first", "again")]
    assert journals[0] == journals[1]
    assert again.summary.reason == "the session was ended at t = 0.900 s"
    assert again.warnings == ()


def test_a_session_of_other_parts_is_run_again_and_kept(tmp_path):
    assert in_process(session_of_other_parts, str(tmp_path)) == {
        "same": True, "kept": True, "tunable": ["controller.kd", "controller.kp"],
    }  # fmt: skip


def test_inputs_of_a_system_are_set_from_outside(tmp_path):
    """What nothing feeds is given from outside, at its start value until it is set."""
    toy_fmu(tmp_path / "toy.fmu", 2)
    (tmp_path / "scenario.toml").write_text('duration = 0.03\n[fmus]\ntoy = "toy.fmu"\n')
    outputs = []
    with Session(tmp_path, tmp_path / "run") as session:
        for value in (5.0, None):
            session.set("toy.u[1,2]", value) if value else session.release("toy.u[1,2]")
            session.step(10)
            outputs.append(session.state()["toy.y[1,2]"])
        with pytest.raises(InputError, match="without a trajectory"):
            session.move_waypoint(0, grip=0.0)
    assert outputs == pytest.approx([5.01, 0.02])  # y = k u + t [N]


def test_a_session_in_which_nothing_is_done_is_the_plain_run(tmp_path, plain):
    with Session(SCENARIO, tmp_path / "run") as session:
        while session.step(777):
            assert session.state()["time"] == session.time == session.tick * 0.001
        run = session.close()
    assert bits(run.folder) == bits(plain.folder)
    assert run.summary.tracking == plain.summary.tracking
    assert run.summary.criteria == plain.summary.criteria


def test_a_session_of_pushes_start_values_and_waypoints_is_a_scenario(tmp_path):
    with Session(SCENARIO, tmp_path / "session") as session:
        for name, scalar in session.tunables.items():
            if scalar.variable.kind == "Real" and isinstance(scalar.start, float):
                session.set(name, 0.9 * scalar.start)
        session.step(250)
        session.set("plant.push_force", (0.0, 5.0, -1.0))
        session.step(100)
        session.set("plant.push_force[1]", 2.0)
        session.step(100)
        session.release("plant.push_force")
        session.set("plant.block_force[2]", 1.5)
        session.step(50)
        session.release("plant.block_force")
        session.set("plant.link4_force", (-9.0, 3.0, 1.0))
        session.step(50)
        session.release("plant.link4_force")
        session.move_waypoint(len(session.table.rows) - 1, frame="world", position=(0.4, 0.1, 0.5))
        session.step(500)
        session.keep(tmp_path / "kept")
    run = run_scenario(tmp_path / "kept", tmp_path / "run")
    assert bits(run.folder) == bits(tmp_path / "session")
    for name in ("plant.push_force", "plant.block_force", "plant.link4_force"):
        forces = Recording.open(tmp_path / "session")[name]
        assert (run.recording[name][:-1] == forces[:-1]).all()


SSV = """<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
version="1.0" name="p"><ssv:Parameters><ssv:Parameter name="plant.block_mass"><ssv:Real value="{}"/>
</ssv:Parameter></ssv:Parameters></ssv:ParameterSet>"""


def test_a_parameter_set_of_ssp_gives_what_no_key_does(tmp_path):
    good, bad = tmp_path / "good.ssv", tmp_path / "bad.ssv"
    good.write_text(SSV.format(0.3))
    bad.write_text(SSV.format(99))
    for values, mass in (({}, 0.3), ({"plant.block_mass": 0.2}, 0.2)):
        session = Session("push", tmp_path / "run", values=values, ssv=good)
        assert session.scenario.plant["block_mass"] == mass
    assert "0 of 1 scenarios match" in command("regress", "push", "--ssv", good, code=1).stdout
    wrong = "plant.block_mass: value 99"
    assert wrong in command("check", load_scenario("push").folder, "--ssv", bad, code=2).stdout


ACTIONS: dict[str, Callable[[Session], None]] = {
    "controller.kp was set at t = 0.100 s": lambda s: s.set("controller.kp", 6),
    "the coupling was changed at t = 0.100 s": lambda s: s.set_coupling("jacobi"),
    "from t = 0.100 s on, no table .*: they were held": (
        lambda s: s.set("controller.pos_cmd", (0.4, 0.0, 0.5))
    ),
    ".* or a waypoint was moved when the hand": (
        lambda s: s.move_waypoint(1, position=(0.1, 0.0, 0.1))
    ),
}


def test_what_no_scenario_can_say_is_named(tmp_path):
    with Session(SCENARIO, tmp_path / "run") as session:
        session.set("controller.base_ctrl", 0.1)
        session.set_coupling("jacobi")
        session.step(3)
        with pytest.raises(InputError, match="with Jacobi coupling acts a tick later than a start"):
            session.as_scenario()
        for message, action in ACTIONS.items():
            session.restart()
            session.step(100)
            action(session)
            session.step(100)
            with pytest.raises(InputError, match=message):
                session.as_scenario()


REFUSED: dict[str, Callable[[Session], object]] = {
    "controller.kpp: no such parameter": lambda s: s.set("controller.kpp", 6),
    "no FMU 'control'": lambda s: s.set("control.kp", 6),
    "must be a number from": lambda s: s.set("controller.kp", -1e9),
    "plant.block_mass: is a fixed parameter": lambda s: s.set("plant.block_mass", 0.2),
    "plant.push_force: value of 2 items; must be 3 numbers": (
        lambda s: s.set("plant.push_force", (1.0, 2.0))
    ),
    "must be a number from -1000 to 1000 N": lambda s: s.set("plant.push_force", 1e9),
    "must be a finite number": lambda s: s.set("controller.pos_cmd", float("nan")),
    "plant.push_force: is not held": lambda s: s.release("plant.push_force"),
    "row 0: time 0 s has passed; must be after t = 0.01 s": lambda s: s.move_waypoint(0, grip=0.0),
    "row: value 99; must be a whole number from 0 to": lambda s: s.move_waypoint(99, grip=0.0),
    "row 5: key 'grp' is unknown": lambda s: s.move_waypoint(5, grp=0.0),
    "must be one of gauss-seidel, jacobi": lambda s: s.set_coupling("gauss"),  # type: ignore[arg-type]
    "step: -1 steps": lambda s: s.step(-1),
    "is already open": lambda s: s.open(),
}


def test_bad_input_is_refused_in_one_line_and_changes_nothing(tmp_path, plain):
    with Session(SCENARIO, tmp_path / "run") as session:
        session.step(10)
        for message, attempt in REFUSED.items():
            assert message in refused(attempt, session)
        session.step(90)
        assert session.actions == []
    assert bits(tmp_path / "run") == bits(plain.folder, 101)


def test_a_restart_begins_anew_in_another_folder(tmp_path, plain):
    with Session(SCENARIO, tmp_path / "run") as session:
        session.set("controller.kp", 4)
        session.step(300)
        session.restart()
        assert (session.folder.name, session.tick, session.actions) == ("run-2", 0, [])
        assert session.parameters["controller"]["kp[1]"] != 4
        session.step(300)
    assert bits(tmp_path / "run-2") == bits(plain.folder, 301) != bits(tmp_path / "run")


SCRIPT = """
import sys, time
from dataclasses import replace
from panda_cosim import Session, load_scenario
with Session(replace(load_scenario("pick_and_place"), duration=1.4), sys.argv[1]) as session:
    session.step(200)
    session.set("controller.kp", 6)
    session.step(800)
    time.sleep(0.4)
    session.step(200)
    print("ready", flush=True)
    while True:
        session.step(1) if session.tick < 1300 else time.sleep(0.01)
"""


def end_script(out: Path, number: int) -> None:
    """Run the script, and send it a signal once it is ready."""
    command = [sys.executable, "-c", SCRIPT, str(out)]
    with running(command, stdout=-1, stderr=subprocess.DEVNULL, text=True) as process:
        assert line_of(process) == "ready\n"
        time.sleep(0.2)
        process.send_signal(number)
        assert process.wait(timeout=60) != 0


@pytest.mark.parametrize("reason", ["ValueError: no more", "KeyboardInterrupt"])
def test_whatever_ends_the_block_the_run_is_kept(tmp_path, reason):
    if reason == "KeyboardInterrupt":
        end_script(tmp_path / "run", signal.SIGINT)
    else:
        with pytest.raises(ValueError, match="no more"), Session(SCENARIO, tmp_path / "run"):
            raise ValueError("no more")
    recording = Recording.open(tmp_path / "run")
    assert recording.path.name == "recording.parquet"
    assert not recording.complete
    assert recording.reason == reason
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["reason"] == reason
    assert Journal.read(tmp_path / "run").actions[-1].act.do == "end"


def test_a_killed_session_is_run_again_to_the_end(tmp_path):
    end_script(tmp_path / "run", signal.SIGKILL)
    again = tmp_path / "again"
    command("replay", tmp_path / "run", "--no-video", "--no-view", "--out", again, code=3)
    killed, whole = Recording.open(tmp_path / "run"), Recording.open(again)
    assert whole.complete
    assert 1000 <= killed.rows < whole.rows
    for name in ("plant.qpos", "controller.ctrl"):
        assert killed[name].tobytes() == whole[name][: killed.rows].tobytes()


@pytest.mark.parametrize(("lines", "message"), [
    ([], "line 1: format: Field required"),
    (['{"format": 2, "scenario": "x", "kind": "native"}'], "line 1: format: Input should be 1"),
    (["[1]"], "line 1: Input should be an object"),
    ([None, "{"], "line 2: Invalid JSON"),
    ([None, '{"tick": -1, "action": "end"}'], "line 2: tick: value -1; must be a whole"),
    ([None, '{"tick": 5}'], "action: value None; must be one of set"),
    ([None, '{"tick": 5, "action": "set", "name": 7}'], "2: set: name: Input should be a"),
    ([None, '{"tick": 5, "action": "end"}', '{"tick": 4}'], "line 3: tick: value 4; .* from 5"),
])  # fmt: skip
def test_a_damaged_journal_is_refused_with_its_line(tmp_path, lines, message):
    path = tmp_path / "session.jsonl"
    head = json.dumps({"format": 1, **HEAD})
    path.write_text("".join(f"{head if line is None else line}\n" for line in lines) or "{}\n")
    with pytest.raises(InputError, match=message):
        Journal.read(tmp_path)


SET = {"action": "set", "name": "plant.push_force"}
UNDOABLE = {  # the journal's third line, and what is said of it
    "action: value 'jump'; must be one of set, release": {"action": "jump"},
    "set: value: Field required": SET,
    "tick: value 1000000000; must be a whole number from 2 to ": {"tick": 10**9, "action": "end"},
    "push_force: value 'x'; must be a number": SET | {"value": "x"},
    "coupling: value [1]; must be one of": {"action": "set_coupling", "coupling": [1]},
    "row 0: time 0 s has passed": {"action": "move_waypoint", "row": 0},
    "end: reason: Input should be a valid string": {"action": "end", "reason": [1]},
    "end: why: Extra inputs are not permitted": {"action": "end", "why": 1},
}


def test_an_action_that_cannot_be_done_is_named_by_its_line_before_the_run(tmp_path):
    with Session(SCENARIO, tmp_path / "run"):
        pass
    journal = tmp_path / "run" / "session.jsonl"
    head = journal.read_text().splitlines()[0]
    before = json.dumps({"tick": 2, "action": "set", "name": "controller.kp", "value": 6})
    for message, action in UNDOABLE.items():
        journal.write_text(f"{head}\n{before}\n{json.dumps({'tick': 3, **action})}\n")
        said = refused(replay, tmp_path / "run", tmp_path / "again")
        assert message in said
        assert f"{journal}: line 3: " in said
        assert not (tmp_path / "again").exists()
