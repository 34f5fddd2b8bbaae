"""FMUs in a host in C that has no Python: whole tasks, first instances, what is missing."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bounded import ran
from couple_support import TABLES, compile_host, read_rows, unpack_task, write_plan
from fmu_instance import Unpacked, mujoco_library, unpacked, unpacked_fmu
from fmu_support import compiler, in_process, needs_compiler, sanitizes
from panda_cosim import Options, Recording, run_scenario
from panda_cosim.fmus.build import libraries as native
from panda_cosim.fmus.sources.python_fmu import python_library, slave_fmu

SCENARIO = "pick_and_place"
FIRST_INSTANCE = 0.050  # [s] from opening the library to the end of its initialization
DECAY = Path(__file__).parents[1] / "slaves" / "decay.py"
RACES = ("-g", "-fsanitize=thread")
pytestmark = [
    needs_compiler,
    pytest.mark.skipif(native.this_platform() != "linux64", reason="the host is for Linux x86-64"),
]
needs_library = pytest.mark.skipif(
    python_library() is None, reason="this Python has no shared library"
)


def record(out: str) -> None:
    """Run the task by our master."""
    run_scenario(SCENARIO, out, Options())


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    folder = tmp_path_factory.mktemp("master") / "run"
    in_process(record, str(folder))
    return Recording.open(folder)


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    program = tmp_path_factory.mktemp("host") / "host"
    compile_host(program, str(compiler()))
    return program


def plan_of(folder: Path, version: int, *lines: str) -> Path:
    """Write a plan."""
    path = folder / "plan"
    path.write_text("\n".join((f"fmi {version}", *lines, "")))
    return path


def source(fmu: Unpacked, library: Path | None = None) -> str:
    """What a plan says of an FMU."""
    return f"{library or fmu.library} {fmu.token} {fmu.location}"


def run(host: Path, plan: Path, **environment: str) -> tuple[list[str], str]:
    """Run the host in an environment; returns the lines that it says, and what it logs."""
    done = ran([host, plan, plan.with_name("recording")], env=environment, code=None)
    if "unexpected memory mapping" in done.stderr:
        pytest.skip("the thread sanitizer does not run on this kernel")
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout.splitlines(), done.stderr


# Native FMUs where there is nothing else.


@pytest.fixture(scope="module", params=(2, 3), ids=("fmi2", "fmi3"))
def root(request, tmp_path_factory, host):
    """A root folder with the host, the FMUs and the C library: nothing else."""
    folder = tmp_path_factory.mktemp("root")
    task = unpack_task(SCENARIO, request.param, "linux64", folder)
    shutil.copy(host, folder)
    columns = write_plan(task, folder / "plan", lambda path: f"/{path.relative_to(folder)}")
    (folder / "columns").write_text("\n".join(columns))
    for program in (folder / "host", task.library("plant").with_name("libmujoco.so")):
        listed = ran(["ldd", program]).stdout
        for library in re.findall(r"/\S+\.so[.\d]*", listed):
            place = folder / library.lstrip("/")
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(library, place)
    return folder


def run_in(root: Path) -> str:
    """Run the host in the folder as its root, with an empty environment; returns what it says."""
    enter = ["/usr/sbin/chroot", root] if os.geteuid() == 0 else ["unshare", "-r", f"--root={root}"]
    may_enter = os.geteuid() == 0 or not subprocess.run(
        ["unshare", "-r", "true"], check=False, timeout=300
    ).returncode  # fmt: skip
    if not may_enter:
        pytest.skip("another root needs unshare, or root's rights")
    done = ran([*enter, "/host", "/plan", "/recording"], env={})
    return done.stdout


def test_a_host_without_python_records_what_the_master_does(root, expected):
    assert not [path for path in root.rglob("*") if "python" in path.name.lower()]
    run_in(root)
    rows = read_rows(root / "recording", (root / "columns").read_text().split())
    recorded = set(expected.columns) - {"time"}
    assert recorded <= set(rows)  # the master leaves out what nobody asks for, such as mass_matrix
    different = [name for name in recorded if rows[name].tobytes() != expected[name].tobytes()]
    assert different == []
    assert np.ptp(rows["plant.qpos[10]"]) > 0.1  # the block has been carried


def test_the_first_instance_comes_quickly(root):
    times = []
    for _ in range(3):
        text = run_in(root)
        each = [re.findall(rf"{what} (\S+) s", text) for what in ("loaded", "initialized")]
        times.append(sum(float(seconds[list(TABLES).index("plant")]) for seconds in each))
    assert min(times) <= FIRST_INSTANCE, times


# FMUs in Python: the library starts it.


@needs_library
@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
def test_fmus_in_python_record_the_same_in_any_environment(host, expected, tmp_path, version):
    for module in ("json", "numpy", "traceback"):
        (tmp_path / f"{module}.py").write_text("raise RuntimeError('the wrong module')\n")
    poison = {"PYTHONHOME": "/nowhere", "PYTHONPATH": str(tmp_path), "PYTHONSTARTUP": "/nowhere"}
    task = unpack_task(SCENARIO, version, "linux64", tmp_path, 0.3, "python")
    columns = write_plan(task, tmp_path / "plan")
    run(host, tmp_path / "plan", **(poison if version == 3 else {}))
    for name, values in read_rows(tmp_path / "recording", columns).items():
        if name.startswith("plant.") and name in expected.columns:
            assert values.tobytes() == expected[name][: len(values)].tobytes(), name


@needs_library
def test_a_host_lives_on_after_what_is_missing(host, tmp_path):
    good = unpacked("python", "controller", 2)
    damages: dict[str, tuple[str, str]] = {  # by reason: a file that is missing, or an option
        "variables.txt cannot be read": ("variables.txt", ""),
        "python_host.py cannot be read": ("python_host.py", ""),
        "cannot start in Python": ("pandacontroller*", ""),
        "the package not_there cannot be imported: No module": ("", "need\tnot_there 1.0"),
        "is too old, 99.0 is needed": ("", "need\tnumpy 99.0"),
        "Python 3.99 or newer is needed; the one in this": ("", "minimum\t3.99"),
    }
    plan = []
    for i, (file, option) in enumerate(damages.values()):
        bad = good.copy(tmp_path / f"{i}")
        plan.append(f"try {source(bad)}")
        if option:
            bad.table.write_text(good.table.read_text().replace("\n", f"\noption\t{option}\n", 1))
        else:
            (missing,) = (bad.folder / "resources").glob(file)
            missing.rename(tmp_path / f"gone{i}")
    lines, log = run(host, plan_of(tmp_path, 2, *plan, f"try {source(good)}"))
    assert lines == ["refused"] * len(plan) + ["made"]
    assert [reason for reason in damages if reason not in log] == []


@pytest.mark.parametrize(
    ("library", "reason"),
    [("", "this process has no Python, and none was recorded"),
     ("option\tpython\t/nowhere/libpython3.so\n", "/nowhere/libpython3.so: cannot open")],
)  # fmt: skip
def test_a_host_is_told_where_python_was_sought(host, tmp_path, library, reason):
    fmu = unpacked("python", "controller", 3).copy(
        tmp_path / "fmu", lambda text: library + re.sub(r"option\tpython\t.*\n", "", text)
    )
    lines, log = run(host, plan_of(tmp_path, 3, f"try {source(fmu)}"))
    assert lines == ["refused"]
    assert reason in log


@needs_library
def test_packages_can_be_named_by_the_environment(host, tmp_path):
    (tmp_path / "numpy.py").write_text("__version__ = '1.26.4'\n")
    plan = plan_of(tmp_path, 3, f"try {source(unpacked('python', 'controller', 3))}")
    lines, log = run(host, plan, PANDA_COSIM_PYTHONPATH=str(tmp_path))
    assert lines == ["refused"]
    assert "numpy 1.26.4" in log
    assert "is too old, 2.3 is needed" in log
    _, log = run(host, plan, PANDA_COSIM_PYTHONPATH="/nowhere")
    assert "set PANDA_COSIM_PYTHONPATH to the folder that holds them" in log


# Threads that make the first instances of a process at one moment.


@needs_library
def test_fmus_in_python_may_be_first_at_one_moment(host, tmp_path):
    """Only one starts Python, although each has its own copy of the library."""
    fmus = [unpacked_fmu(slave_fmu(DECAY)), unpacked("python", "controller", 2)]
    plan = plan_of(tmp_path, 2, f"at-once 2 {' '.join(map(source, fmus))}")
    for _ in range(3):
        assert run(host, plan)[0] == ["made", "made"]


@pytest.mark.parametrize("backend", ["mujoco", pytest.param("python", marks=needs_library)])
def test_first_instances_of_an_fmu_do_not_race(tmp_path, backend):
    if not sanitizes():
        pytest.skip("ziglang brings no sanitizers")
    library, program = tmp_path / "fmu.so", tmp_path / "host"
    sources = [native.SOURCES / name for name in (*native.FMI_LAYER, *native.BACKENDS[backend])]
    includes = [f"-isystem{include}" for include in native.includes()]
    flags = ["-std=gnu11", "-I", native.SOURCES, *includes, *RACES, "-fPIC", "-shared"]
    command = [str(compiler()), *flags, *sources, "-o", library, "-ldl", "-lpthread", "-lm"]
    subprocess.run(command, check=True, timeout=300)
    compile_host(program, str(compiler()), *RACES)
    (tmp_path / "libmujoco.so").symlink_to(mujoco_library())
    fmu = unpacked("native" if backend == "mujoco" else "python", "plant", 2)
    plan = plan_of(tmp_path, 2, "at-once 3", *[source(fmu, library)] * 3)
    assert run(program, plan, TSAN_OPTIONS="ignore_noninstrumented_modules=1")[0] == ["made"] * 3


@needs_library
def test_a_python_that_another_fmu_has_started_is_no_hosts(host, tmp_path):
    """MuJoCo's import starts `python3` to look for OpenGL, unless it is told not to."""
    (tmp_path / "python3").write_text(f"#!/bin/sh\ntouch {tmp_path}/started\n")
    (tmp_path / "python3").chmod(0o755)
    fmus = [unpacked_fmu(slave_fmu(DECAY)), unpacked("python", "plant", 2)]
    plan = plan_of(tmp_path, 2, *(f"try {source(fmu)}" for fmu in fmus))
    assert run(host, plan, PATH=str(tmp_path))[0] == ["made", "made"]
    assert not (tmp_path / "started").exists()
