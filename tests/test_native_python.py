"""The backend Python, in a host that is Python and in one that is not."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import native_python
import pytest
from fmu_support import Host, compile_host, compiler, in_process
from native_support import ERROR, OK, TOKEN, Table, resources_uri

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
]
NAMES = [check.__name__ for check in native_python.CHECKS]
needs_library = pytest.mark.skipif(
    not Path(native_python.recorded()[0][1]).is_file(), reason="this Python has no shared library"
)


@pytest.mark.parametrize("version", [2, 3], ids=["fmi2", "fmi3"])
@pytest.mark.parametrize("name", NAMES)
def test_(tmp_path: Path, name: str, version: int) -> None:
    in_process(native_python.run, name, str(tmp_path / "fmu"), version)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compile_host(tmp_path_factory.mktemp("host"))


def instantiate(host: Host, folder: Path, slot: int = 0) -> int:
    """Load an FMU in a C host, and instantiate it; returns the status."""
    host.load(slot, folder, "Model")
    answer = host("new", slot, slot, TOKEN, resources_uri(folder))
    host.said = answer.messages  # type: ignore[attr-defined]
    return answer.status


def steps(host: Host, slot: int = 0) -> list[float]:
    """Initialize and take ten steps with u = 3; returns x."""
    for words in (("setup", slot, 0.0, 10.0), ("enter", slot), ("exit", slot)):
        assert host(*words).status == OK
    assert host("setr", slot, 1, 0, 3.0).status == OK
    for i in range(10):
        assert host("step", slot, i * 0.001, 0.001).status == OK
    return host("getr", slot, 1, 1)


def poisoned(folder: Path) -> dict[str, str]:
    """Variables of a host that would ruin a Python which heeds them."""
    folder.mkdir()
    for name in ("json", "numpy", "traceback"):
        (folder / f"{name}.py").write_text("raise RuntimeError('the wrong module')\n")
    return {"PYTHONHOME": "/nowhere", "PYTHONPATH": str(folder), "PYTHONSTARTUP": "/nowhere"}


@needs_library
@pytest.mark.parametrize("poison", [False, True], ids=["plain", "PYTHONHOME and PYTHONPATH"])
def test_a_c_host_without_python_runs_slaves(program: Path, tmp_path: Path, poison: bool) -> None:
    environment: Mapping[str, str] = poisoned(tmp_path / "poison") if poison else {}
    shared = native_python.shared_table((*native_python.recorded(), ("need", "numpy 2.0")))
    decay = native_python.decay_table(native_python.recorded())
    first = native_python.build(tmp_path / "a", shared)
    second = native_python.build(tmp_path / "b", decay)
    x = 0.0
    for _ in range(10):
        x += 2.0 * 3.0 * 0.001
    with Host(program, environment) as host:
        assert instantiate(host, first) == OK, host.said  # type: ignore[attr-defined]
        assert steps(host) == [x]
        assert instantiate(host, second, 1) == OK, host.said  # type: ignore[attr-defined]
        assert steps(host, 1) == [pytest.approx(2 * 3 * 3 * 0.01)]
        host("free", 0)
        host("free", 1)
        assert host.close() == 0


@needs_library
def test_a_c_host_lives_on_after_what_is_missing(program: Path, tmp_path: Path) -> None:
    def table(*options: tuple[str, str]) -> Table:
        return native_python.shared_table((*native_python.recorded(), *options))

    bad = native_python.build(tmp_path / "bad", table(("need", "not_there 1.0")))
    good = native_python.build(tmp_path / "good", table())
    with Host(program) as host:
        assert instantiate(host, bad) == ERROR
        (told,) = host.said  # type: ignore[attr-defined]
        assert told.startswith(
            "3 logStatusError slot0 fmi2Instantiate: the FMU's code cannot start"
        )
        assert "the package not_there cannot be imported" in told
        assert instantiate(host, good, 1) == OK
        assert steps(host, 1)
        host("free", 1)
        assert host.close() == 0


def test_a_c_host_is_told_where_python_was_sought(program: Path, tmp_path: Path) -> None:
    unrecorded = native_python.build(tmp_path / "a", native_python.shared_table())
    gone = native_python.shared_table((("python", "/nowhere/libpython3.11.so.1.0"),))
    with Host(program) as host:
        assert instantiate(host, unrecorded) == ERROR
        assert "this process has no Python, and none was recorded" in host.said[0]  # type: ignore[attr-defined]
        assert instantiate(host, native_python.build(tmp_path / "b", gone), 1) == ERROR
        assert "/nowhere/libpython3.11.so.1.0: cannot open" in host.said[0]  # type: ignore[attr-defined]
        assert host.close() == 0


@needs_library
def test_packages_can_be_named_by_the_environment(program: Path, tmp_path: Path) -> None:
    (tmp_path / "packages").mkdir()
    (tmp_path / "packages" / "numpy.py").write_text("__version__ = '1.26.4'\n")
    table = native_python.shared_table((*native_python.recorded(), ("need", "numpy 2.0")))
    fmu = native_python.build(tmp_path / "a", table)
    moved = tmp_path / "b c+ä"
    shutil.copytree(fmu, moved)
    with Host(program, {"PANDA_COSIM_PYTHONPATH": str(tmp_path / "packages")}) as host:
        assert instantiate(host, moved) == ERROR
        assert "numpy 1.26.4" in host.said[0]  # type: ignore[attr-defined]
        assert "is too old, 2.0 is needed" in host.said[0]  # type: ignore[attr-defined]
        assert host.close() == 0
