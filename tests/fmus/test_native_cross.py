"""The native FMUs on other platforms, under Wine and QEMU where these are there."""

import os
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import mach_o
from bounded import ran
from couple_support import compile_host, read_rows, unpack_task, write_plan
from panda_cosim.fmus.build import libraries as native
from panda_cosim.fmus.build.libraries import mujoco_library
from panda_cosim.fmus.errors import CosimError

Columns = dict[str, NDArray[np.float64]]
SCENARIO = "pick_and_place"
PLACE = (0.60, 0.35, 0.25)  # [m] where that puts the block's centre
ON_PLACE = 2e-3  # [m] as in the scenario
SET_OUT = 0.2  # [s] when the arm moves
GRIPPED = 2.2  # [s] when the fingers hold the block
TOLERANCE = 1e-4  # [m, rad] between platforms, all the way
ARM_ROOT = Path("/usr/aarch64-linux-gnu")  # Debian's libc6-arm64-cross
pytestmark = pytest.mark.skipif(find_spec("ziglang") is None, reason="ziglang is not installed")


def wine() -> str | None:
    """Path of Wine, which Debian's wine64 alone does not put on the path."""
    beside = "/usr/lib/wine/wine64"
    return shutil.which("wine64") or (beside if Path(beside).is_file() else None)


def runner(platform: str) -> list[str]:
    """What runs a platform's programs here; skips where there is none."""
    qemu, found = shutil.which("qemu-aarch64"), wine()
    if platform == "linux-arm64":
        if qemu is None or not ARM_ROOT.is_dir():
            pytest.skip("qemu-user or libc6-arm64-cross is not installed")
        return [qemu, "-L", str(ARM_ROOT)]
    if platform == "win64":
        if found is None:
            pytest.skip("Wine is not installed")
        return [found]
    return []


def foreign(platform: str, path: Path) -> str:
    """A path as the platform's programs have it."""
    return f"Z:{path}".replace("/", "\\") if platform == "win64" else str(path)


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    """Wine's folder for all tests: to make one takes seconds."""
    return tmp_path_factory.mktemp("wine")


def recorded(
    platform: str, fmi: int, folder: Path, prefix: Path, until: float | None = None
) -> Columns:
    """Build the FMUs and a host for a platform, and couple them until then [s], or to the end."""
    before = runner(platform)
    try:
        task = unpack_task(SCENARIO, fmi, platform, folder / "fmus", until)
    except CosimError as error:
        pytest.skip(f"MuJoCo's library for {platform} cannot be had: {error}")
    program = folder / ("host.exe" if platform == "win64" else "host")
    target = native.PLATFORMS[platform].target
    compile_host(program, sys.executable, "-m", "ziglang", "cc", "-target", target)
    columns = write_plan(task, folder / "plan", lambda path: foreign(platform, path))
    ran(
        [*before, program, *(foreign(platform, folder / name) for name in ("plan", "recording"))],
        env=os.environ | {"WINEPREFIX": str(prefix), "WINEDEBUG": "-all"},
        timeout=600,
    )
    return read_rows(folder / "recording", columns)


@pytest.fixture(scope="module")
def here(tmp_path_factory, prefix):
    return recorded("linux64", 2, tmp_path_factory.mktemp("here"), prefix)


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="Wine and QEMU are used on Linux")
@pytest.mark.parametrize(("platform", "fmi"), [("win64", 3), ("linux-arm64", 2)])
def test_the_arm_sets_out_as_it_does_here(platform, fmi, prefix, tmp_path):
    (tmp_path / "here").mkdir()
    here = recorded("linux64", fmi, tmp_path / "here", prefix, SET_OUT)
    there = recorded(platform, fmi, tmp_path, prefix, SET_OUT)
    for name in (f"plant.qpos[{i}]" for i in range(1, 17)):
        np.testing.assert_allclose(there[name], here[name], rtol=0.0, atol=TOLERANCE)
    assert np.ptp(there["plant.qpos[4]"]) > 100 * TOLERANCE


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="Wine and QEMU are used on Linux")
@pytest.mark.parametrize("fmi", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize("platform", ["win64", "linux-arm64"])
def test_the_task_ends_as_it_does_here(platform, fmi, here, prefix, tmp_path):
    there = recorded(platform, fmi, tmp_path, prefix)
    for name in (f"plant.qpos[{i}]" for i in range(1, 17)):
        np.testing.assert_allclose(there[name], here[name], rtol=0.0, atol=TOLERANCE)
    tick = round(GRIPPED / 0.001)
    force = here["plant.contact_force"][tick]
    assert force > 5.0  # N
    assert there["plant.contact_force"][tick] == pytest.approx(force, rel=1e-3)
    end = [there[f"plant.qpos[{i}]"][-1] for i in (10, 11, 12)]
    np.testing.assert_allclose(end, PLACE, rtol=0.0, atol=ON_PLACE)


def compiled(backend: str, platform: str) -> bytes:
    """A backend's library for a platform, as it was compiled from these sources, now or before."""
    return native.library(backend, platform).read_bytes()


def quick(name: str) -> object:
    """What is fast in each run of the tests; the rest takes minutes to compile, at first."""
    return name if name not in SLOW else pytest.param(name, marks=pytest.mark.long)


SLOW = {"win64", *native.BACKENDS} - {"player"}


@pytest.mark.parametrize("platform", [quick(p) for p in native.PLATFORMS])
@pytest.mark.parametrize("backend", [quick(b) for b in native.BACKENDS])
def test_every_backend_is_built_for_every_platform(backend, platform):
    library = compiled(backend, platform)
    if backend == "player":
        assert native.compile_library(backend, platform) == library  # the same bytes again
    magic = {"linux64": b"\x7fELF", "linux-arm64": b"\x7fELF", "win64": b"MZ"}
    assert library.startswith(magic.get(platform, b"\xcf\xfa\xed\xfe"))  # else Mach-O, 64 bits
    names = (b"panda_take_steps",) if backend == native.STEPPER else (b"fmi2DoStep", b"fmi3DoStep")
    assert all(name in library for name in names)


MACS = {"darwin64": mach_o.X86_64, "darwin-arm64": mach_o.ARM64}
OF_MACOS = {"/usr/lib/libSystem.B.dylib", "/usr/lib/libc++.1.dylib"}


@pytest.mark.parametrize("platform", MACS)
@pytest.mark.parametrize("backend", [quick(b) for b in native.BACKENDS if b != native.STEPPER])
def test_load_commands_are_those_that_a_mac_takes(backend, platform):
    found = mach_o.read(compiled(backend, platform))
    assert (found.processor, found.kind) == (MACS[platform], mach_o.DYLIB)
    assert (found.platform, found.minimum) == (mach_o.MACOS, (11, 0))
    assert found.name == "@rpath/fmu.dylib"
    assert set(found.needs) <= OF_MACOS
    assert found.signed or platform == "darwin64"
    assert {"_fmi2Instantiate", "_fmi2DoStep", "_fmi3InstantiateCoSimulation"} <= found.exports
    others = found.exports - {"___dso_handle", "__mh_dylib_header"}  # the linker's own
    assert all(name.startswith(("_fmi2", "_fmi3")) for name in others)


def test_mujocos_library_for_macs_needs_nothing_else():
    try:
        library = mujoco_library("darwin64")
    except CosimError as error:
        pytest.skip(f"MuJoCo's library for macOS cannot be had: {error}")
    found = {part.processor: part for part in mach_o.slices(library)}
    assert set(found) == set(MACS.values())
    for part in found.values():
        assert part.signed or part.processor == mach_o.X86_64
        assert set(part.needs) <= OF_MACOS
        assert "_mj_step" in part.exports
