"""Bad keys of parts, systems, verdicts and expectations: one line, exit 2, no files."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from panda_cosim.scenarios.cli.app import app
from typer.testing import CliRunner

TABLE = "time,frame,x,y,z,grip\n0,home,0,0,0,0.08\n1,home,0,0,0.01,0.08\n"
SLOW = [HealthCheck.function_scoped_fixture]
TOP = "duration = 1.0\n"
SIGNAL = TOP + '[[success.signal]]\nsignal = "plant.qvel"\nreduce = "peak"\nbelow = 1.0\n'
# What scenario.toml says, whether there is a trajectory, and what the message has to say.
CASES = [
    ('system = "no.ssp"\n', False, "no.ssp"),
    ("system = 3\n", False, "must be one line"),
    ('system = "a.txt"\n', False, "a.txt"),
    ('system = "."\n', False, "not a regular file"),
    ('system = "a.ssp"\n[fmus]\nplant = "x.fmu"\n', False, "cannot be combined with [fmus]"),
    ("step = 0.01\n", True, "step"),
    ('system = "a.ssp"\nstep = 0\n', False, "step"),
    ('system = "a.ssp"\nstep = "1 ms"\n', False, "step"),
    ('expect = "fail"\n', True, "expect"),
    ('expect = "failure"\n', True, "expect_reason"),
    ('expect_reason = "so"\n', True, "expect_reason"),
    ('expect = "failure"\nexpect_reason = 1\n', True, "expect_reason"),
    ('fmus = "x.fmu"\n', True, "fmus"),
    ("[fmus]\nplant = 1\n", True, "plant"),
    ('[fmus]\nplant = ""\n', True, "[fmus] plant"),
    ('[fmus]\nplant = "x.fmu"\n', True, "no such file"),
    ('[fmus]\ncontroller = "law.py:"\n', True, "[fmus] controller"),
    ('[fmus]\n"a b" = "x.fmu"\n', True, "a name of letters"),
    ('[fmus]\nplant = { file = "x.fmu" }\n', True, "plant"),
    ('[connect]\n"plant.ctrl" = 3\n', True, "connect"),
    ('connect = "x"\n', True, "connect"),
    ('[connect]\n"plant.ctrl" = "controller.qpos_ref"\n', True, "must have the same shape"),
    ('[connect]\n"plant.ctrl" = "controller.ctl"\n', True, "did you mean 'ctrl'"),
    ("[parameters]\nmotor = 3\n", True, "parameters"),
    ("[parameters.motor]\nk = 3.0\n", True, "motor"),
    ("[success]\nsignal = 3\n", True, "signal"),
    ("[[success.signal]]\n", True, "signal"),
    (SIGNAL.removeprefix(TOP).replace("plant.qvel", "plant.qvell"), True, "not recorded"),
    (SIGNAL.removeprefix(TOP).replace('"plant.qvel"', '["plant.qvel"]'), True, "signal"),
    (SIGNAL.removeprefix(TOP).replace('"plant.qvel"', '{ nrm = ["plant.qvel"] }'), True, "norm"),
    (SIGNAL.removeprefix(TOP).replace("peak", "peek"), True, "did you mean 'peak'"),
    (SIGNAL.removeprefix(TOP).replace("below = 1.0", ""), True, "below"),
    (SIGNAL.removeprefix(TOP).replace("1.0", '"1"'), True, "below"),
    (SIGNAL.removeprefix(TOP).replace("1.0", "nan"), True, "below"),
    (SIGNAL.removeprefix(TOP) + 'from = "graps"\n', True, "grasp"),
    (SIGNAL.removeprefix(TOP) + "from = 0.9\nto = 0.1\n", True, "from"),
    (SIGNAL.removeprefix(TOP) + "band = 1.0\n", True, "band"),
    (SIGNAL.removeprefix(TOP).replace("peak", "settle"), True, "band"),
    (SIGNAL.removeprefix(TOP).replace("peak", "duration_above"), True, "level"),
    (SIGNAL.removeprefix(TOP) + "color = 1\n", True, "color"),
    (SIGNAL.removeprefix(TOP) + SIGNAL.removeprefix(TOP), True, "is taken; must be unique"),
]


def refused(folder: Path, text: str, table: bool) -> str:
    """Write a scenario, run it; returns the one line that refuses it."""
    made = folder / "mine"
    made.mkdir(exist_ok=True)
    (made / "scenario.toml").write_text(text, encoding="utf-8")
    if table:
        (made / "trajectory.csv").write_text(TABLE)
    done = CliRunner().invoke(app, ["run", str(made), "--no-video", "--out", str(folder / "run")])
    lines = [line for line in done.output.splitlines() if line]
    assert done.exit_code == 2, done.output
    assert not (folder / "run").exists()
    assert len(lines) == 1, done.output
    assert lines[0].startswith("Error: ")
    return lines[0]


@pytest.mark.parametrize(("text", "table", "said"), CASES, ids=[c[0][:40] for c in CASES])
def test_a_bad_key_is_refused_in_one_line(
    tmp_path: Path, text: str, table: bool, said: str
) -> None:
    line = refused(tmp_path, TOP + text, table)
    assert str(tmp_path / "mine") in line
    assert said in line


ANY = st.sampled_from(
    ["0", "-1", "nan", "inf", "1e400", "true", '""', '"\\n"', '"x.fmu"', "[]", "[[1]]", "{}",
     "{ a = 1 }", "1979-05-27", '"' + "x" * 300 + '"', '["a"]']
)  # fmt: skip
KEYS = st.sampled_from(
    ["system", "step", "expect", "expect_reason", "fmus", "fmus.plant", "connect", "parameters",
     'connect."plant.ctrl"', "parameters.plant", "success", "success.signal", "success.max_slip"]
)  # fmt: skip


@settings(max_examples=60, deadline=None, suppress_health_check=SLOW)
@given(key=KEYS, value=ANY)
def test_any_value_of_a_new_key_is_used_or_refused(tmp_path: Path, key: str, value: str) -> None:
    made = tmp_path / "mine"
    made.mkdir(exist_ok=True)
    (made / "scenario.toml").write_text(f"{TOP}{key} = {value}\n")
    (made / "trajectory.csv").write_text(TABLE)
    done = CliRunner().invoke(app, ["check", str(made)])
    assert done.exit_code in (0, 2), done.output
    assert "Traceback" not in done.output
    assert "unexpected" not in done.output
