"""The C code of native FMUs under sanitizers and valgrind, driven by random calls."""

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from bounded import ran
from fmu_instance import BACKENDS, MJCF, MODELS, Unpacked, mujoco_library, unpacked, with_content
from fmu_support import compiler, needs_compiler, sanitizes
from panda_cosim.fmus.build import libraries as native
from panda_cosim.fmus.sources.model_fmu import ModelOptions, model_fmu
from panda_cosim.fmus.sources.python_fmu import python_library
from panda_cosim.fmus.sources.targets import Kind

DRIVE = Path(__file__).parents[1] / "c_host" / "drive.c"
SANITIZED = (
    *("-g", "-O1", "-fno-sanitize-recover=all"),
    "-fsanitize=address,undefined,float-cast-overflow",
)
PLAIN = ("-g", "-O1")
SHORT, ACCEPTANCE = 1000, 100_000  # calls
QUICK: list[tuple[Kind, str, int]] = [
    ("native", "plant", 2), ("native", "controller", 3), ("native", "trajectory", 2),
    ("python", "trajectory", 2),
]  # fmt: skip
LONG = pytest.mark.long
EVERY = [pytest.param(*model, fmi, True, marks=LONG) for model in MODELS for fmi in (2, 3)]
each_fmu = pytest.mark.parametrize(
    ("kind", "name", "version", "is_long"), [*((*each, False) for each in QUICK), *EVERY]
)
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
    if not sanitizes():
        pytest.skip("ziglang brings no sanitizers")
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
    assert int(counts[8]) > calls / 100, "steps"


def skip_without_library(kind: Kind) -> None:
    """An FMU in Python needs a Python that a C host can load."""
    if kind == "python" and python_library() is None:
        pytest.skip("this Python has no shared library")


@each_fmu
def test_random_calls_leave_an_fmu_sound(layer, tmp_path, kind, name, version, is_long):
    """It is linked with the drive, so that sanitizers see all of its sources."""
    skip_without_library(kind)
    backend = BACKENDS[name] if kind == "native" else "python"
    program = compile_drive(tmp_path, *SANITIZED, *sources(native.BACKENDS[backend]), *layer)
    drive(program, unpacked(kind, name, version), *((ACCEPTANCE, 11) if is_long else (SHORT, 1)))


def test_random_calls_leave_a_model_with_keyframes_and_mocap_bodies_sound(layer, tmp_path):
    inputs = ["body m mocap_pos", "equality w active"]
    fmu = model_fmu(MJCF.with_name("keyed.xml"), ModelOptions("home", inputs), "Other")
    program = compile_drive(tmp_path, *SANITIZED, *sources(native.BACKENDS["mujoco"]), *layer)
    drive(program, with_content(fmu, tmp_path / "fmu", 3), SHORT, 3)


def library_without_cc(backend: str) -> bytes:
    """A library that is compiled where there is no compiler but ziglang's."""
    code = (
        "import sys; from panda_cosim.fmus.build.libraries import compile_library as compiled;"
        "sys.stdout.buffer.write(compiled(*sys.argv[1:]))"
    )
    command = [sys.executable, "-c", code, backend, native.this_platform()]
    environment = os.environ | {"PATH": "/nowhere"}
    done = subprocess.run(command, capture_output=True, check=True, env=environment, timeout=300)
    return done.stdout


@pytest.mark.parametrize("calls", [SHORT, pytest.param(ACCEPTANCE, marks=LONG)])
@pytest.mark.parametrize("tool", ["cc", pytest.param("ziglang", marks=LONG)])
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


# Hosts in C that make it hard for an FMU: they get the bits of an undisturbed run, or a reason.


SOURCE = Path(__file__).parents[1] / "c_host" / "stress.c"
EASY = ("arithmetic", "comma", "two")  # without a number
# Rounds, kilobytes, instances or allocations: in the suite (0: not), and in long runs.
WAYS = {
    "native": {"threads": (1, 20), "stack": (64, 64), "churn": (50, 20_000),
               "starved": (1, 1)},
    "python": {"threads": (1, 5), "stack": (64, 64), "churn": (0, 2000)},
}  # fmt: skip
COMMA = 'LC_NUMERIC\ndecimal_point ","\nthousands_sep ""\ngrouping -1\nEND LC_NUMERIC\n'
GROWTH = 1000  # KB at most, in the second half: Python collects its garbage now and then


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    """The host, and a locale with a decimal comma in its folder."""
    folder = tmp_path_factory.mktemp("host")
    program = folder / "stress"
    compiled(folder, "-std=gnu11", SOURCE, "-o", program, "-ldl", "-lpthread", "-lm")
    (folder / "comma.src").write_text(COMMA)
    words = ["-c", "--no-archive", "-i", "comma.src", "-f", "ANSI_X3.4-1968", "./comma"]
    # It warns, with status 1.
    subprocess.run(["localedef", *words], cwd=folder, check=False, stderr=-3, timeout=300)
    if not (folder / "comma" / "LC_NUMERIC").is_file():
        pytest.skip("localedef has no character map here: install the package locales")
    return program


def stress(host: Path, fmu: Unpacked, way: str, number: int = 0, **environment: str) -> str:
    """Run it; returns what it says."""
    words = [fmu.token, fmu.location, fmu.reals("input"), fmu.reals("output"), way, str(number)]
    done = ran(
        [host, str(fmu.version), fmu.library, *words],
        env=os.environ | {"LOCPATH": str(host.parent)} | environment,
        timeout=1500,
    )
    return done.stdout


@pytest.mark.skipif(native.this_platform() != "linux64", reason="the host is for Linux")
@each_fmu
def test_a_hard_host_is_served(host, kind, name, version, is_long):
    skip_without_library(kind)
    fmu = unpacked(kind, name, version)
    for way in EASY:
        stress(host, fmu, way)
    for way, numbers in WAYS[kind].items():
        said = stress(host, fmu, way, numbers[is_long]) if numbers[is_long] else ""
        if way == "churn" and is_long:
            assert int(said.split("grown by ")[1].split()[0]) < GROWTH, said


OTHER_MUJOCO = """
#include <stdlib.h>
void mj_forwardSkip(void) { abort(); }
void mj_markStack(void) { abort(); }
void mju_dispatch(void) { abort(); }
"""


@pytest.mark.skipif(native.this_platform() != "linux64", reason="the host is for Linux")
@pytest.mark.parametrize("name", ["plant", "controller"])
def test_the_functions_of_a_hosts_own_mujoco_are_not_called(host, tmp_path, name):
    """The host is linked with another version; here its functions are nothing but traps."""
    source, other = tmp_path / "other.c", tmp_path / "libother.so"
    source.write_text(OTHER_MUJOCO)
    compiled(tmp_path, "-shared", "-fPIC", source, "-o", other)
    fmu = unpacked("native", name, 2)
    stress(host, fmu, "threads", 1, LD_PRELOAD=str(other))
