"""Files from elsewhere are data: only running an FMU runs what is in it."""

import os
import shutil
import stat
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bounded import ran, wait_until
from fault_support import STARTING_LAW, write_scenario
from fmu_support import copy_libraries, members, pack
from live_support import asked, live, viewer
from panda_cosim.fmus.atomic import cache_folder
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.sources.targets import Target, build
from panda_cosim.task.files import safe_name
from sweep_support import write_sweep


def test_describing_an_fmu_runs_nothing_in_it(tmp_path, monkeypatch):
    mark, changed = tmp_path / "mark", tmp_path / "changed.fmu"
    leave_mark = f"import pathlib; pathlib.Path({str(mark)!r}).touch()\n".encode()
    source = build(("plant",), target=Target("python"))["plant"]
    spoilt = {n: leave_mark * n.endswith(".py") + old for n, old in members(source).items()}
    starters = ("sitecustomize.py", "resources/x.pth", "conftest.py")
    pack(changed, spoilt | dict.fromkeys(starters, leave_mark))
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


PROGRAM = Path(sysconfig.get_path("scripts")) / "panda-cosim"


@pytest.mark.parametrize("isolate", [False, True])
def test_code_in_the_working_directory_does_not_run(tmp_path, isolate):
    """Neither in the command, nor where FMUs are built, nor in any other Python that is started."""
    names = {name for name in sys.stdlib_module_names if name != "__main__"} | OTHERS
    spoil(tmp_path / "here", names - STARTERS if isolate else names)
    program = [sys.executable, "-m", "panda_cosim"] if isolate else [PROGRAM]
    scenario, out = tmp_path / "scenario", tmp_path / "run"
    write_scenario(scenario, 0.01, '[fmus]\ncontroller = "starts.py:Starts"\n')
    (scenario / "starts.py").write_text(STARTING_LAW)
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
from panda_cosim.study.sweep.sweeping import sweep

folder, slave, out = map(Path, sys.argv[1:])
sys.path.insert(0, "")
sweep(folder / "sweep.toml", out / "sweep", jobs=1)
slave_fmu(slave, None)
"""


@pytest.mark.long
def test_nor_does_it_where_a_users_script_starts_processes(tmp_path):
    """`PYTHONSAFEPATH` is set for the project's own children then, and for theirs."""
    spoil(tmp_path / "here", {"json", "numpy", "pythonfmu", "importlib", "socket"})
    write_sweep(tmp_path, 2)
    slave = Path(__file__).parents[1] / "slaves" / "decay.py"
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


# Other users of the machine: nothing of theirs is loaded, and a live run is not theirs.


OTHER = 12345  # id of a user


@pytest.fixture
def shared():
    """A folder that all may write to, as /tmp is."""
    folder = Path(tempfile.mkdtemp(prefix="panda-cosim-test-"))
    folder.chmod(0o1777)
    yield folder
    shutil.rmtree(folder)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be another user, too")
@pytest.mark.parametrize(
    ("mode", "owner"), [(0o700, OTHER), *((mode, os.geteuid()) for mode in (0o770, 0o777, 0o1777))]
)
def test_a_cache_of_another_user_or_that_others_may_write_to_is_refused(
    shared, monkeypatch, mode, owner
):
    shared.chmod(mode)
    os.chown(shared, owner, -1)
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(shared))
    with pytest.raises(InputError, match=r"others may write to it.*PANDA_COSIM_CACHE"):
        cache_folder()


def test_a_new_cache_is_private_whatever_the_umask(shared, monkeypatch):
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(shared / "new" / "cache"))
    before = os.umask(0)
    try:
        assert stat.S_IMODE(cache_folder().stat().st_mode) == 0o700
    finally:
        os.umask(before)


def test_the_browser_gets_the_token_in_a_file_of_the_users_own(shared, monkeypatch):
    browser = shared / "browser"
    browser.write_text('#!/bin/sh\necho "$@" > "$0.said"\nexec sleep 45 >&- 2>&-\n')
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    with live(shared / "run", "--speed", "0.05", "--open") as server:
        leads = server.folder / "open.html"
        said = shared / "browser.said"
        wait_until(lambda: said.exists() and said.read_text())
        assert said.read_text().strip() == leads.as_uri()
        assert server.address in leads.read_text()
        assert stat.S_IMODE(leads.stat().st_mode) == 0o600
        with viewer(server) as socket:
            messages = [socket.recv(20) for _ in range(20)]
        assert sum(isinstance(each, bytes) for each in messages) > 5  # rows, with the browser open
        for path in ("/", "/live", "/session.zip"):
            assert asked(server, path) == (403, b"")
        command = Path(f"/proc/{server.process.pid}/cmdline").read_bytes()
        assert server.token.encode() not in command  # which all users can read
        server.end()
    assert not leads.exists()
