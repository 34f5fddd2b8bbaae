"""The native plant on other platforms, under Wine and QEMU where these are there."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import native_models
import pytest
from panda_cosim.fmus.errors import CosimError
from panda_cosim.fmus.packaging import compile as native
from panda_cosim.fmus.packaging.libraries import mujoco_library

HOST = Path(__file__).parent / "c_host" / "cross_host.c"
STEPS = 1000
TOLERANCE = 1e-4  # [m, rad] between platforms
ARM_ROOT = Path("/usr/aarch64-linux-gnu")  # Debian's libc6-arm64-cross
pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(find_spec("ziglang") is None, reason="ziglang is not installed"),
]


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


def final_qpos(platform: str, folder: Path) -> list[float]:
    """Build the plant and a host for a platform, and run them."""
    target = native.PLATFORMS[platform]
    before = runner(platform)
    try:
        library = mujoco_library(platform)
    except CosimError as error:
        pytest.skip(f"MuJoCo's library for {platform} cannot be had: {error}")
    folder.mkdir()
    resources = native_models.build_plant(folder / "fmu") / "resources"
    fmu = folder / f"fmu{target.suffix}"
    fmu.write_bytes(native.compile_library("mujoco", platform))
    (folder / target.mujoco).write_bytes(library)
    program = folder / ("host.exe" if platform == "win64" else "host")
    includes = [f"-isystem{include}" for include in native._includes()]
    libraries = [] if platform == "win64" else ["-ldl", "-lm"]
    tool = [sys.executable, "-m", "ziglang", "cc", "-target", target.target, "-O1"]
    subprocess.run([*tool, *includes, str(HOST), "-o", program, *libraries], check=True)
    words = (foreign(platform, fmu), native_models.PLANT.token, foreign(platform, resources))
    done = subprocess.run(
        [*before, program, *words, str(STEPS)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"WINEPREFIX": str(folder / "wine"), "WINEDEBUG": "-all"},
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return [float(line) for line in done.stdout.split()]


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> list[float]:
    return final_qpos("linux64", tmp_path_factory.mktemp("here") / "linux64")


@pytest.mark.skipif(sys.platform != "linux", reason="Wine and QEMU are used on Linux")
@pytest.mark.parametrize("platform", ["win64", "linux-arm64"])
def test_the_plant_ends_where_it_does_here(
    platform: str, here: list[float], tmp_path: Path
) -> None:
    there = final_qpos(platform, tmp_path / platform)
    assert len(there) == 16
    assert there == pytest.approx(here, abs=TOLERANCE, rel=0.0)


@pytest.mark.parametrize("platform", native.PLATFORMS)
@pytest.mark.parametrize("backend", native.BACKENDS)
def test_every_backend_is_built_for_every_platform(backend: str, platform: str) -> None:
    library = native.compile_library(backend, platform)
    magic = {"linux64": b"\x7fELF", "linux-arm64": b"\x7fELF", "win64": b"MZ"}
    assert library.startswith(magic.get(platform, b"\xcf\xfa\xed\xfe"))  # else Mach-O, 64 bits
    for name in (b"fmi2DoStep", b"fmi3DoStep"):
        assert name in library
