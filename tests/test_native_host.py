"""The native FMUs where there is no Python: a plain host in C couples them over a whole task."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from couple_support import TABLES, compile_couple_host, read_rows, unpack_task, write_plan
from fmu_support import compiler, in_process
from panda_cosim.fmus.build.libraries import this_platform
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.run.options import Options
from panda_cosim.scenarios.run.run import run_scenario

SCENARIO = "pick_and_place"
FIRST_INSTANCE = 0.050  # [s] from opening the library to the end of its initialization
PLANT = list(TABLES).index("plant")
pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
    pytest.mark.skipif(this_platform() != "linux64", reason="the folder is made for Linux x86-64"),
]


def record(out: str) -> None:
    """Run the task by our master."""
    run_scenario(SCENARIO, out, Options())


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("master") / "run"
    in_process(record, str(folder))
    return Recording.open(folder)


@pytest.fixture(scope="module", params=(2, 3), ids=("fmi2", "fmi3"))
def root(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A root folder with the host, the FMUs and the C library: nothing else."""
    folder = tmp_path_factory.mktemp("root")
    task = unpack_task(SCENARIO, request.param, "linux64", folder)
    compile_couple_host(folder / "host", str(compiler()))
    columns = write_plan(task, folder / "plan", lambda path: f"/{path.relative_to(folder)}")
    (folder / "columns").write_text("\n".join(columns))
    for program in (folder / "host", task.library("plant").with_name("libmujoco.so")):
        told = subprocess.run(
            ["ldd", program], capture_output=True, text=True, check=True, timeout=300
        ).stdout
        for library in re.findall(r"/\S+\.so[.\d]*", told):
            place = folder / library.lstrip("/")
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(library, place)
    return folder


def run_in(root: Path) -> str:
    """Run the host in the folder as its root, with an empty environment; returns what it tells."""
    enter = ["/usr/sbin/chroot", root] if os.geteuid() == 0 else ["unshare", "-r", f"--root={root}"]
    if (
        os.geteuid()
        and subprocess.run(["unshare", "-r", "true"], check=False, timeout=300).returncode
    ):
        pytest.skip("another root needs unshare, or root's rights")
    done = subprocess.run(
        [*enter, "/host", "/plan", "/recording"],
        env={},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_host_without_python_records_what_the_master_does(
    root: Path, expected: Recording
) -> None:
    assert not [path for path in root.rglob("*") if "python" in path.name.lower()]
    run_in(root)
    rows = read_rows(root / "recording", (root / "columns").read_text().split())
    recorded = set(expected.columns) - {"time"}
    assert recorded <= set(rows)  # the master leaves out what nobody asks for, such as mass_matrix
    different = [name for name in recorded if rows[name].tobytes() != expected[name].tobytes()]
    assert different == []
    assert np.ptp(rows["plant.qpos[10]"]) > 0.1  # the block has been carried


def test_the_first_instance_comes_quickly(root: Path) -> None:
    times = []
    for _ in range(3):
        told = run_in(root)
        each = [re.findall(rf"{what} (\S+) s", told) for what in ("loaded", "initialized")]
        times.append(sum(float(seconds[PLANT]) for seconds in each))
    assert min(times) <= FIRST_INSTANCE, times
