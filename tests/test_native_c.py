"""The C code of native FMUs under sanitizers and valgrind, driven by random calls."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from fmu_instance import BACKENDS, MODELS, Unpacked, mujoco_library, unpacked
from fmu_support import compiler, needs_compiler
from panda_cosim.fmus.build import libraries as native
from panda_cosim.fmus.sources.python_fmu import python_library
from panda_cosim.fmus.sources.targets import Kind

DRIVE = Path(__file__).parent / "c_host" / "drive.c"
SANITIZED = (
    *("-g", "-O1", "-fno-sanitize-recover=all"),
    "-fsanitize=address,undefined,float-cast-overflow",
)
PLAIN = ("-g", "-O1")
SHORT, ACCEPTANCE = 1500, 100_000  # calls
pytestmark = needs_compiler


def compiled(folder: Path, *arguments: str | Path) -> None:
    """Run the compiler in a folder."""
    places = [native.SOURCES, *(f"-isystem{include}" for include in native.includes())]
    command = [str(compiler()), "-std=c11", "-I", *places, *arguments]
    subprocess.run(command, cwd=folder, check=True, timeout=300)


def sources(names: tuple[str, ...]) -> list[Path]:
    """Paths of sources."""
    return [native.SOURCES / name for name in names]


def compile_drive(folder: Path, *arguments: str | Path) -> Path:
    """Link the drive with an FMU's code, beside MuJoCo's library."""
    compiled(folder, *arguments, "-o", "drive", "-lm", "-ldl")
    (folder / "libmujoco.so").symlink_to(mujoco_library())
    return folder / "drive"


@pytest.fixture(scope="module")
def layer(tmp_path_factory):
    """The FMI layer and the drive, compiled once for all."""
    folder = tmp_path_factory.mktemp("layer")
    compiled(folder, *SANITIZED, "-c", *sources(native.FMI_LAYER), DRIVE)
    return sorted(folder.glob("*.o"))


def drive(program: Path, fmu: Unpacked, calls: int, seed: int, *before: str) -> None:
    """Call functions of an FMU at random; it has to get somewhere."""
    words = [str(fmu.version), str(seed), str(calls), str(fmu.size), fmu.token, fmu.location]
    # Python does not give back what it has when a process ends.
    leaks = not (fmu.folder / "resources" / "python_host.py").exists()
    done = subprocess.run(
        [*before, program, *words],
        capture_output=True,
        check=False,
        env={"PATH": os.environ["PATH"], "ASAN_OPTIONS": f"detect_leaks={int(leaks)}"},
        timeout=3000,
    )
    assert done.returncode == 0, done.stderr.decode(errors="replace")[-4000:]
    counts = done.stdout.decode().split()
    assert int(counts[0]) > calls / 4
    assert int(counts[8]) > calls / 40, "steps"


def drive_sanitized(
    layer: list[Path], folder: Path, kind: Kind, name: str, version: int, calls: int, seed: int
) -> None:
    """Link the drive with an FMU's sources, so that sanitizers see all of them, and run it."""
    if kind == "python" and python_library() is None:
        pytest.skip("this Python has no shared library")
    backend = BACKENDS[name] if kind == "native" else "python"
    program = compile_drive(folder, *SANITIZED, *sources(native.BACKENDS[backend]), *layer)
    drive(program, unpacked(kind, name, version), calls, seed)


@pytest.mark.parametrize(
    ("kind", "name", "version"),
    [("native", "plant", 2), ("native", "controller", 3), ("native", "trajectory", 2),
     ("python", "controller", 3), ("python", "trajectory", 2)],
)  # fmt: skip
def test_random_calls_leave_an_fmu_sound(layer, tmp_path, kind, name, version):
    drive_sanitized(layer, tmp_path, kind, name, version, SHORT, 1)


@pytest.mark.long
@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize(("kind", "name"), MODELS)
def test_random_calls_leave_every_fmu_sound(layer, tmp_path, kind, name, version):
    drive_sanitized(layer, tmp_path, kind, name, version, ACCEPTANCE, 11)


def library_without_cc(backend: str) -> bytes:
    """A library that is compiled where there is no compiler but ziglang's."""
    code = (
        "import sys; from panda_cosim.fmus.build.libraries import compile_library as compiled;"
        "sys.stdout.buffer.write(compiled(sys.argv[1]))"
    )
    command = [sys.executable, "-c", code, backend]
    environment = os.environ | {"PATH": "/nowhere"}
    done = subprocess.run(command, capture_output=True, check=True, env=environment, timeout=300)
    return done.stdout


@pytest.mark.parametrize("calls", [SHORT, pytest.param(ACCEPTANCE, marks=pytest.mark.long)])
@pytest.mark.parametrize("tool", ["cc", "ziglang"])
def test_random_calls_leave_the_packages_libraries_sound(tmp_path, tool, calls):
    if tool == "ziglang" and find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    shipped = native.library("mujoco", native.this_platform())
    library = shipped.read_bytes() if tool == "cc" else library_without_cc("mujoco")
    (tmp_path / "fmu.so").write_bytes(library)
    program = compile_drive(tmp_path, *PLAIN, DRIVE, tmp_path / "fmu.so")
    for version in (2, 3):
        drive(program, unpacked("native", "plant", version), calls, 7)


@pytest.mark.skipif(shutil.which("valgrind") is None, reason="no valgrind")
def test_valgrind_finds_nothing(tmp_path):
    code = [*sources(native.FMI_LAYER), DRIVE, *sources(native.BACKENDS["player"])]
    program = compile_drive(tmp_path, *PLAIN, *code)
    checker = ("valgrind", "-q", "--error-exitcode=9", "--leak-check=full")
    for version in (2, 3):
        drive(program, unpacked("native", "trajectory", version), 400, 5, *checker)
