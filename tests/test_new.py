"""A new scenario runs at the first try, and what is wrong with one is explained."""

from dataclasses import replace

import pytest
from typer.testing import CliRunner

from panda_cosim import shipped_scenarios
from panda_cosim.cli.app import app
from panda_cosim.fmus.errors import InputError
from panda_cosim.run.execution import run_scenario
from panda_cosim.study.check.diagnosis import check_folder
from panda_cosim.study.sweep.definition import load_sweep
from panda_cosim.study.sweep.engine import check_sweep
from panda_cosim.task.scenario import Scenario
from panda_cosim.task.writer import make_scenario


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "mine" / "lift"
    make_scenario(made)
    return made


def test_a_new_scenario_runs_at_the_first_try(folder, tmp_path):
    run = run_scenario(folder, tmp_path / "run")
    assert run.summary.success, run.summary.criteria


def test_a_new_scenario_with_parts_of_its_own_runs_and_is_swept(tmp_path):
    runner = CliRunner()
    new = runner.invoke(app, ["new", str(tmp_path / "own"), "--law", "--plant", "--sweep"])
    assert new.exit_code == 0, new.output
    assert f"panda-cosim sweep {tmp_path / 'own'}/sweep.toml" in new.output
    run = run_scenario(tmp_path / "own", tmp_path / "run")
    assert run.summary.success, run.summary.criteria
    assert "plant.pillar_xpos[1]" in run.recording.columns
    _, design = check_sweep(load_sweep(tmp_path / "own" / "sweep.toml"))
    assert len(design) == 40


def test_check_suggests_no_torques_for_a_scene_with_servos(tmp_path):
    make_scenario(tmp_path / "own", ["plant"])
    assert [each.level for each in check_folder(tmp_path / "own")] == ["good", "good"]


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_copy_of_a_shipped_scenario_is_equal_to_it(name, tmp_path):
    make_scenario(tmp_path / "copy", copied=name)
    shipped = Scenario.read(shipped_scenarios()[name])
    same = replace(shipped, name="copy", folder=tmp_path / "copy")
    assert Scenario.read(tmp_path / "copy") == same
    assert not (tmp_path / "copy" / "reference.parquet").exists()


def test_what_cannot_be_copied_is_refused(tmp_path):
    for options, words in (
        (("--from", "pusch"), "did you mean 'push'"),
        (("--from", "push", "--law"), "--from: cannot be combined with --law, --plant or --slave"),
    ):
        refused = CliRunner().invoke(app, ["new", str(tmp_path / "copy"), *options])
        assert refused.exit_code == 2
        assert words in refused.output
        assert not (tmp_path / "copy").exists()


@pytest.mark.parametrize("name", ["-lift", "li/ft\n", "..", "x" * 201])
def test_a_bad_name_is_refused(tmp_path, name):
    with pytest.raises(InputError, match="scenario name"):
        make_scenario(tmp_path / name)


def test_nothing_is_written_over(folder):
    (folder / "trajectory.csv").unlink()
    with pytest.raises(InputError, match="already exists"):
        make_scenario(folder)
    assert not (folder / "trajectory.csv").exists()


def test_new_and_check_are_commands(tmp_path):
    runner = CliRunner()
    made = runner.invoke(app, ["new", str(tmp_path / "lift")])
    assert made.exit_code == 0
    assert "trajectory.csv" in made.output
    checked = runner.invoke(app, ["check", str(tmp_path / "lift")])
    assert checked.exit_code == 0
    order, lift = (" ".join(line.split()) for line in checked.output.splitlines())
    assert order.startswith("good FMUs are stepped in the order controller, plant; a step late: ")
    assert lift == (
        "good lift: 5 rows, 3.4 s; the grip holds 31.6 N by friction, 1.89 N needed; it can run"
    )
    assert runner.invoke(app, ["check", str(tmp_path / "lif")]).exit_code == 2


EDITS = [
    # file, what is there, what is put there, level, what is told
    ("scenario.toml", "block_mass", "block_mas", "wrong", "did you mean 'block_mass'"),
    ("scenario.toml", "block_mass = 0.18", "block_mass = 18", "wrong", "plant.block_mass"),
    ("scenario.toml", "0.4, -0.2", "0.65, 0.09", "wrong", "would start"),
    ("scenario.toml", "duration = 3.4", "duration = 3.4005", "wrong", "whole number of ticks"),
    ("scenario.toml", "duration = 3.4", "duration =", "wrong", "scenario.toml"),
    ("scenario.toml", "duration = 3.4", "duration = 2.5", "hint", "it is never reached"),
    ("scenario.toml", "Picks the block up and holds it", "", "hint", "purpose is empty"),
    ("trajectory.csv", "0.08\n1.2", "0,08\n1.2", "wrong", "line 2: 7 values; must be 6"),
    ("trajectory.csv", "1.7,target", "1.1,target", "wrong", "goes back"),
    (
        "trajectory.csv",
        "1.7,target,0.0",
        "1.7,target,1.0",
        "hint",
        "within the arm's reach",
    ),
    ("trajectory.csv", "0.085,0.0\n2", "-0.085,0.0\n2", "hint", "the path must avoid this"),
    ("trajectory.csv", "1.2,target", "0.1,target", "hint", "of joint"),
]


@pytest.mark.parametrize(("file", "before", "after", "level", "told"), EDITS)
def test_what_is_wrong_is_explained(folder, file, before, after, level, told):
    path = folder / file
    assert before in path.read_text()
    path.write_text(path.read_text().replace(before, after))
    diagnostics = check_folder(folder)
    assert any(f.level == level and told in f.text for f in diagnostics), diagnostics
    assert all("\n" not in f.text for f in diagnostics)


@pytest.mark.parametrize("name", [pytest.param("beyond_reach", marks=pytest.mark.long), "tutorial"])
def test_nothing_is_wrong_with_the_shipped_ones(name):
    diagnostics = check_folder(shipped_scenarios()[name])
    # They ask for what the arm cannot do, the tutorial by its law.
    order, *rest = sorted(diagnostics, key=lambda f: f.level)
    assert order.text.startswith("FMUs are stepped in the order controller, plant")
    assert {f.level for f in rest} == {"hint"}, diagnostics
