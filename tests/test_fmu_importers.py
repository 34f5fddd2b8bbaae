"""The coupled system in other people's importers: they agree with our master."""

from __future__ import annotations

import os
import shutil
import subprocess
import zipfile
from importlib.metadata import PackageNotFoundError, files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import fmu_importers
import numpy as np
import pytest
from fmu_support import HOST_SOURCE, compiler, in_process
from panda_cosim.fmus.build.ssp import write_panda_ssp
from panda_cosim.fmus.sources.targets import build, build_trajectory
from panda_cosim.scenarios.run.start import instants, resolve, start_values
from panda_cosim.scenarios.scenario.scenario import load_scenario

TICKS = 300
TOLERANCE = 1e-12  # [1] largest relative difference
pytestmark = pytest.mark.fmu
needs_libcosim = pytest.mark.skipif(find_spec("libcosimpy") is None, reason="no libcosimpy")
needs_ecos = pytest.mark.skipif(find_spec("ecospy") is None, reason="no ecospy")


@pytest.fixture(scope="module")
def ssp(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The system, with a task that has moved on to where it gets interesting."""
    scenario = load_scenario("pick_and_place")
    values = start_values(scenario)
    commands = resolve(scenario, values).sample(instants(scenario))
    fmus = build() | {"trajectory": build_trajectory(commands)}
    folder = tmp_path_factory.mktemp("importers")
    return str(write_panda_ssp(folder / "Panda.ssp", fmus, None, scenario.duration))


@pytest.fixture(scope="module")
def expected(ssp: str) -> Any:
    return np.array(in_process(fmu_importers.ours, ssp, TICKS, "jacobi"))


def library_path() -> str:
    """Folder of oneTBB's library, which Ecos needs, for the loader."""
    try:
        found = [f for f in files("tbb") or [] if f.name.startswith("libtbb.so")]
    except PackageNotFoundError:
        found = []
    own = [str(Path(str(f.locate())).resolve().parent) for f in found[:1]]
    return os.pathsep.join([*own, os.environ.get("LD_LIBRARY_PATH", "")])


def package_folder(name: str) -> Path:
    """Folder of an installed package, without importing it."""
    spec = find_spec(name)
    assert spec
    assert spec.origin
    return Path(spec.origin).parent


def check(got: Any, expected: Any) -> None:
    np.testing.assert_allclose(np.array(got), expected, rtol=TOLERANCE, atol=TOLERANCE)


@needs_libcosim
def test_libcosim_in_python_agrees(ssp: str, expected: Any, tmp_path: Path) -> None:
    check(in_process(fmu_importers.libcosim, ssp, TICKS, str(tmp_path)), expected)


@needs_ecos
def test_ecos_in_python_agrees(ssp: str, expected: Any) -> None:
    rows = in_process(fmu_importers.ecos, ssp, TICKS, LD_LIBRARY_PATH=library_path())
    check(rows, expected)


@needs_libcosim
@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_libcosim_in_c_agrees(ssp: str, expected: Any, tmp_path: Path) -> None:
    program, folder = tmp_path / "host", tmp_path / "system"
    source = HOST_SOURCE.with_name("libcosim_host.c")
    subprocess.run([str(compiler()), "-o", program, source, "-ldl"], check=True, timeout=300)
    with zipfile.ZipFile(ssp) as archive:
        archive.extractall(folder)
    library = package_folder("libcosimpy") / "libcosimc" / "libcosimc.so"
    references = fmu_importers.plant_outputs(ssp).values()
    child = subprocess.run(
        [program, library, folder, str(TICKS), "plant", *map(str, references)],
        env={}, capture_output=True, text=True, check=False,
    timeout=300,)  # fmt: skip
    # libcosim's own messages begin with a bracket.
    lines = [line for line in child.stdout.splitlines() if "0x" in line and line[0] != "["]
    assert child.returncode == 0, child.stderr[-3000:]
    check([[float.fromhex(x) for x in line.split()] for line in lines], expected)


@needs_ecos
def test_the_ecos_program_runs_it(ssp: str, expected: Any, tmp_path: Path) -> None:
    folder = tmp_path / "binaries"
    shutil.copytree(package_folder("ecospy") / "binaries", folder)
    (folder / "ecos").chmod(0o755)
    stop = str((TICKS + 5) * 0.001)
    command = ["simulate", "--path", ssp, "--stopTime", stop, "--stepSize", "0.001"]
    child = subprocess.run(
        [folder / "ecos", *command],
        env={"LD_LIBRARY_PATH": os.pathsep.join([library_path(), str(folder)])},
        cwd=tmp_path, capture_output=True, text=True, check=False,
    timeout=300,)  # fmt: skip
    assert child.returncode == 0, child.stdout[-3000:] + child.stderr[-3000:]
    lines = (tmp_path / "Panda.csv").read_text().splitlines()
    header = lines[0].split(", ")
    last = next(row for row in (line.split(", ") for line in lines) if row[0] == str(TICKS))
    for i, name in enumerate(fmu_importers.plant_outputs(ssp)):
        written = float(last[header.index(f"plant::{name}[REAL]")])
        # The file has six digits.
        assert written == pytest.approx(expected[-1][i], rel=1e-4, abs=1e-5)


def test_fmpy_runs_it_though_it_sends_zeros_first(ssp: str, expected: Any) -> None:
    rows = np.array(in_process(fmu_importers.fmpy, ssp, TICKS))
    names = list(fmu_importers.plant_outputs(ssp))
    hand = [names.index(f"hand_xpos[{i}]") for i in (1, 2, 3)]
    assert np.abs(rows[-1, hand] - expected[-1, hand]).max() < 1e-4  # [m]


@pytest.mark.skipif(find_spec("pyssp_standard") is None, reason="no pyssp_standard")
def test_pyssp_finds_nothing_to_complain_of(ssp: str) -> None:
    in_process(fmu_importers.pyssp, ssp)
