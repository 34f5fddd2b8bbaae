"""Hosts in C that make it hard for an FMU: they get the bits of an undisturbed run, or a reason."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from bounded import ran
from fmu_instance import MODELS, Unpacked, unpacked
from fmu_support import compiler, needs_compiler
from panda_cosim.fmus.build import libraries as native
from panda_cosim.fmus.sources.python_fmu import python_library
from panda_cosim.fmus.sources.targets import Kind

SOURCE = Path(__file__).parent / "c_host" / "stress.c"
EASY = ("arithmetic", "comma", "two")  # without a number
# Rounds, kilobytes, instances or allocations: in the suite (0: not), and in long runs.
WAYS = {
    "native": {"threads": (1, 20), "stack": (64, 64), "churn": (50, 20_000),
               "starved": (1, 1)},
    "python": {"threads": (1, 5), "stack": (64, 64), "churn": (0, 2000)},
}  # fmt: skip
COMMA = 'LC_NUMERIC\ndecimal_point ","\nthousands_sep ""\ngrouping -1\nEND LC_NUMERIC\n'
GROWTH = 1000  # KB at most, in the second half: Python collects its garbage now and then
pytestmark = [
    needs_compiler,
    pytest.mark.skipif(native.this_platform() != "linux64", reason="the host is for Linux"),
]


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    """The host, and a locale with a decimal comma in its folder."""
    folder, tool = tmp_path_factory.mktemp("host"), compiler()
    assert tool
    includes = [f"-isystem{include}" for include in native.includes()]
    libraries = ["-ldl", "-lpthread", "-lm"]
    program = folder / "stress"
    subprocess.run(
        [tool, "-std=gnu11", *includes, SOURCE, "-o", program, *libraries], check=True, timeout=300
    )
    (folder / "comma.src").write_text(COMMA)
    words = ["-c", "--no-archive", "-i", "comma.src", "-f", "ANSI_X3.4-1968", "./comma"]
    # It warns, with status 1.
    subprocess.run(["localedef", *words], cwd=folder, check=False, stderr=-3, timeout=300)
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


def every_way(host: Path, fmu: Unpacked, kind: Kind, column: int) -> None:
    """Take all ways."""
    for way in EASY:
        stress(host, fmu, way)
    for way, numbers in WAYS[kind].items():
        said = stress(host, fmu, way, numbers[column]) if numbers[column] else ""
        if way == "churn" and column:
            assert int(said.split("grown by ")[1].split()[0]) < GROWTH, said


def skip_without_library(kind: Kind) -> None:
    """An FMU in Python needs a Python that a C host can load."""
    if kind == "python" and python_library() is None:
        pytest.skip("this Python has no shared library")


@pytest.mark.parametrize(
    ("kind", "name", "version"),
    [("native", "plant", 3), ("native", "controller", 2), ("native", "trajectory", 3),
     ("python", "trajectory", 2)],
)  # fmt: skip
def test_a_hard_host_is_served(host, kind, name, version):
    skip_without_library(kind)
    every_way(host, unpacked(kind, name, version), kind, 0)


OTHER_MUJOCO = """
#include <stdlib.h>
void mj_forwardSkip(void) { abort(); }
void mj_markStack(void) { abort(); }
void mju_dispatch(void) { abort(); }
"""


@pytest.mark.parametrize("name", ["plant", "controller"])
def test_the_functions_of_a_hosts_own_mujoco_are_not_called(host, tmp_path, name):
    """The host is linked with another version; here its functions are nothing but traps."""
    source, other = tmp_path / "other.c", tmp_path / "libother.so"
    source.write_text(OTHER_MUJOCO)
    subprocess.run(
        [compiler() or "cc", "-shared", "-fPIC", source, "-o", other], check=True, timeout=300
    )
    fmu = unpacked("native", name, 2)
    stress(host, fmu, "threads", 1, LD_PRELOAD=str(other))


@pytest.mark.long
@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize(("kind", "name"), MODELS)
def test_a_hard_host_is_served_for_long(host, kind, name, version):
    skip_without_library(kind)
    every_way(host, unpacked(kind, name, version), kind, 1)
