"""What the tests of sessions do, each in a process of its own; answers are plain JSON."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from panda_cosim import InputError, Options, Recording, Run, Session, replay, run_scenario
from parts_jobs import write_arm
from toy_fmu import toy_fmu

SHORT = 900  # ticks


def bits(folder: Path) -> bytes:
    """All rows of a recording, push forces left out, which plain runs need not have."""
    recording = Recording.open(folder)
    forces = ("plant.push_force", "plant.block_force")
    names = [n for n in recording.columns if not n.startswith(forces)]
    return np.vstack([recording[name] for name in names]).tobytes()


def act(session: Session) -> None:
    """Do everything that can be done."""
    session.set("controller.ik_gain", 12.0)
    session.step(100)
    session.set("controller.kp", 6)
    session.set("controller.kp[3]", 7.5)
    session.set("plant.push_force", (0, 5, 0))
    assert session.step(100) == 100
    session.release("plant.push_force")
    session.set("plant.block_force", (0.5, 0, 2))
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
    session.step(SHORT - session.tick)


def replayed(place: str) -> dict[str, object]:
    """A session with all kinds of actions, again from its journal."""
    folder = Path(place)
    with Session("pick_and_place", folder / "first") as session:
        act(session)
        parameters = session.parameters["controller"]
    again = replay(folder / "first", folder / "again")
    journals = [(folder / name / "session.jsonl").read_text() for name in ("first", "again")]
    plain = run_scenario("pick_and_place", folder / "plain")
    return {
        "same": bits(folder / "first") == bits(folder / "again"),
        "changed": not np.array_equal(
            Recording.open(folder / "first")["plant.qpos"],
            plain.recording["plant.qpos"][: SHORT + 1],
        ),
        "rows": Recording.open(folder / "again").rows,
        "journals": journals[0] == journals[1],
        "reason": again.summary.reason,
        "warnings": list(again.warnings),
        "kp": [parameters[f"kp[{i}]"] for i in range(1, 8)],
    }


def isolated(place: str) -> dict[str, object]:
    """The same with each FMU in a process of its own."""
    folder = Path(place)
    found = {}
    for name, options in {
        "plain": Options(),
        "isolated": Options(isolate=True),
    }.items():
        with Session("pick_and_place", folder / name, options) as session:
            act(session)
        found[name] = bits(folder / name)
    return {"same": found["plain"] == found["isolated"]}


def untouched(place: str) -> dict[str, object]:
    """A session in which nothing is done is the plain run; whatever the steps."""
    folder = Path(place)
    with Session("pick_and_place", folder / "session") as session:
        while session.step(777):
            assert session.state()["time"] == session.time == session.tick * 0.001
        done: Run = session.close()
    plain = run_scenario("pick_and_place", folder / "plain")
    return {
        "same": bits(folder / "session") == bits(plain.folder),
        "success": done.summary.success,
        "metrics": done.summary.tracking == plain.summary.tracking,
    }


def kept(place: str) -> dict[str, object]:
    """A session written as a scenario, which is run."""
    folder = Path(place)
    with Session("pick_and_place", folder / "session") as session:
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
        session.move_waypoint(len(session.table.rows) - 1, frame="world", position=(0.4, 0.1, 0.5))
        session.step(SHORT)
        session.keep(folder / "kept")
    run_scenario(folder / "kept", folder / "run")
    run, session = (Recording.open(folder / name) for name in ("run", "session"))
    forces = ("plant.push_force", "plant.block_force")
    return {
        "same": bits(folder / "session") == bits(folder / "run"),
        "pushes": all(bool((run[n][:-1] == session[n][:-1]).all()) for n in forces),
    }


def refused_as_scenario(place: str) -> dict[str, object]:
    """Why a session cannot be written as a scenario, for each kind of action."""
    folder = Path(place)
    actions: dict[str, Callable[[Session], None]] = {
        "parameter": lambda s: s.set("controller.kp", 6),
        "coupling": lambda s: s.set_coupling("jacobi"),
        "command": lambda s: s.set("controller.pos_cmd", (0.4, 0.0, 0.5)),
        "waypoint": lambda s: s.move_waypoint(1, position=(0.1, 0.0, 0.1)),
    }
    said = {}
    with Session("pick_and_place", folder / "start") as session:
        session.set("controller.base_ctrl", 0.1)
        session.set_coupling("jacobi")
        session.step(3)
        try:
            session.as_scenario()
        except InputError as error:
            said["start"] = str(error)
    for name, action in actions.items():
        with Session("pick_and_place", folder / name) as session:
            session.step(100)
            action(session)
            session.step(100)
            try:
                session.as_scenario()
            except InputError as error:
                said[name] = str(error)
    return said


def of_other_parts(place: str) -> dict[str, object]:
    """A session of an arm and a user's slave, replayed from its journal and as a scenario."""
    folder = Path(place)
    arm = write_arm(folder / "arm")
    with Session(arm, folder / "first") as session:
        tunable = sorted(session.tunables)
        session.set("controller.kp", 90.0)
        session.step(300)
        session.keep(folder / "kept")
        session.set("controller.kd", 4.0)
        session.finish()
    replay(folder / "first", folder / "again")
    run_scenario(folder / "kept", folder / "run")
    rows = {n: Recording.open(folder / n)["plant.qpos"] for n in ("first", "run")}
    return {
        "tunable": tunable,
        "same": bits(folder / "first") == bits(folder / "again"),
        "kept": bool((rows["run"] == rows["first"][:301]).all()),
    }


def inputs_of_a_system(place: str) -> dict[str, object]:
    """What nothing feeds is given from outside, at its start value until it is set."""
    folder = Path(place) / "toys"
    folder.mkdir()
    toy_fmu(folder / "toy.fmu", 2)
    (folder / "scenario.toml").write_text('duration = 0.03\n[fmus]\ntoy = "toy.fmu"\n')
    outputs = []
    with Session(folder, folder / "run") as session:
        for value in (5.0, None):
            session.set("toy.u[1,2]", value) if value else session.release("toy.u[1,2]")
            session.step(10)
            outputs.append(session.state()["toy.y[1,2]"])
        refused = ""
        try:
            session.move_waypoint(0, grip=0.0)
        except InputError as error:
            refused = str(error)
    return {"outputs": outputs, "refused": refused}


def refused(place: str) -> dict[str, object]:
    """Bad input changes nothing, and is not in the journal."""
    folder = Path(place)
    tries: dict[str, Callable[[Session], object]] = {
        "name": lambda s: s.set("controller.kpp", 6),
        "instance": lambda s: s.set("control.kp", 6),
        "bound": lambda s: s.set("controller.kp", -1e9),
        "fixed": lambda s: s.set("plant.block_mass", 0.2),
        "length": lambda s: s.set("plant.push_force", (1.0, 2.0)),
        "force": lambda s: s.set("plant.push_force", 1e9),
        "nan": lambda s: s.set("controller.pos_cmd", float("nan")),
        "release": lambda s: s.release("plant.push_force"),
        "over": lambda s: s.move_waypoint(0, grip=0.0),
        "row": lambda s: s.move_waypoint(99, grip=0.0),
        "key": lambda s: s.move_waypoint(5, grp=0.0),
        "grip": lambda s: s.move_waypoint(5, grip=3.0),
        "coupling": lambda s: s.set_coupling("gauss"),  # type: ignore[arg-type]
        "steps": lambda s: s.step(-1),
        "open": lambda s: s.open(),
    }
    said = {}
    with Session("pick_and_place", folder / "refused") as session:
        session.step(10)
        for name, attempt in tries.items():
            try:
                attempt(session)
            except InputError as error:
                said[name] = str(error)
        session.step(90)
        said["actions"] = str(len(session.actions))
    run_scenario("pick_and_place", folder / "plain")
    rows = {n: Recording.open(folder / n)["plant.qpos"][:101] for n in ("plain", "refused")}
    return {"said": said, "same": rows["plain"].tobytes() == rows["refused"].tobytes()}


def restarted(place: str) -> dict[str, object]:
    """A restart begins anew in another folder, with the start values."""
    folder = Path(place)
    session = Session("pick_and_place", folder / "run")
    with session:
        session.set("controller.kp", 4)
        session.step(300)
        session.restart()
        again: dict[str, object] = {
            "folder": session.folder.name,
            "tick": session.tick,
            "actions": len(session.actions),
        }
        kp = session.parameters["controller"]["kp[1]"]
        session.step(300)
    run_scenario("pick_and_place", folder / "plain")
    rows = {n: Recording.open(folder / n)["plant.qpos"][:301] for n in ("plain", "run-2")}
    return again | {
        "same": rows["plain"].tobytes() == rows["run-2"].tobytes(),
        "kp": kp,
        "first": Recording.open(folder / "run").rows,
    }


def damaged(place: str, lines: list[dict[str, object]]) -> list[str]:
    """What is said of a journal whose last line cannot be done, for each line; nothing is run."""
    folder = Path(place)
    with Session("pick_and_place", folder / "run"):
        pass
    journal = folder / "run" / "session.jsonl"
    head = journal.read_text().splitlines()[0]
    before = json.dumps({"tick": 2, "action": "set", "name": "controller.kp", "value": 6})
    said = []
    for line in lines:
        journal.write_text(f"{head}\n{before}\n{json.dumps(line)}\n")
        try:
            replay(folder / "run", folder / "again")
        except InputError as error:
            said.append(str(error))
        assert not (folder / "again").exists()
    return said
