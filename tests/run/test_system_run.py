"""A coupled system from an .ssp file runs as the scenario that it was made from, bit for bit."""

import pytest

from fault_support import write_files
from fmu_support import REFERENCE_FMUS, members, needs_reference_fmus, pack
from forked import command as program
from panda_cosim import Recording
from panda_cosim.task.writer import make_scenario
from parts_jobs import write_arm

TOML = 'duration = 0.05\nscene = "tutorial"\ngains = "tutorial"\ninterpolation = "linear"\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a scenario, and with the files that `build` makes of it."""
    folder = tmp_path_factory.mktemp("system")
    write_files(folder / "short", TOML, "0,home,0,0,0,0.08", "0.05,home,0,0,-0.01,0.08")
    program("build", "--out", folder / "files", "--scenario", folder / "short", code=0)
    made = {path.name for path in (folder / "files").iterdir()}
    assert made == {"PandaPlant.fmu", "PandaController.fmu", "PandaTrajectory.fmu", "Panda.ssp"}
    return folder


@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_a_system_runs_as_its_scenario_bit_for_bit(folder, coupling):
    runs = {"system": (folder / "files" / "Panda.ssp",), "scenario": (folder / "short",)}
    for name, arguments in runs.items():
        out = folder / f"{name}-{coupling}"
        program("run", *arguments, "--out", out, "--no-video", "--coupling", coupling, code=0)
    system = Recording.open(folder / f"system-{coupling}")
    scenario = Recording.open(folder / f"scenario-{coupling}")
    assert system.complete
    assert system.rows == 51
    for signal in ("plant.qpos", "plant.actuator_force", "controller.ctrl"):
        assert (system[signal] == scenario[signal]).all()
    assert system.units["plant.qpos[1]"] == "rad"


TYPES = """duration = 1.0
step = 0.1
[fmus]
a = "{folder}/fmi2/Feedthrough.fmu"
b = "{folder}/fmi3/Feedthrough.fmu"
[connect]
"b.Float64_continuous_input" = "a.Float64_continuous_output"
"b.Int32_input" = "a.Int32_output"
"b.Int16_input" = "convert(a.Float64_continuous_output)"
[inputs]
file = "inputs.csv"
"a.Int32_input" = 5
"b.Boolean_input" = true
"b.String_input" = "text"
"b.Binary_input" = "00ff"
"b.Int64_input" = 9007199254740993
"""
OWN = """coupling = "jacobi"
duration = 0.3
[fmus]
controller = "my_law.py:ResolvedRate"
[controller]
gain = 12.0
[plant]
block_mass = 0.2
[mismatch]
preset = "calibrated"
seed = 3
[[push]]
start = 0.1
duration = 0.1
force = [1.0, 3.0, -2.0]
[[push]]
start = 0.2
duration = 0.1
force = [0.0, 0.5, 0.0]
on = "block"
"""


@pytest.mark.parametrize(
    ("kind", "fmi"),
    [
        ("law", "2"),
        ("plant and slave", "3"),
        pytest.param("all types", "2", marks=[needs_reference_fmus, pytest.mark.long]),
        pytest.param("all types", "3", marks=needs_reference_fmus),
    ],
)
def test_a_scenario_of_one_s_own_is_built_and_runs_as_before(tmp_path, kind, fmi):
    mine, files = tmp_path / "mine", tmp_path / "files"
    if kind == "all types":
        mine.mkdir()
        (mine / "scenario.toml").write_text(TYPES.format(folder=REFERENCE_FMUS))
        (mine / "inputs.csv").write_text("time,a.Float64_continuous_input\n0,1\n0.45,3\n1,5\n")
    elif kind == "plant and slave":
        write_arm(mine)
        with (mine / "scenario.toml").open("a") as file:
            file.write("[steps]\ncontroller = 5\n")
    else:
        make_scenario(mine, ["law"])
        (mine / "scenario.toml").write_text(OWN)
    for arguments in (
        ("build", "--scenario", mine, "--fmi", fmi, "--out", files),
        ("run", mine, "--no-video", "--out", tmp_path / "scenario"),
        ("run", files / "Panda.ssp", "--no-video", "--out", tmp_path / "system"),
    ):
        done = program(*arguments)
        assert done.returncode in (0, 3), done.stderr
    scenario, system = Recording.open(tmp_path / "scenario"), Recording.open(tmp_path / "system")
    assert system.complete
    assert system.rows == scenario.rows
    shared = {*scenario.columns} & {*system.columns}
    others = {name.partition("[")[0] for name in {*scenario.columns} - shared}
    assert all(name.endswith(("_cmd", "_force", "_input")) for name in others)  # from outside
    assert len(shared) > 10
    assert [name for name in shared if (scenario[name] != system[name]).any()] == []
    check = program("check", files / "Panda.ssp", code=0)
    assert "it can run" in check.stdout


def test_run_and_check_refuse_a_system_in_the_same_words(folder, tmp_path):
    content, file = members(folder / "files" / "Panda.ssp"), "SystemStructure.ssd"
    text = content[file].replace(b'startConnector="qvel[1]"', b'startConnector="qvl[1]"')
    bad = pack(tmp_path / "bad.ssp", content | {file: text})
    run, check = program("run", bad, "--out", tmp_path / "run"), program("check", bad)
    assert (run.returncode, check.returncode) == (2, 2)
    assert (
        check.stdout.removeprefix("wrong  ").strip() == run.stderr.removeprefix("Error: ").strip()
    )
    assert "did you mean 'qvel[1]'" in check.stdout


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--system", "nowhere.ssp"), "nowhere.ssp"),
        (("{ssp}", "--kind", "python"), "--kind: does not apply to Panda.ssp"),
        (("{ssp}", "--plant", "a.xml"), "plant: system: cannot be combined with [fmus]"),
        (("{ssp}", "--set", "plant.block_mas=0.2"), "did you mean 'block_mass'?"),
        (("--system", "{ssp}", "--duration", "0.0105"), "whole number of ticks of 0.001 s"),
        (("pick_and_place", "--system", "{ssp}"), "'pick_and_place': cannot be combined"),
        (("--system", "{ssp}", "--out", "{files}"), "already exists"),
    ],
)
def test_bad_input_is_refused_in_one_line(folder, arguments, expected):
    files = folder / "files"
    done = program(
        "run", *(a.format(ssp=files / "Panda.ssp", files=files) for a in arguments), code=2
    )
    assert expected in done.stderr
    assert "Traceback" not in done.stderr
