"""The C code of native FMUs under sanitizers and valgrind, driven by random calls."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import native_models
import native_player
import native_probe
import native_python
import pytest
from fmu_support import compiler
from native_support import Table, mujoco_library, unpacked
from panda_cosim.fmus.packaging import compile as native

DRIVE = Path(__file__).parent / "c_host" / "drive.c"
SANITIZED = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
PLAIN = ("-g", "-O1")
CALLS = {"short": 4000, "acceptance": 100_000}
pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
]


def compile_drive(folder: Path, sources: Sequence[str], flags: Sequence[str]) -> Path:
    """Link the drive with an FMU's sources, so that a sanitizer sees all of them."""
    program = folder / "drive"
    includes = [f"-isystem{include}" for include in native.includes()]
    tool = compiler()
    assert tool
    command = [tool, "-std=c11", *flags, "-I.", *includes, *native.FMI_LAYER, *sources, str(DRIVE)]
    subprocess.run([*command, "-o", program, "-lm", "-ldl"], cwd=native.SOURCES, check=True)
    return program


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


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("probe")
    fmu = unpacked(folder / "fmu", "probe", native_probe.TABLE, {}, library=b"-")
    return compile_drive(folder, (str(native_probe.SOURCE),), SANITIZED), fmu


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("plant")
    fmu = native_models.build_plant(folder / "fmu")
    (folder / "libmujoco.so").symlink_to(mujoco_library())
    return compile_drive(folder, native.BACKENDS["mujoco"], SANITIZED), fmu


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


@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize("run", RUNS)
def test_random_calls_leave_the_player_sound(tmp_path: Path, run: str, version: int) -> None:
    fmu = native_player.build(tmp_path / "fmu")
    program = compile_drive(tmp_path, native.BACKENDS["player"], SANITIZED)
    told = drive(program, fmu, native_player.TABLE, version, CALLS[run], 1)
    assert int(told.split()[0]) > CALLS[run] / 20


@pytest.mark.skipif(
    not Path(native_python.recorded()[0][1]).is_file(), reason="this Python has no shared library"
)
@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize("run", RUNS)
def test_random_calls_leave_slaves_in_python_sound(tmp_path: Path, run: str, version: int) -> None:
    program = compile_drive(tmp_path, native.BACKENDS["python"], SANITIZED)
    for name in ("decay", "shared"):
        table = getattr(native_python, f"{name}_table")(native_python.recorded())
        fmu = native_python.build(tmp_path / name, table)
        # Python does not give back what it has when a process ends.
        told = drive(program, fmu, table, version, CALLS[run], 1, leaks=False)
        assert int(told.split()[0]) > CALLS[run] / 20


@pytest.mark.skipif(shutil.which("valgrind") is None, reason="no valgrind")
def test_valgrind_finds_nothing(tmp_path: Path, probe: tuple[Path, Path]) -> None:
    program = compile_drive(tmp_path, (str(native_probe.SOURCE),), PLAIN)
    checker = ("valgrind", "-q", "--error-exitcode=9", "--leak-check=full")
    for version in (2, 3):
        drive(program, probe[1], native_probe.TABLE, version, 2000, 5, *checker)


@pytest.mark.parametrize(
    ("build", "table"),
    [
        (native_models.build_plant, native_models.PLANT),
        (native_player.build, native_player.TABLE),
    ],
    ids=["plant", "player"],
)
def test_a_host_with_traps_small_stacks_and_reloads_is_served(
    tmp_path: Path, build: Callable[[Path], Path], table: Table
) -> None:
    fmu = build(tmp_path / "fmu")
    host, tool = tmp_path / "harsh_host", compiler()
    assert tool
    includes = [f"-isystem{include}" for include in native.includes()]
    source = str(DRIVE.with_name("harsh_host.c"))
    libraries = ["-ldl", "-lpthread", "-lm"]
    subprocess.run([tool, "-std=gnu11", *includes, source, "-o", host, *libraries], check=True)
    place = native.PLATFORMS[native.this_platform()]
    library = fmu / "binaries" / place.fmi3 / f"Model{place.suffix}"
    words = [str(library), table.token, f"{fmu}/resources/", "5"]
    done = subprocess.run([host, *words], capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stdout) == (0, "whole\n"), done.stderr
