"""The command line: messages, files and exit codes."""

import json
import re
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from bounded import ran
from fault_support import write_files
from forked import command as forked
from panda_cosim import InputError, Recording, shipped_scenarios
from panda_cosim.cli.app import app, load
from panda_cosim.cli.commands import COMMANDS, RULES
from panda_cosim.cli.console import progress
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.fmus.sources.targets import build


def call(*arguments: object) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def scenario(tmp_path):
    return make_scenario(tmp_path / "small")


def make_scenario(folder: Path) -> Path:
    """Write a scenario in which the hand goes up a little."""
    settings = "duration = 0.2\n[success]\ntracking_max = 0.01\n"
    return write_files(folder, settings, "0,home,0,0,0,0.08", "0.2,home,0,0,0.002,0.08")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run's folder, for commands that start from one."""
    folder = tmp_path_factory.mktemp("finished")
    small = make_scenario(folder / "small")
    done = forked("run", small, "--no-video", "--json", "--out", folder / "run", code=0)
    printed = json.loads(done.stdout)
    assert printed["folder"] == str(folder / "run")
    assert printed["files"] == ["recording.parquet", "summary.json", "view.html"]
    assert printed["exit_code"] == 0
    assert printed["summary"] == json.loads((folder / "run" / "summary.json").read_text())
    return folder / "run"


BAD_USE = [
    (["rnu"], "did you mean 'run'"),
    (["run", "--vdeo"], "--video"),
    (["run", "--coupling", "jacoby"], "did you mean 'jacobi'"),
    (["run", "no\nsuch"], "no such folder"),
    (["run", "--out", Path(__file__).parent], "must be a new or an empty folder"),
    (["run", "--set", "plant.block_mas=1"], "did you mean 'block_mass'"),
    (["run", "--set", "block_mass=0.3"], "did you mean 'plant.block_mass'?"),
    (["run", "--set", "plant.block_mass=heavy"], "value 'heavy'; must be a number"),
    (["run", "--set", "duration=inf"], "Error: duration: value inf; must be a number from 0.001"),
    (["replay", "a", "--coupling", "jacobi"], "no such option: --coupling"),
    (["replay", "nosuch"], "must be the journal of a run of `live` or Session"),
    (["render", "nosuch"], "must be a recording or its folder"),
    (["export", "nosuch"], "Missing argument 'FILE'"),
    (["info", "plnt"], "did you mean 'plant'"),
    (["build", "--slave", "a.py", "--scenario", "push"], "--scenario: cannot be combined with"),
    (["sweep", "push"], "or a scenario with --vary KEY=LOW:HIGH:STEPS"),
    (["sweep", "push", "--vary", "align=1,2", "--vary", "align=3,4"], "is varied twice"),
    (["regress", "--yes"], "--yes: needs --update"),
    (["regress", "pus"], "did you mean 'push'"),
    (["regress", "push", "push"], "listed twice"),
    (["regress", "push", "--update", "--set", "controller.kp=7"], "cannot be combined with --set"),
    (["regress", "push", "--mujoco", "3.11.0", "--update"], "--mujoco: cannot be combined"),
    (["regress", "--scenarios", "/nowhere"], "no scenarios there"),
    (["regress", "push", "--overwrite"], "--overwrite: needs --report"),
    (["live", "--speed", "100"], "'--speed': '100'; must be less than or equal to 10"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_USE)
def test_bad_use_is_reported_in_one_line(arguments, message):
    result = call(*arguments)

    assert result.exit_code == InputError.exit_code
    assert result.stderr.startswith("Error: ")
    assert result.stderr.count("\n") == 1
    assert message.lower() in result.stderr.lower()
    assert result.stdout == ""


def test_bad_pictures_are_refused_before_any_is_drawn(finished, tmp_path):
    for option, value in (("--size", "12"), ("--size", "641x480"), ("--fps", "nan")):
        result = call("render", finished, "--out", tmp_path, option, value)
        assert result.exit_code == InputError.exit_code
        assert value.partition("x")[0] in result.stderr
    assert call("run", "push", "--fps", "0", "--out", tmp_path / "run").exit_code == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command_has_its_summary_and_an_example(command):
    result = call(command, "--help")

    assert result.exit_code == 0
    assert f"\n  panda-cosim {command}" in result.stdout
    assert "<bool>" not in result.stdout  # of a flag
    assert str(load(command).help).splitlines()[0] == COMMANDS[command][1]


@pytest.mark.parametrize("command", RULES)
def test_rules_of_options_are_about_options_of_the_command(command):
    options = {name for param in load(command).params for name in param.opts}
    for rule in RULES[command]:
        first, *others = re.findall("--[a-z-]+", rule)
        assert {first, *others} <= options
        assert others
        assert re.match(r"--[a-z-]+: (needs|cannot be combined with) ", rule)


def test_help_lists_the_exit_codes_and_is_what_no_command_gives():
    assert call("--version").stdout.startswith("panda-cosim 0.")
    assert "3 it ran, but" in " ".join(call("--help").stdout.split())
    assert call().exit_code == 0
    assert call().stdout.split() == call("--help").stdout.split()


COUNTED = """
import sys
from panda_cosim.run.system import assembly

def counted(*arguments, original=assembly.assemble, **options):
    print("ASSEMBLED")
    return original(*arguments, **options)

assembly.assemble = counted
from panda_cosim.cli import main
try: main()
finally: print("LOADED", *sys.modules)
"""
MOST_MODULES = 132  # of the project


@pytest.mark.parametrize(("option", "unused"), [("--view", set()), ("--no-view", {"mujoco"})])
def test_a_run_without_pictures_loads_what_it_uses_and_is_assembled_once(tmp_path, option, unused):
    build(["plant", "controller"])  # for which more is imported
    arguments = ("run", "pick_and_place", "--no-video", option, "--out", tmp_path / "run")
    command = [sys.executable, "-c", COUNTED, *map(str, arguments)]
    done = ran(command)
    assert done.stdout.count("ASSEMBLED") == 1
    modules = done.stdout.splitlines()[-1].split()[1:]
    assert sum(name.partition(".")[0] == "panda_cosim" for name in modules) <= MOST_MODULES
    heavy = {"control", "distributed", "matplotlib", "mediapy", "pandas", "scipy", "jinja2"}
    assert not (heavy | unused) & set(modules)


@pytest.mark.parametrize("instance", INTERFACES)
def test_info_names_every_variable(instance):
    told = call("info", instance).stdout
    rows = {line.partition(" ")[0].partition("[")[0] for line in told.splitlines()}
    assert {variable.name for variable in INTERFACES[instance].variables} <= rows
    assert max(map(len, told.splitlines())) <= 100
    assert "plant.jac[1..6,1..7] controller.jac[1..6,1..7]" in " ".join(told.split())


def test_info_filters_variables_and_connections():
    told = json.loads(call("info", "--filter", "TORQUE", "--json").stdout)
    for name, fmu in told["fmus"].items():
        for variable in INTERFACES[name].variables:
            words = f"{name}.{variable.name} {variable.description}".lower()
            is_told = variable.name in [each["name"] for each in fmu["variables"]]
            assert is_told == ("torque" in words), variable.name
    assert told["fmus"]["plant"]["variables"]
    everything = json.loads(call("info", "--json").stdout)["connections"]
    assert told["connections"] == [c for c in everything if "torque" in f"{c}".lower()]


def test_info_says_what_stands_in_a_scene_of_ones_own(tmp_path):
    call("new", tmp_path / "own", "--plant")
    told = json.loads(call("info", tmp_path / "own", "--json").stdout)["objects"]
    assert ["pillar", "free", "0.6 0.35 0.25", "box 0.03 0.03 0.05"] in told
    assert "work_space" in call("info", tmp_path / "own").stdout


def test_a_run_leaves_recording_summary_and_scenario(finished):
    found = {path.relative_to(finished).as_posix() for path in finished.rglob("*")}
    files = {"recording.parquet", "summary.json", "view.html"}
    assert found == {*files, "scenario", "scenario/scenario.toml", "scenario/trajectory.csv"}
    assert json.loads((finished / "summary.json").read_text())["success"] is True
    assert Recording.open(finished).rows == 201


def test_what_there_is_is_printed_as_json(scenario):
    listed = json.loads(call("list", "--json").stdout)
    assert [each["name"] for each in listed] == list(shipped_scenarios())
    info = json.loads(call("info", "plant", "--json").stdout)
    assert list(info["fmus"]) == ["plant"]
    assert {"from": "controller.ctrl[1]", "to": "plant.ctrl[1]"} in info["connections"]
    checked = json.loads(call("check", scenario, "--json").stdout)
    assert checked["ok"] is True
    (scenario / "trajectory.csv").unlink()
    wrong = call("check", scenario, "--json")
    assert wrong.exit_code == InputError.exit_code
    assert json.loads(wrong.stdout)["findings"][0]["level"] == "wrong"


def test_a_folder_with_the_name_of_a_shipped_scenario_is_pointed_out(tmp_path, monkeypatch):
    make_scenario(tmp_path / "tutorial")
    monkeypatch.chdir(tmp_path)

    shipped = call("inputs", "tutorial", "shipped.csv")
    assert shipped.exit_code == 0
    assert "write ./tutorial" in shipped.stderr
    own = call("inputs", "./tutorial", "own.csv")
    assert own.stderr == ""
    rows = [len(Path(f"{name}.csv").read_text().splitlines()) for name in ("shipped", "own")]
    assert rows == [6502, 202]


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("re", {"regress", "render", "replay", "retime"}),
     ("run --coupling ", {"gauss-seidel", "jacobi", "iterated"}),
     ("run place", {"place_and_pick_again"})],
)  # fmt: skip
def test_the_shell_completes(typed, offered):
    words = f"panda-cosim {typed}"
    place = str(words.count(" "))
    done = forked(_PANDA_COSIM_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=place, code=0)
    assert set(done.stdout.split()) == offered


def test_real_time_pacing_is_reported(scenario, tmp_path):
    options = ("--no-video", "--realtime", "--out", tmp_path / "run")
    done = forked("run", scenario, *options, code=0)

    assert "Success: 1 of 1 criteria hold" in done.stdout
    assert "of 200 steps were late" in done.stdout
    assert json.loads((tmp_path / "run/summary.json").read_text())["timing"]["wall_s"] > 0.1


def test_without_opengl_the_rest_of_the_job_is_done(scenario, tmp_path):
    done = forked("run", scenario, "--out", tmp_path / "run", MUJOCO_GL="disable", code=0)

    assert "MUJOCO_GL=disable" in done.stderr
    assert "panda-cosim render" in done.stderr
    assert (tmp_path / "run" / "plot.png").is_file()
    assert not list((tmp_path / "run").glob("*.mp4"))


def test_an_unexpected_error_is_one_line_and_a_traceback_on_request(monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("the roof is on fire")

    monkeypatch.setattr("panda_cosim.cli.commands.new.shipped_scenarios", fail)

    result = call("list")
    assert result.exit_code == 1
    assert "unexpected RuntimeError: the roof is on fire" in result.stderr
    assert "--debug" in result.stderr
    assert "Traceback" not in result.stderr
    assert "Traceback" in call("list", "--debug").stderr


def test_a_reader_that_goes_away_is_no_error():
    program = f"{sys.executable} -m panda_cosim"
    command = f"set -o pipefail; {program} info | head -1; {program} list | true"
    done = ran(["bash", "-c", command])

    assert done.stderr == ""


def test_progress_is_a_bar_in_a_terminal(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress("Working") as update:
        update(1, 4)
        update(4, 4)
    shown = capsys.readouterr().err
    assert "Working" in shown
    assert re.search("100%.*0:00:00", shown)


def test_a_narrow_terminal_loses_nothing():
    """The terminal breaks long lines; rich would cut them off."""
    wide, narrow = (forked("list", COLUMNS=columns).stdout for columns in ("300", "20"))
    assert sorted(narrow.replace("─", "").split()) == sorted(wide.replace("─", "").split())
    said = forked("run", "--help", COLUMNS="20").stdout
    assert "--step-timeout" in said
    assert "…" not in said
