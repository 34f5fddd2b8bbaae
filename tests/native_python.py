"""FMUs of the backend Python, and what is checked on them in a process that is Python."""

from __future__ import annotations

import ctypes
import ctypes.util
import math
import platform
import sys
import sysconfig
import threading
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path

import pytest
from native_support import ERROR, OK, TIME, WARNING, Instance, Row, Table, parameter, unpacked
from panda_cosim.fmus.build.libraries import SOURCES

SLAVES = Path(__file__).parent / "slaves"
DECAY_ROWS = (
    Row("u", "input", start=(1.0,)),
    Row("x"),
    parameter("n", 3.0, kind="Integer", tunable=True),
    parameter("on", 1.0, kind="Boolean", tunable=True),
    Row("text", "parameter", kind="String", variability="tunable", start="abc"),
    Row("echo", kind="String"),
    Row("fail", "input"),
    TIME,
)
SHARED_ROWS = (Row("u", "input"), Row("x"), parameter("gain", 2.0, tunable=True), TIME)
Options = Sequence[tuple[str, str]]
CHECKS: list[Callable[[Path, int], None]] = []


def check(function: Callable[[Path, int], None]) -> Callable[[Path, int], None]:
    """Collect a check."""
    CHECKS.append(function)
    return function


def recorded() -> Options:
    """Options that say which Python to start where there is none."""
    folder = sysconfig.get_config_var("LIBDIR")
    library = Path(folder) / (sysconfig.get_config_var("INSTSONAME") or "")
    names = [find_spec(name) for name in ("numpy", "pythonfmu")]
    paths = {str(Path(spec.origin).parent.parent) for spec in names if spec and spec.origin}
    return (
        ("python", str(library)),
        ("home", sys.base_prefix),
        ("version", f"{sys.version_info[0]}.{sys.version_info[1]}"),
        *(("path", path) for path in sorted(paths)),
    )


def decay_table(options: Options = ()) -> Table:
    """The slave on PythonFMU's interface."""
    own = (("package", "decay_5a1f"), ("slave", "decay Decay"), ("private", "decay"),
           ("private", "my_helper"))  # fmt: skip
    return Table(DECAY_ROWS, (*own, *options), step=0.0)


def shared_table(options: Options = ()) -> Table:
    """The slave on the values' memory."""
    return Table(SHARED_ROWS, (("package", "shared_77"), ("slave", "shared Shared"), *options))


def build(folder: Path, table: Table, helper: str = "") -> Path:
    """Write an FMU of a slave."""
    host = (SOURCES / "python_host.py").read_bytes()
    fmu = unpacked(folder, "python", table, {"python_host.py": host})
    options = dict(table.options)
    package = fmu / "resources" / options["package"]
    package.mkdir()
    names = ("decay", "my_helper") if "private" in options else ("shared",)
    for name in names:
        (package / f"{name}.py").write_bytes((SLAVES / f"{name}.py").read_bytes())
    if helper:
        (package / "my_helper.py").write_text(helper)
    return fmu


@check
def a_slave_on_pythonfmus_interface_works(folder: Path, version: int) -> None:
    table = decay_table()
    it = Instance(build(folder, table), table, version).start()
    it.set("u", 2.0)
    assert [it.step(i * 0.01, 0.01) for i in range(3)] == [OK] * 3
    x = sum([2 * 2.0 * 0.01 * 3] * 3)
    assert it.get("x") == [pytest.approx(x, rel=1e-15)]
    assert it.get("echo") == [b"abc!"]
    state = it.save()
    it.set("text", "neu ä".encode())
    assert it.step(0.03, 0.5) == OK
    assert it.get("echo") == ["neu ä!".encode()]
    after = it.get("x")
    assert it.load(state) == OK
    assert it.get("echo") == [b"abc!"]
    assert it.step(0.03, 0.5) == OK
    assert it.get("x") == after
    assert it("Terminate") == OK
    it.free()
    assert it.log == []


@check
def an_exception_is_an_error_with_its_traceback(folder: Path, version: int) -> None:
    table = decay_table()
    it = Instance(build(folder, table), table, version).start()
    it.set("fail", 1.0)
    assert it.step(0.0, 0.01) == ERROR
    assert "RuntimeError: boom 100%" in it.messages()
    assert 'decay.py", line ' in it.messages()
    assert it("Reset") == OK
    it.start()
    it.set("fail", 2.0)
    assert it.step(0.0, 0.01) == ERROR
    assert "do_step returned False" in it.messages()
    it.free()


@check
def a_slave_on_the_memory_works(folder: Path, version: int) -> None:
    table = shared_table((("need", "numpy 2.0"), ("minimum", "3.11")))
    it = Instance(build(folder, table), table, version).start(1.0)
    for i in range(20):
        it.set("u", i / 3)
        it.set("gain", 1.0 + i)
        assert it.step(1.0 + i * 0.001) == OK
    x = 1.0
    for i in range(20):
        x += (1.0 + i) * (i / 3) * 0.001
    assert it.get("x") == [x]
    state = it.save()
    it.step(1.02)
    expected = it.get("x")
    assert it.load(state) == OK
    it.step(1.02)
    assert it.get("x") == expected
    assert it.log == []
    it.set("u", 200.0)
    assert it.step(1.021) == OK
    assert [entry[0] for entry in it.log] == [WARNING]
    it.set("u", 2000.0)
    assert it.step(1.022) == ERROR
    assert "ArithmeticError: too large" in it.messages()
    it.free()


@check
def the_hosts_modules_and_path_stay_as_they_are(folder: Path, version: int) -> None:
    import types  # noqa: PLC0415

    own = types.ModuleType("my_helper")
    sys.modules["my_helper"] = own
    path, meta = list(sys.path), list(sys.meta_path)
    table = decay_table()
    it = Instance(build(folder / "one", table), table, version).start()
    other_table = Table(DECAY_ROWS, tuple(
        (key, "decay_other" if key == "package" else value) for key, value in table.options
    ), step=0.0)  # fmt: skip
    other_fmu = build(folder / "two", other_table, "def double(x):\n    return 100 * x\n")
    other = Instance(other_fmu, other_table, version).start()
    for one, factor in ((it, 2), (other, 100)):
        one.step(0.0, 1.0)
        assert one.get("x") == [factor * 3.0]
        one.free()
    assert sys.modules["my_helper"] is own
    assert "decay" not in sys.modules
    assert (sys.path, sys.meta_path) == (path, meta)


@check
def what_is_missing_fails_the_instantiation_in_plain_words(folder: Path, version: int) -> None:
    import numpy  # noqa: PLC0415, F401 - the host has it

    cannot_start, elsewhere = "the FMU's code cannot start in Python", "set PANDA_COSIM_PYTHONPATH"
    for i, (option, *words) in enumerate((
        (("need", "not_there 1.0"), cannot_start, elsewhere,
         "the package not_there cannot be imported: No module named"),
        (("need", "numpy 99.0"), cannot_start, "is too old, 99.0 is needed",
         "this process had loaded it already"),
        (("minimum", "3.99"), "Python 3.99 or newer is needed; the one in this process is 3."),
    )):  # fmt: skip
        table = shared_table((option,))
        with pytest.raises(AssertionError) as refusal:
            Instance(build(folder / str(i), table), table, version)
        for word in words:
            assert word in str(refusal.value)
        assert (elsewhere in str(refusal.value)) == (elsewhere in words)
    place = build(folder / "damaged", shared_table())
    (place / "resources" / "shared_77" / "shared.py").write_text("1/0\n")
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        Instance(place, shared_table(), version)
    (place / "resources" / "python_host.py").unlink()
    with pytest.raises(AssertionError, match=r"python_host\.py cannot be read"):
        Instance(place, shared_table(), version)


@check
def a_state_is_made_in_the_default_rounding_mode(folder: Path, version: int) -> None:
    table = shared_table()
    it = Instance(build(folder, table), table, version).start(1.0)
    plain = it.serialize(it.save())
    libm = ctypes.CDLL(ctypes.util.find_library("m"))
    upward = 0x800 if platform.machine() == "x86_64" else 0x400000  # FE_UPWARD
    libm.fesetround(upward)
    try:
        state = it.save()
        kept = libm.fegetround()
    finally:
        libm.fesetround(0)
    assert kept == upward
    assert it.serialize(state) == plain
    it.free()


@check
def instances_in_threads_do_not_meet_in_python(folder: Path, version: int) -> None:
    table = decay_table()
    fmu = build(folder, table)
    ends: dict[int, float] = {}

    def work(seed: int) -> None:
        for _ in range(10):
            it = Instance(fmu, table, version).start()
            it.set("u", float(seed))
            for i in range(10):
                assert it.step(i * 0.5, 0.5) == OK
            ends[seed] = it.get("x")[0]
            it.free()

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(300.0)
        assert not thread.is_alive()
    assert all(math.isclose(ends[seed], 2 * seed * 3 * 5.0) for seed in range(8))


def run(name: str, folder: str, version: int) -> None:
    """Run the check of a name."""
    next(c for c in CHECKS if c.__name__ == name)(Path(folder), version)
