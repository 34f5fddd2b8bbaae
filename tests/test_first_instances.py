"""Threads of a host in C that make the first instances of a process at one moment."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import native_models
import native_python
import pytest
from fmu_support import Host, compile_host, compiler
from native_support import OK, TOKEN, Table, mujoco_library, resources_uri
from panda_cosim.fmus.build import libraries as native

SOURCE = Path(__file__).parent / "c_host" / "first.c"
ROUNDS = 3
RACES = ("-g", "-fsanitize=thread")
pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
    pytest.mark.skipif(native.this_platform() != "linux64", reason="the host is for Linux"),
]
needs_library = pytest.mark.skipif(
    not Path(native_python.recorded()[0][1]).is_file(), reason="this Python has no shared library"
)


def compiled(program: Path, *arguments: str | Path) -> Path:
    """Compile the host, or a library."""
    tool = compiler()
    assert tool
    includes = [f"-isystem{include}" for include in native.includes()]
    libraries = ["-ldl", "-lpthread", "-lm"]
    places = ["-I", native.SOURCES, *includes]
    command = [tool, "-std=gnu11", *places, *arguments, "-o", program, *libraries]
    subprocess.run(command, check=True, timeout=300)
    return program


def words(folder: Path, library: Path | None = None) -> list[str]:
    """What the host needs to know of an FMU."""
    found = library or next(folder.glob("binaries/linux64/*.so"))
    return [str(found), TOKEN, resources_uri(folder)]


def first(program: Path, *fmus: list[str]) -> str:
    """Run the host; returns what it says of failures."""
    done = subprocess.run(
        [program, *(word for fmu in fmus for word in fmu)],
        env=os.environ | {"TSAN_OPTIONS": "ignore_noninstrumented_modules=1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    if "unexpected memory mapping" in done.stderr:
        pytest.skip("the thread sanitizer does not run on this kernel")
    return f"{done.returncode}\n{done.stderr[-3000:]}" if done.returncode else ""


def tables() -> list[Table]:
    """Two slaves."""
    recorded = native_python.recorded()
    return [native_python.shared_table(recorded), native_python.decay_table(recorded)]


@needs_library
def test_fmus_in_python_may_be_first_at_one_moment(tmp_path: Path) -> None:
    """Only one starts Python, although each has its own copy of the library."""
    program = compiled(tmp_path / "first", SOURCE)
    folders = [native_python.build(tmp_path / f"{n}", table) for n, table in enumerate(tables())]
    for _ in range(ROUNDS):
        assert not first(program, *map(words, folders))


@pytest.mark.parametrize("backend", ["mujoco", pytest.param("python", marks=needs_library)])
def test_first_instances_of_an_fmu_do_not_race(tmp_path: Path, backend: str) -> None:
    sources = [native.SOURCES / name for name in (*native.FMI_LAYER, *native.BACKENDS[backend])]
    library = compiled(tmp_path / "fmu.so", *RACES, "-fPIC", "-shared", *sources)
    (tmp_path / "libmujoco.so").symlink_to(mujoco_library())
    program = compiled(tmp_path / "first", *RACES, SOURCE)
    if backend == "mujoco":
        folder = native_models.build_plant(tmp_path / "fmu")
    else:
        folder = native_python.build(tmp_path / "fmu", tables()[0])
    assert not first(program, *[words(folder, library)] * 3)


@needs_library
def test_a_python_that_another_fmu_has_started_is_no_hosts(tmp_path: Path) -> None:
    """MuJoCo's import starts `python3` to look for OpenGL, unless it is told not to."""
    commands = tmp_path / "bin"
    commands.mkdir()
    (commands / "python3").write_text(f"#!/bin/sh\ntouch {tmp_path}/started\n")
    (commands / "python3").chmod(0o755)
    with_mujoco = native_python.shared_table((*native_python.recorded(), ("need", "mujoco 1.0")))
    folders = [native_python.build(tmp_path / "0", tables()[1]),
               native_python.build(tmp_path / "1", with_mujoco)]  # fmt: skip
    with Host(compile_host(tmp_path), {"PATH": str(commands)}) as host:
        for slot, folder in enumerate(folders):
            host.load(slot, folder, "Model")
            answer = host("new", slot, slot, TOKEN, resources_uri(folder))
            assert answer.status == OK, answer.messages
        assert host.close() == 0
    assert not (tmp_path / "started").exists()
