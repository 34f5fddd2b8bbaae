"""The C code of native FMUs under sanitizers and valgrind, driven by random calls."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import native_models
import native_probe
import native_python
import pytest
from fmu_support import compiler
from native_support import Table, library_of, mujoco_library, unpacked
from panda_cosim.fmus.build import libraries as native
from panda_cosim.fmus.sources.targets import Kind
from real_fmus import MODELS, RealFmu, real_fmu

DRIVE = Path(__file__).parent / "c_host" / "drive.c"
SANITIZED = (
    *("-g", "-O1", "-fno-sanitize-recover=all"),
    "-fsanitize=address,undefined,float-cast-overflow",
)
PLAIN = ("-g", "-O1")
CALLS = {"short": 1500, "acceptance": 100_000}
pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
]


def compiled(folder: Path, *arguments: str | Path) -> None:
    """Run the compiler in a folder."""
    tool = compiler()
    assert tool
    places = [native.SOURCES, *(f"-isystem{include}" for include in native.includes())]
    command = [tool, "-std=c11", "-I", *places, *arguments]
    subprocess.run(command, cwd=folder, check=True, timeout=300)


def of_layer() -> list[Path]:
    """Sources that every drive has: the FMI layer and the drive itself."""
    return [*(native.SOURCES / name for name in native.FMI_LAYER), DRIVE]


@pytest.fixture(scope="module")
def layer(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The FMI layer and the drive, compiled once for all sanitizers' tests."""
    folder = tmp_path_factory.mktemp("layer")
    compiled(folder, *SANITIZED, "-c", *of_layer())
    return sorted(folder.glob("*.o"))


def compile_drive(
    folder: Path, backend: Sequence[str], layer: Sequence[Path], flags: Sequence[str] = SANITIZED
) -> Path:
    """Link the drive with an FMU's sources, so that a sanitizer sees all of them."""
    sources = [native.SOURCES / name for name in backend]
    compiled(folder, *flags, *sources, *layer, "-o", "drive", "-lm", "-ldl")
    return folder / "drive"


def drive(
    program: Path,
    folder: Path,
    table: Table,
    version: int,
    calls: int,
    seed: int,
    *before: str,
    leaks: bool = True,
) -> str:
    """Run it; returns its last line."""
    size = str(max(table.references.values()) + 1)
    resources = f"file://{folder}/resources"
    words = [str(version), str(seed), str(calls), size, table.token, resources]
    done = subprocess.run(
        [*before, program, *words],
        capture_output=True,
        check=False,
        env={"PATH": os.environ["PATH"], "ASAN_OPTIONS": f"detect_leaks={int(leaks)}"},
        timeout=600,
    )
    assert done.returncode == 0, done.stderr.decode(errors="replace")[-4000:]
    return done.stdout.decode()


def drive_real(program: Path, fmu: RealFmu, calls: int, seed: int) -> None:
    """Run it with an FMU that users get; it has to get somewhere."""
    words = [str(fmu.version), str(seed), str(calls), str(fmu.size), fmu.token, fmu.location]
    leaks = fmu.backend != "python"  # Python does not give back what it has when a process ends
    done = subprocess.run(
        [program, *words],
        capture_output=True,
        check=False,
        env={"PATH": os.environ["PATH"], "ASAN_OPTIONS": f"detect_leaks={int(leaks)}"},
        timeout=3000,
    )
    assert done.returncode == 0, done.stderr.decode(errors="replace")[-4000:]
    counts = done.stdout.decode().split()
    assert int(counts[0]) > calls / 4
    assert int(counts[8]) > calls / 40, "steps"


def link_drive(folder: Path, library: bytes) -> Path:
    """Link the drive with an FMU's library, as others get it."""
    (folder / "fmu.so").write_bytes(library)
    compiled(folder, *PLAIN, DRIVE, folder / "fmu.so", "-o", "drive", "-lm")
    return folder / "drive"


def library_without_cc(backend: str) -> bytes:
    """A library that is compiled where there is no compiler but ziglang's."""
    code = (
        "import sys; from panda_cosim.fmus.build.libraries import compile_library as compiled;"
        "sys.stdout.buffer.write(compiled(sys.argv[1]))"
    )
    environment = os.environ | {"PATH": "/nowhere"}
    command = [sys.executable, "-c", code, backend]
    return subprocess.run(
        command, capture_output=True, check=True, env=environment, timeout=300
    ).stdout


@pytest.fixture(scope="module")
def probe(layer: list[Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("probe")
    fmu = unpacked(folder / "fmu", "probe", native_probe.TABLE, {}, library=b"-")
    return compile_drive(folder, (str(native_probe.SOURCE),), layer), fmu


@pytest.fixture(scope="module")
def plant(layer: list[Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("plant")
    fmu = native_models.build_plant(folder / "fmu")
    (folder / "libmujoco.so").symlink_to(mujoco_library())
    return compile_drive(folder, native.BACKENDS["mujoco"], layer), fmu


@pytest.fixture(scope="module")
def python_drive(layer: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("python")
    return compile_drive(folder, native.BACKENDS["python"], layer)


RUNS = [
    pytest.param("short"),
    pytest.param("acceptance", marks=pytest.mark.long),
]


@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize("run", RUNS)
def test_random_calls_leave_the_fmi_layer_sound(
    probe: tuple[Path, Path], run: str, version: int
) -> None:
    for seed in range(3):
        told = drive(*probe, native_probe.TABLE, version, CALLS[run], seed)
        succeeded = int(told.split()[0])
        assert succeeded > CALLS[run] / 20  # the drive gets somewhere


@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize("run", RUNS)
def test_random_calls_leave_the_plant_sound(
    plant: tuple[Path, Path], run: str, version: int
) -> None:
    told = drive(*plant, native_models.PLANT, version, CALLS[run], 1)
    assert int(told.split()[0]) > CALLS[run] / 20


@pytest.mark.skipif(
    not Path(native_python.recorded()[0][1]).is_file(), reason="this Python has no shared library"
)
@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize("run", RUNS)
def test_random_calls_leave_slaves_in_python_sound(
    python_drive: Path, tmp_path: Path, run: str, version: int
) -> None:
    for name in ("decay", "shared"):
        table = getattr(native_python, f"{name}_table")(native_python.recorded())
        fmu = native_python.build(tmp_path / name, table)
        # Python does not give back what it has when a process ends.
        told = drive(python_drive, fmu, table, version, CALLS[run], 1, leaks=False)
        assert int(told.split()[0]) > CALLS[run] / 20


def real_drive(folder: Path, fmu: RealFmu, layer: list[Path]) -> Path:
    """The drive for a real FMU."""
    (folder / "libmujoco.so").symlink_to(mujoco_library())
    return compile_drive(folder, native.BACKENDS[fmu.backend], layer)


@pytest.mark.parametrize(("name", "version"), [("controller", 3), ("trajectory", 2)])
def test_random_calls_leave_an_fmu_sound(
    layer: list[Path], tmp_path: Path, name: str, version: int
) -> None:
    fmu = real_fmu(tmp_path / "fmu", "native", name, version)
    drive_real(real_drive(tmp_path, fmu, layer), fmu, CALLS["short"], 1)


@pytest.mark.long
@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize(("kind", "name"), MODELS)
def test_random_calls_leave_every_fmu_sound(
    layer: list[Path], tmp_path: Path, kind: Kind, name: str, version: int
) -> None:
    fmu = real_fmu(tmp_path / "fmu", kind, name, version)
    drive_real(real_drive(tmp_path, fmu, layer), fmu, CALLS["acceptance"], 11)


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("tool", ["cc", "ziglang"])
def test_random_calls_leave_the_packages_libraries_sound(
    tmp_path: Path, tool: str, run: str
) -> None:
    if tool == "ziglang" and find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    made = library_of if tool == "cc" else library_without_cc
    program = link_drive(tmp_path, made("mujoco"))
    (tmp_path / "libmujoco.so").symlink_to(mujoco_library())
    fmu = native_models.build_plant(tmp_path / "fmu")
    for version in (2, 3):
        told = drive(program, fmu, native_models.PLANT, version, CALLS[run], 7)
        assert int(told.split()[0]) > CALLS[run] / 20


@pytest.mark.skipif(shutil.which("valgrind") is None, reason="no valgrind")
def test_valgrind_finds_nothing(tmp_path: Path, probe: tuple[Path, Path]) -> None:
    program = compile_drive(tmp_path, (str(native_probe.SOURCE),), of_layer(), PLAIN)
    checker = ("valgrind", "-q", "--error-exitcode=9", "--leak-check=full")
    for version in (2, 3):
        drive(program, probe[1], native_probe.TABLE, version, 400, 5, *checker)
