"""Files from elsewhere are data: only running an FMU runs what is in it."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bounded import ran
from fault_support import STARTING_LAW, write_scenario
from fmu_support import copy_libraries
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.sources.targets import Target, build
from panda_cosim.task.files import safe_name
from sweep_support import write_sweep


def test_describing_an_fmu_runs_nothing_in_it(tmp_path, monkeypatch):
    mark, changed = tmp_path / "mark", tmp_path / "changed.fmu"
    leave_mark = f"import pathlib; pathlib.Path({str(mark)!r}).touch()\n".encode()
    source = build(("plant",), target=Target("python"))["plant"]
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            new.writestr(name, leave_mark * name.endswith(".py") + old.read(name))
        for name in ("sitecustomize.py", "resources/x.pth", "conftest.py"):
            new.writestr(name, leave_mark)
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path / "cache"))
    assert Fmu(changed).variable("qpos[1]").variable.causality == "output"
    assert not mark.exists()


# Modules that `python -m` itself imports from the working directory, before any of ours.
_LOADED = "import runpy, sys; print(*sys.modules)"
_SAID = subprocess.run(
    [sys.executable, "-I", "-c", _LOADED], stdout=-1, text=True, check=True, timeout=60
)
STARTERS = {"sitecustomize", "usercustomize", *_SAID.stdout.split()}
OTHERS = {"numpy", "mujoco", "fmpy", "pythonfmu", "panda_cosim_user", "typer", "rich", "lxml"}


def spoil(folder: Path, names: set[str]) -> None:
    """Put a module of each of these names into a folder, which leaves a mark if it is run."""
    folder.mkdir()
    marks = folder.with_name("marks")
    marks.mkdir()
    for name in names:
        code = f"import sys; open({str(marks / name)!r}, 'w').write(str(sys.orig_argv))\n"
        (folder / f"{name}.py").write_text(code)


def unprotected(command: list[object], folder: Path, **variables: str) -> None:
    """Run a command in a folder, without the variable that protects from its modules."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
    done = ran(list(map(str, command)), env=environment | variables, cwd=folder, code=None)
    marks = folder.with_name("marks")
    assert {mark.name: mark.read_text() for mark in marks.iterdir()} == {}
    assert done.returncode == 0, done.stderr


def law_scenario(folder: Path) -> Path:
    """Write a scenario whose controller starts a Python."""
    write_scenario(folder, 0.01, '[fmus]\ncontroller = "starts.py:Starts"\n')
    (folder / "starts.py").write_text(STARTING_LAW)
    return folder


PROGRAM = Path(sysconfig.get_path("scripts")) / "panda-cosim"


@pytest.mark.parametrize("isolate", [False, True])
def test_code_in_the_working_directory_does_not_run(tmp_path, isolate):
    """Neither in the command, nor where FMUs are built, nor in any other Python that is started."""
    names = {name for name in sys.stdlib_module_names if name != "__main__"} | OTHERS
    spoil(tmp_path / "here", names - STARTERS if isolate else names)
    program = [sys.executable, "-m", "panda_cosim"] if isolate else [PROGRAM]
    scenario, out = law_scenario(tmp_path / "scenario"), tmp_path / "run"
    options = ["--no-video", "--no-view", "--out", out, *(["--isolate"] if isolate else [])]
    # FMUs are built in one of both.
    cache = {} if isolate else {"PANDA_COSIM_CACHE": str(tmp_path / "cache")}
    copy_libraries(tmp_path / "cache" / "libraries", "player")
    unprotected([*program, "run", scenario, *options], tmp_path / "here", **cache)


# What a user's script does that starts Python; the folder of the working directory may be on its
# path, and it has loaded what it needs itself.
STARTS = """
import sys
from pathlib import Path
import fmpy, fmpy.fmi2, fmpy.model_description, mujoco, numpy, pyarrow.parquet
import panda_cosim.fmus.sources.targets
from panda_cosim.fmus.sources.python_fmu import slave_fmu
from panda_cosim.study.sweep.engine import sweep

folder, slave, out = map(Path, sys.argv[1:])
sys.path.insert(0, "")
sweep(folder / "sweep.toml", out / "sweep", jobs=1)
slave_fmu(slave, None)
"""


def test_nor_does_it_where_a_users_script_starts_processes(tmp_path):
    """`PYTHONSAFEPATH` is set for the project's own children then, and for theirs."""
    spoil(tmp_path / "here", {"json", "numpy", "pythonfmu", "importlib", "socket"})
    write_sweep(tmp_path, 2)
    slave = Path(__file__).parent / "slaves" / "decay.py"
    command = [sys.executable, "-P", "-c", STARTS, tmp_path, slave, tmp_path]
    unprotected(command, tmp_path / "here")


@pytest.mark.parametrize(
    ("name", "safe"),
    [("../../up", "_.._up"), ("..", "unnamed"), ("", "unnamed"), ("a\0b\nc\\d:e$f", "a_b_c_d_e_f"),
     (".hidden", "hidden"), ("Größe-1.2_b", "Größe-1.2_b"), ("ä" * 100, "ä" * 60)],
)  # fmt: skip
def test_a_name_becomes_one_safe_file_name(name, safe):
    assert safe_name(name) == safe


@given(st.text(max_size=300))
def test_any_name_becomes_one_safe_file_name(name):
    safe = safe_name(name)
    assert Path("runs", safe).name == safe
    assert 1 <= len(safe.encode()) <= 120
    assert not safe.startswith(".")
    assert safe_name(safe) == safe
