"""Hosts in C that make it hard for an FMU: they get the bits of an undisturbed run, or a reason."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from fmu_instance import Unpacked, unpacked
from fmu_support import compiler
from panda_cosim.fmus.build import libraries as native
from panda_cosim.fmus.sources.python_fmu import python_library
from panda_cosim.fmus.sources.targets import Kind

SOURCE = Path(__file__).parent / "c_host" / "stress.c"
# What a host does to an FMU, with how many rounds, kilobytes, instances or megabytes.
WAYS: dict[str, dict[str, int]] = {
    "native": {"arithmetic": 0, "comma": 0, "two": 0, "threads": 1, "stack": 64, "at-once": 10,
               "churn": 50, "starved": 1, "limit": 6, "again": 2},
    "python": {"comma": 0, "two": 0, "threads": 1, "limit": 8},
}  # fmt: skip
COMMA = 'LC_NUMERIC\ndecimal_point ","\nthousands_sep ""\ngrouping -1\nEND LC_NUMERIC\n'
pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
    pytest.mark.skipif(native.this_platform() != "linux64", reason="the host is for Linux"),
]


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Path:
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


def stress(host: Path, fmu: Unpacked, way: str, number: int, **environment: str) -> None:
    words = [fmu.token, fmu.location, fmu.reals("input"), fmu.reals("output"), way, str(number)]
    done = subprocess.run(
        [host, str(fmu.version), fmu.library, *words],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"LOCPATH": str(host.parent)} | environment,
        timeout=500,
    )
    assert done.returncode == 0, f"{way} {number}: {done.returncode}\n{done.stderr[-3000:]}"


@pytest.mark.parametrize(
    ("kind", "name", "version"),
    [("native", "plant", 3), ("native", "controller", 2), ("native", "trajectory", 3),
     ("python", "trajectory", 2)],
)  # fmt: skip
def test_a_hard_host_is_served(host: Path, kind: Kind, name: str, version: int) -> None:
    if kind == "python" and python_library() is None:
        pytest.skip("this Python has no shared library, which a C host loads")
    for way, number in WAYS[kind].items():
        stress(host, unpacked(kind, name, version), way, number)


OTHER_MUJOCO = """
#include <stdlib.h>
void mj_forwardSkip(void) { abort(); }
void mj_markStack(void) { abort(); }
void mju_dispatch(void) { abort(); }
"""


@pytest.mark.parametrize("name", ["plant", "controller"])
def test_the_functions_of_a_hosts_own_mujoco_are_not_called(
    host: Path, tmp_path: Path, name: str
) -> None:
    """The host is linked with another version; here its functions are nothing but traps."""
    source, other = tmp_path / "other.c", tmp_path / "libother.so"
    source.write_text(OTHER_MUJOCO)
    subprocess.run(
        [compiler() or "cc", "-shared", "-fPIC", source, "-o", other], check=True, timeout=300
    )
    fmu = unpacked("native", name, 2)
    stress(host, fmu, "again", 1, LD_PRELOAD=str(other))
