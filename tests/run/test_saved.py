"""A session returns to what it saved, bit for bit, and its recording and journal with it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from fmu_support import in_process, needs_compiler, needs_reference_fmus
from panda_cosim import Options, Recording, Session, Success, load_scenario, replay
from panda_cosim.result.recording import storage
from panda_cosim.run.journal import Release, Set, SetCoupling
from parts_jobs import discrete_inputs
from refusals import refused
from toy_fmu import toy_fmu

PUSH = replace(load_scenario("push"), duration=0.3, success=Success())
PUSHED = "plant.push_force"
ACTS = [
    *(Set(name="controller.kp", value=gain) for gain in (4.0, 8.0)),
    Set(name=PUSHED, value=(0.0, 5.0, 0.0)),
    Release(name=PUSHED),
    *(SetCoupling(coupling=coupling) for coupling in ("jacobi", "gauss-seidel")),
]
STEPS, SAVES = st.integers(0, 40), st.sampled_from([("save", 0), ("restore", 0), ("restore", 1)])


def do(session: Session, action: Any) -> None:
    """Take some steps, or one action on a session."""
    if isinstance(action, int):
        session.step(action)
    elif session.held or not isinstance(action, Release):
        session.act(action)


def bits(folder: Path) -> tuple[str, str]:
    """Return the digest of a session's recording, and its journal."""
    return Recording.open(folder).sha256(), (folder / "session.jsonl").read_text()


@example([("save", 0), 5, ("save", 0), ("restore", 0), 9, ("restore", 0)])
@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.one_of(STEPS, st.sampled_from(ACTS), SAVES), max_size=12))
def test_what_is_left_is_a_session_in_which_nothing_else_happened(tmp_path_factory, actions):
    folder = tmp_path_factory.mktemp("sessions")
    left, saved = [], []
    with Session(PUSH, folder / "back") as session:
        for action in actions:
            if action == ("save", 0):
                saved.append((session.save(), [*left]))
            elif not isinstance(action, tuple):
                do(session, action)
                left.append(action)
            elif action[1] < len(saved):
                (*saved, (state, before)), dropped = saved[: action[1] + 1], saved[action[1] + 1 :]
                session.restore(state)
                saved.append((state, before))
                left = [*before]
                for later, _ in dropped:
                    assert "dropped by a restore" in refused(session.restore, later)
    with Session(PUSH, folder / "straight") as session:
        for action in left:
            do(session, action)
    assert bits(folder / "back") == bits(folder / "straight")


@pytest.mark.parametrize(
    ("scenario", "ticks", "isolate"),
    [
        ("slow_controller", 400, False),
        ("elastic", 200, True),
        pytest.param("calibrated_guarded", 6600, False, marks=pytest.mark.long),
    ],
)
def test_scenarios_go_on_as_if_they_had_not_gone_back(tmp_path, scenario, ticks, isolate):
    options = Options(isolate=isolate)
    with Session(scenario, tmp_path / "back", options) as session:
        session.step(101)
        first = session.save()
        session.step(ticks // 2)
        second, here = session.save(), session.row()
        session.step(ticks // 2)
        ahead = session.row()
        session.restore(second)
        assert session.row().tobytes() == here.tobytes()
        session.step(ticks // 2)
        assert session.row().tobytes() == ahead.tobytes()
        session.restore(first)
        session.step(ticks)
    with Session(scenario, tmp_path / "straight", options) as session:
        session.step(101 + ticks)
    assert bits(tmp_path / "back") == bits(tmp_path / "straight")
    again = replay(tmp_path / "back", tmp_path / "again")
    assert again.recording.sha256() == bits(tmp_path / "back")[0]


def test_a_long_recording_goes_back_in_its_file(tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "BLOCK_ROWS", 100)
    with Session(PUSH, tmp_path / "back") as session:
        session.step(110)  # more than memory holds
        saved = session.save()
        session.step(110)
        session.restore(saved)
        session.step(10)
    recording = Recording.open(tmp_path / "back")
    assert recording.time == pytest.approx(np.arange(121) * 0.001)


def test_states_that_cannot_be_saved_are_refused_and_the_run_goes_on(tmp_path):
    law = "class Law:\n    def update(self, time, qpos):\n        self.it = iter([])\n"
    (tmp_path / "law.py").write_text(law + "        return [*qpos[:7], 255.0]\n")
    values = {"fmus.controller": f"{tmp_path / 'law.py'}:Law"}
    with Session(PUSH, tmp_path / "law", values=values) as session:
        session.step(2)
        assert "self.it holds a list_iterator; must be numbers" in refused(session.save)
        assert session.step(100) == 100
    with Session(PUSH, tmp_path / "a") as one, Session(PUSH, tmp_path / "b") as other:
        assert "was saved in another run" in refused(other.restore, one.save())


@needs_compiler
def test_an_fmu_without_states_is_named(tmp_path):
    toy_fmu(tmp_path / "toy.fmu", 2)
    (tmp_path / "scenario.toml").write_text('duration = 0.03\n[fmus]\ntoy = "toy.fmu"\n')
    with Session(tmp_path, tmp_path / "run") as session:
        assert "toy cannot restore its state; its FMU must have can" in refused(session.save)


@needs_reference_fmus
def test_discrete_inputs_of_an_fmu_with_events_go_back(tmp_path):
    assert in_process(discrete_inputs, str(tmp_path)) == [1.0, 2.0]
