"""A coupled system from an .ssp file runs as the scenario that it was made from, bit for bit."""

from __future__ import annotations

from pathlib import Path

import pytest
from forked import command as program
from panda_cosim import Recording

TOML = 'duration = 0.05\nscene = "tutorial"\ngains = "tutorial"\ninterpolation = "linear"\n'
TABLE = "time,frame,x,y,z,grip\n0,home,0,0,0,0.08\n0.05,home,0,0,-0.01,0.08\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scenario, and with the files that `build` makes of it."""
    folder = tmp_path_factory.mktemp("system")
    (folder / "short").mkdir()
    (folder / "short" / "scenario.toml").write_text(TOML)
    (folder / "short" / "trajectory.csv").write_text(TABLE)
    built = program("build", "--out", folder / "files", "--scenario", folder / "short")
    assert built.returncode == 0, built.stderr
    made = {path.name for path in (folder / "files").iterdir()}
    assert made == {"PandaPlant.fmu", "PandaController.fmu", "PandaTrajectory.fmu", "Panda.ssp"}
    return folder


@pytest.mark.fmu
@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_a_system_runs_as_its_scenario_bit_for_bit(folder: Path, coupling: str) -> None:
    runs = {"system": (folder / "files" / "Panda.ssp",), "scenario": (folder / "short",)}
    for name, arguments in runs.items():
        out = folder / f"{name}-{coupling}"
        done = program("run", *arguments, "--out", out, "--no-video", "--coupling", coupling)
        assert done.returncode == 0, done.stderr
    system = Recording.open(folder / f"system-{coupling}")
    scenario = Recording.open(folder / f"scenario-{coupling}")
    assert system.complete
    assert system.rows == 51
    for signal in ("plant.qpos", "plant.actuator_force", "controller.ctrl"):
        assert (system[signal] == scenario[signal]).all()
    assert system.units["plant.qpos[1]"] == "rad"


@pytest.mark.fmu
@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--system", "nowhere.ssp"), "nowhere.ssp"),
        (("{ssp}", "--kind", "python"), "--kind: does not apply to Panda.ssp"),
        (("{ssp}", "--plant", "a.xml"), "plant: cannot be combined with system = 'Panda.ssp'"),
        (("{ssp}", "--set", "plant.block_mas=0.2"), "did you mean 'block_mass'?"),
        (("--system", "{ssp}", "--duration", "0.0105"), "whole number of steps of 0.001 s"),
        (("tutorial", "--system", "{ssp}"), "'tutorial': cannot be combined with --system"),
        (("--system", "{ssp}", "--out", "{files}"), "already exists"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    folder: Path, arguments: tuple[str, ...], expected: str
) -> None:
    files = folder / "files"
    done = program("run", *(a.format(ssp=files / "Panda.ssp", files=files) for a in arguments))
    assert done.returncode == 2
    assert expected in done.stderr
    assert "Traceback" not in done.stderr
