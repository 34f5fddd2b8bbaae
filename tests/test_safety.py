"""Files from elsewhere are data: only running an FMU runs what is in it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from fault_support import STARTING_LAW, build_faulty, write_scenario
from hypothesis import given
from hypothesis import strategies as st
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.interface.parameters import expand, parse_assignment
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.scenarios.files import safe_name
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.run.folders import default_folder
from panda_cosim.scenarios.scenario.scenario import Scenario
from sweep_support import write_sweep

CODE = "__import__('pathlib').Path('{mark}').touch()"


def test_code_in_a_scenario_is_text(tmp_path: Path) -> None:
    code = CODE.format(mark=tmp_path / "mark")
    folder = write_scenario(tmp_path / "scenario")
    toml = folder / "scenario.toml"
    toml.write_text(toml.read_text().replace('"short"', f'"{code}"'))
    assert Scenario.read(folder).purpose == code
    toml.write_text(toml.read_text().replace('"tabletop"', f'"{code}"'))
    with pytest.raises(InputError, match="must be one of"):
        Scenario.read(folder)
    table = folder / "trajectory.csv"
    toml.write_text(toml.read_text().replace(f'scene = "{code}"', ""))
    table.write_text(table.read_text().replace("0.02", code))
    with pytest.raises(InputError, match="must be a number"):
        Scenario.read(folder)
    instance, name, value = parse_assignment(f"plant.block_mass={code}", tuple(INTERFACES))
    with pytest.raises(InputError, match="is not a number"):
        expand(instance, INTERFACES[instance], {name: value})
    assert not (tmp_path / "mark").exists()


def test_describing_an_fmu_runs_nothing_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = build_faulty(tmp_path)
    mark = tmp_path / "mark"
    leave_mark = f"import pathlib; pathlib.Path({str(mark)!r}).touch()\n".encode()
    changed = tmp_path / "changed.fmu"
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(changed, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name.endswith(".py"):
                content = (
                    f"import pathlib; pathlib.Path({str(mark)!r}).touch()\n".encode() + content
                )
            target.writestr(name, content)
        for name in ("sitecustomize.py", "resources/x.pth", "conftest.py"):
            target.writestr(name, leave_mark)
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path / "cache"))
    assert Fmu(changed).variable("qpos[1]").variable.causality == "output"
    assert not mark.exists()


def test_a_pickle_is_refused_as_a_recording(tmp_path: Path) -> None:
    class_call = b"cpathlib\nPath\n(S'" + str(tmp_path / "mark").encode() + b"'\ntRctouch\n."
    for name in ("recording.parquet", "recording.arrows"):
        (tmp_path / name).write_bytes(class_call)
        with pytest.raises(InputError):
            Recording.open(tmp_path / name)
    assert not (tmp_path / "mark").exists()
    shutil.rmtree(tmp_path)


# Modules that `python -m` itself imports from the working directory, before any of ours.
STARTERS = {"pkgutil", "sitecustomize", "usercustomize"}
OTHERS = {
    "numpy",
    "mujoco",
    "fmpy",
    "pythonfmu",
    "panda_cosim_user",
    "typer",
    "rich",
    "glfw",
    "lxml",
}


def spoil(folder: Path, names: set[str]) -> Path:
    """Put a module of each of these names into a folder, which leaves a mark if it is run."""
    folder.mkdir()
    marks = folder.with_name("marks")
    marks.mkdir()
    for name in names:
        code = f"import sys; open({str(marks / name)!r}, 'w').write(str(sys.orig_argv))\n"
        (folder / f"{name}.py").write_text(code)
    return marks


@pytest.mark.fmu
@pytest.mark.parametrize(
    ("start", "isolate"), [("script", ()), ("module", ("--isolate",))], ids=["script", "module"]
)
def test_code_in_the_working_directory_does_not_run(
    tmp_path: Path, start: str, isolate: tuple[str, ...]
) -> None:
    """Neither in the command, nor where FMUs are built, nor in any other Python that is started."""
    names = {name for name in sys.stdlib_module_names if name != "__main__"} | OTHERS
    here = tmp_path / "here"
    marks = spoil(here, names if start == "script" else names - STARTERS)
    scenario = write_scenario(tmp_path / "scenario", 0.01)
    script = [str(Path(sysconfig.get_path("scripts")) / "panda-cosim")]
    program = script if start == "script" else [sys.executable, "-m", "panda_cosim"]
    cache = {"PANDA_COSIM_CACHE": str(tmp_path / "cache")}
    done = subprocess.run(
        [*program, "run", str(scenario), "--no-video", "--out", str(tmp_path / "run"), *isolate],
        env={k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"} | cache,
        cwd=here,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert {mark.name: mark.read_text() for mark in marks.iterdir()} == {}


# What a user's script does that starts Python; the folder of the working directory may be on its
# path, and it has loaded what it needs itself.
LOADED = """
import sys
from pathlib import Path
import fmpy, fmpy.fmi2, fmpy.model_description, mujoco, numpy, pyarrow.parquet
import panda_cosim.fmus.sources.targets
from panda_cosim import Options, run_scenario
from panda_cosim.fmus.sources.python_fmu import slave_fmu
from panda_cosim.scenarios.pictures.offscreen import OffscreenRenderer
from panda_cosim.scenarios.sweep.engine import sweep

given, slave, out = map(Path, sys.argv[1:])
sys.path.insert(0, "")
"""
STARTS = {
    "isolated": "run_scenario(given / 'law', out, Options(isolate=True))",
    "sweep": "sweep(given / 'sweep.toml', out, jobs=1)",
    "picture": "OffscreenRenderer('tabletop', 16, 16).close()",
    "slave": "slave_fmu(slave, None)",
}


def law_scenario(folder: Path) -> Path:
    """Write a scenario whose controller starts a Python."""
    write_scenario(folder, 0.01, '[fmus]\ncontroller = "starts.py:Starts"\n')
    (folder / "starts.py").write_text(STARTING_LAW)
    return folder


def unprotected(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder, without the variable that protects from its modules."""
    return subprocess.run(
        command,
        env={k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.mark.fmu
@pytest.mark.parametrize("what", STARTS)
def test_nor_does_it_where_a_users_script_starts_processes(tmp_path: Path, what: str) -> None:
    """`PYTHONSAFEPATH` is set for the project's own children then, and for theirs."""
    marks = spoil(tmp_path / "here", {"json", "numpy", "pythonfmu", "importlib", "socket"})
    write_sweep(tmp_path, 2)
    law_scenario(tmp_path / "law")
    slave = Path(__file__).parent / "slaves" / "decay.py"
    words = [str(word) for word in (tmp_path, slave, tmp_path / "out")]
    done = unprotected(
        [sys.executable, "-P", "-c", LOADED + STARTS[what], *words], tmp_path / "here"
    )
    assert {mark.name: mark.read_text() for mark in marks.iterdir()} == {}
    if "RenderError" in done.stderr:
        pytest.skip("cannot draw here")
    assert done.returncode == 0, done.stderr


@pytest.mark.fmu
@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolated"])
def test_nor_does_it_in_a_python_that_an_fmu_starts(
    tmp_path: Path, isolate: tuple[str, ...]
) -> None:
    marks = spoil(tmp_path / "here", {"json", "numpy"})
    script = str(Path(sysconfig.get_path("scripts")) / "panda-cosim")
    options = ("--no-video", "--no-view", "--no-plot", "--out", str(tmp_path / "run"))
    command = [script, "run", str(law_scenario(tmp_path / "law")), *options, *isolate]
    done = unprotected(command, tmp_path / "here")
    assert {mark.name: mark.read_text() for mark in marks.iterdir()} == {}
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("../../up", "_.._up"),
        ("/tmp/x", "_tmp_x"),
        ("..", "unnamed"),
        ("", "unnamed"),
        ("a\0b\nc\\d:e$f", "a_b_c_d_e_f"),
        (".hidden", "hidden"),
        ("Größe-1.2_b", "Größe-1.2_b"),
        ("\udc80", "_"),
        ("ä" * 100, "ä" * 60),  # 120 bytes
    ],
)
def test_a_name_becomes_one_safe_file_name(name: str, safe: str) -> None:
    assert safe_name(name) == safe


def test_a_run_of_any_name_is_put_into_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("../../up", "/tmp/x"):
        assert default_folder(name).parent == Path("runs")


@given(st.text(max_size=300))
def test_any_name_becomes_one_safe_file_name(name: str) -> None:
    safe = safe_name(name)
    assert Path("runs", safe).name == safe
    assert 1 <= len(safe.encode()) <= 120
    assert not safe.startswith(".")
    assert safe_name(safe) == safe
