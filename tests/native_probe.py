"""The FMU of tests/c_host/backend_probe.c, with a variable of each kind, and checks of it.

Each `check_` runs in a process of its own, in FMI 2.0 and in FMI 3.0.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from contextlib import suppress
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from native_support import (
    ERROR,
    OK,
    STEP,
    TIME,
    Instance,
    RefusedError,
    Row,
    Table,
    parameter,
    resources_uri,
)

SOURCE = Path(__file__).parent / "c_host" / "backend_probe.c"
TABLE = Table(
    (
        Row("u", "input", minimum=(-5.0,), maximum=(5.0,), start=(1.0,)),
        Row("fail", "input"),
        Row("x"),
        Row("count"),
        Row("matrix", shape=(2, 3)),
        parameter("gain", 2.0, tunable=True, minimum=(0.0,), maximum=(10.0,)),
        parameter("offset", 0.0),
        parameter("flag", 1.0, kind="Boolean", tunable=True),
        parameter("choice", 2.0, kind="Enumeration", minimum=(1.0,), maximum=(3.0,)),
        parameter("whole", -7.0, kind="Integer"),
        Row("text", "parameter", variability="fixed", kind="String", start="ein Ä\t100%"),
        Row("echo", kind="String"),
        Row("big", kind="Integer"),
        TIME,
    )
)
CHECKS: list[Callable[[Path, int], None]] = []


def check(function: Callable[[Path, int], None]) -> Callable[[Path, int], None]:
    """Collect a check."""
    CHECKS.append(function)
    return function


def new(folder: Path, version: int, **more: Any) -> Instance:
    """An instance that is initialized."""
    return Instance(folder, TABLE, version, **more).start()


@check
def a_step_of_any_length_counts_whole_internal_steps(folder: Path, version: int) -> None:
    it, time = new(folder, version), 0.0
    for size, count in (
        (0.0044, 4),
        (0.0044, 8),
        (0.0044, 13),
        (0.0, 13),
        (0.0003, 13),
        (0.0005, 14),
    ):
        assert it.step(time, size) == OK, it.messages()
        time += size
        assert it.get("count") == [count]
        assert it.get("time") == [time]
    it.free()
    it = new(folder, version)
    for i in range(500):  # an importer that divides 2.2 s in 500 parts
        assert it.step(i * 2.2 / 500, (i + 1) * 2.2 / 500 - i * 2.2 / 500) == OK
        assert it.get("count") == [math.floor((i + 1) * 4.4 + 1e-6)]
    it.free()


@check
def a_sum_of_rounded_times_loses_no_step(folder: Path, version: int) -> None:
    for start, size in ((0.0, 0.001), (1e9, 0.001), (-3.0, 0.007)):
        it = Instance(folder, TABLE, version).start(start)
        time = start
        for i in range(3000):
            assert it.step(time, size) == OK, it.messages()
            time += size
            if size == STEP and start < 1e6:
                assert it.get("count") == [i + 1]
        assert abs(it.get("count")[0] - (time - start) / STEP) <= 1.0
        it.free()


@check
def a_wrong_communication_point_is_refused(folder: Path, version: int) -> None:
    it = new(folder, version)
    it.steps(3)
    for time in (0.002, 0.0031, math.nan, math.inf, -1.0):
        assert it.step(time) == ERROR
    for size in (-STEP, math.nan, math.inf, 1e300):
        assert it.step(0.003, size) == ERROR
    assert "is not where the last step has ended, 0.003 s" in it.log[0][2]
    assert it.step(0.003) == OK  # a refused call changes nothing
    assert it.get("count") == [4.0]
    it.free()


@check
def a_step_past_the_stop_time_is_refused(folder: Path, version: int) -> None:
    it = Instance(folder, TABLE, version)
    times = (c_int(0), c_double(0), c_double(0.0), c_int(1), c_double(0.002))
    if version == 2:
        assert it("SetupExperiment", *times) == OK
        assert it("EnterInitializationMode") == OK
    else:
        assert it("EnterInitializationMode", *times) == OK
    assert it("ExitInitializationMode") == OK
    it.steps(2)
    assert it.step(0.002) == ERROR
    assert "after the stop time of 0.002 s" in it.messages()
    it.free()


@check
def a_failed_step_is_an_error_with_its_reason(folder: Path, version: int) -> None:
    it = new(folder, version)
    it.steps(2)
    assert it.get("count") == [2.0]
    it.set("fail", 0.75)
    assert it.step(0.002) == ERROR
    assert it.log == [(ERROR, "logStatusError", f"fmi{version}DoStep: told to fail at 75% of it")]
    if version == 3:
        assert [it.event.value, it.terminate.value, it.early.value] == [False] * 3
        assert it.last.value == 0.002
    else:
        value = c_int(7)
        assert it("GetBooleanStatus", 3, byref(value)) == OK
        assert value.value == 0  # fmi2Terminated
        last = c_double()
        assert it("GetRealStatus", 2, byref(last)) == OK
        assert last.value == 0.002
    assert it.get("count") == [2.0]  # what was read last can be read again
    assert it.step(0.002) == ERROR
    assert "in the error state after an earlier failure" in it.messages()
    assert it("Reset") == OK
    it.start().steps(1)
    it.free()


@check
def references_and_types_are_checked(folder: Path, version: int) -> None:
    it = new(folder, version)
    assert it.get_references([999], 1)[0] == ERROR
    assert it.set_references([4294967295], [1.0]) == ERROR
    assert "no variable has the value reference 999" in it.messages()
    flag = TABLE.references["flag"]
    assert it.get_references([flag], 1)[0] == ERROR
    assert f"flag (value reference {flag}) is of type Boolean" in it.messages()
    if version == 3:
        inside = TABLE.references["matrix"] + 1
        assert it.get_references([inside], 1)[0] == ERROR
        assert it.get_references([TABLE.references["matrix"]], 5)[0] == ERROR
        assert it.get_references([TABLE.references["matrix"]], 7)[0] == ERROR
        places = (c_double * 6)(*[7.0] * 6)
        matrix = (c_uint * 1)(TABLE.references["matrix"])
        assert it("GetFloat64", matrix, c_size_t(1), places, c_size_t(5)) == ERROR
        assert places[5] == 7.0
    array, missing = (c_uint * 1)(0), c_void_p()
    sizes = (c_size_t(1),) if version == 3 else ()
    name = "GetReal" if version == 2 else "GetFloat64"
    assert it(name, array, c_size_t(1), missing, *sizes) == ERROR
    assert it(name, missing, c_size_t(1), (c_double * 1)(), *sizes) == ERROR
    assert it(name, missing, c_size_t(0), missing, *((c_size_t(0),) if version == 3 else ())) == OK
    assert it.step(0.0) == OK  # none of these had an effect
    it.free()


@check
def what_must_not_be_set_is_refused_by_its_name(folder: Path, version: int) -> None:
    it = new(folder, version)
    for name, value, reason in (
        ("x", 1.0, "x cannot be set: it is computed by the FMU"),
        ("time", 1.0, "time cannot be set: it is computed by the FMU"),
        (
            "offset",
            1.0,
            "offset cannot be set: it is a fixed parameter, and initialization is over",
        ),
        ("gain", 11.0, "gain = 11 is out of range [0, 10]"),
        ("gain", math.nan, "gain = nan is out of range"),
        ("choice", 1, "choice cannot be set: it is a fixed parameter"),
    ):
        assert it.set(name, value) == ERROR
        assert reason in it.log[-1][2]
    assert it.set("gain", 5.0) == OK
    assert it.set("flag", 0) == OK
    assert it.get("flag") == [0]
    it("Terminate")
    assert it.set("u", 1.0) == ERROR
    it.free()


@check
def nothing_is_set_where_one_of_several_is_refused(folder: Path, version: int) -> None:
    it = new(folder, version)
    references = [TABLE.references[name] for name in ("u", "gain")]
    assert it.set_references(references, [4.0, 11.0]) == ERROR
    assert it.get("u") + it.get("gain") == [1.0, 2.0]
    it.free()


@check
def calls_out_of_order_are_refused(folder: Path, version: int) -> None:
    it = Instance(folder, TABLE, version)
    assert it("ExitInitializationMode") == ERROR
    assert it("Terminate") == ERROR
    assert it.step(0.0) == ERROR
    assert it.get_references([TABLE.references["x"]], 1)[0] == ERROR
    assert "x is not known before initialization" in it.messages()
    it.start()
    assert it.enter() == ERROR
    assert it("ExitInitializationMode") == ERROR
    it.steps(1)
    assert it("Terminate") == OK
    assert it("Terminate") == ERROR
    assert it.step(STEP) == ERROR
    assert it("Reset") == OK
    assert it("Reset") == OK
    it.start()
    assert it.get("count") == [0.0]
    it.free()
    it.c = c_void_p()
    assert it.step(0.0) == ERROR  # without an instance
    it.free()


@check
def a_wrong_token_or_type_is_refused(folder: Path, version: int) -> None:
    expect_refusal(folder, version, "the token '{0}' is not that of this FMU", token="{0}")
    it, token = new(folder, version), TABLE.token.encode()
    if version == 2:
        uri = resources_uri(folder).encode()
        made = it.dll.fmi2Instantiate(b"it", 0, token, uri, byref(it._callbacks), 0, 1)
    else:
        no = c_bool(False)
        path = str(folder).encode()
        made = it.dll.fmi3InstantiateModelExchange(b"it", token, path, no, no, None, it._logger)
    assert not made
    assert "for co-simulation, not for model exchange" in it.messages()
    it.free()


@check
def event_mode_and_intermediate_update_are_refused(folder: Path, version: int) -> None:
    if version == 2:
        return
    it = new(folder, version)
    no, yes, none = c_bool(False), c_bool(True), c_size_t(0)
    head = (b"it", TABLE.token.encode(), f"{folder}/resources/".encode(), no, yes)
    one = (c_uint * 1)(0)
    make = it.dll.fmi3InstantiateCoSimulation
    assert make(*head, yes, no, None, none, None, it._logger, None) is None
    assert "hasEventMode is false" in it.messages()
    assert make(*head, no, no, one, c_size_t(1), None, it._logger, None) is None
    assert "providesIntermediateUpdate is false" in it.messages()
    assert it("EnterEventMode") == ERROR
    assert it("EnterConfigurationMode") == ERROR
    it.free()


def expect_refusal(folder: Path, version: int, reason: str, **more: Any) -> None:
    """Instantiation has to fail with a reason."""
    with pytest.raises(RefusedError) as refusal:
        Instance(folder, TABLE, version, **more)
    assert reason in str(refusal.value)


@check
def all_forms_of_a_resource_location_are_understood(folder: Path, version: int) -> None:
    names = ["a b", "a+b", "(a)", "a#b", "a&b", "a@b,c", "Müller", "日本", "a%20b", "a%b", "plain"]
    for name in names:
        place = folder.parent / name / str(version)
        shutil.copytree(folder, place, symlinks=True)
        path = f"{place}/resources"
        forms = [f"file://{quote(path)}", f"file:{quote(path)}", f"file://localhost{quote(path)}"]
        forms += [f"FILE://{quote(path)}/", path, f"{path}/", f"file://{path}"]
        forms += ["file://" + quote(path, safe="/+()#&@,")]
        for form in forms:
            if name == "a%20b" and form == f"file://{path}":
                continue  # which the standard reads as "a b"
            it = new(folder, version, location=form)
            it.free()
            assert it.log == [], form
        shutil.rmtree(place.parent)


@check
def a_location_without_resources_is_refused_with_the_reason(folder: Path, version: int) -> None:
    for place, reason in (
        (f"file://{folder}/nowhere", "/nowhere/variables.txt cannot be read: No such file"),
        ("http://example.org/resources", "is not a local file URI"),
        ("file://other.host/x", "is not a local file URI"),
        ("file:", "cannot be read"),
        ("", "cannot be read"),
        ("%", "cannot be read"),
        ("file:///%", "cannot be read"),
        ("file:///%00", "cannot be read"),
        ("x" * 100000, "cannot be read"),
    ):
        if place:
            expect_refusal(folder, version, reason, location=place)


@check
def a_damaged_table_is_refused_with_its_line(folder: Path, version: int) -> None:
    good = (folder / "resources" / "variables.txt").read_bytes()
    lines = good.split(b"\n")
    place = folder.parent / f"damaged{version}"
    for i in range(len(lines)):
        for damage in (b"", b"variable", lines[i][:-1], lines[i] + b"0", b"\xff\x00\t\t\t"):
            shutil.copytree(folder, place, symlinks=True)
            broken = b"\n".join([*lines[:i], damage, *lines[i + 1 :]])
            (place / "resources" / "variables.txt").write_bytes(broken)
            with suppress(RefusedError):  # or what is damaged is a text that nothing needs
                Instance(place, TABLE, version).free()
            shutil.rmtree(place)


@check
def a_refused_instantiation_says_why_without_a_format(folder: Path, version: int) -> None:
    place = folder.parent / f"refusing{version}"
    shutil.copytree(folder, place, symlinks=True)
    table = place / "resources" / "variables.txt"
    table.write_text(table.read_text(encoding="utf-8") + "option\trefuse\tyes\n", encoding="utf-8")
    expect_refusal(place, version, "refused: 100% of it")


@check
def log_categories_are_honoured(folder: Path, version: int) -> None:
    it = new(folder, version)
    yes, no = (c_bool(True), c_bool(False)) if version == 3 else (c_int(1), c_int(0))

    def provoke() -> list[str]:
        it.log.clear()
        it.set("x", 1.0)
        it("Reset")
        it.start()
        it.set("u", -100.0 - len(said))
        it.step(0.0)
        return [category for _, category, _ in it.log]

    said: list[str] = []
    assert it("SetDebugLogging", yes, c_size_t(1), (c_char_p * 1)(b"logStatusWarning")) == OK
    assert provoke() == ["logStatusWarning"]
    assert it("SetDebugLogging", yes, c_size_t(1), (c_char_p * 1)(b"logStatusError")) == OK
    assert provoke() == ["logStatusError"]
    assert it("SetDebugLogging", no, c_size_t(0), None) == OK
    assert provoke() == ["logStatusError"]
    assert it("SetDebugLogging", yes, c_size_t(1), (c_char_p * 1)(b"wrong")) == ERROR
    assert "'wrong' is not a log category" in it.messages()
    it.free()


@check
def a_state_can_be_got_and_set_before_initialization_and_after_a_failure(
    folder: Path, version: int
) -> None:
    it = Instance(folder, TABLE, version)
    it.set("offset", 7.0)
    early = it.save()
    it.start().steps(3)
    late = it.save()
    it.set("fail", 1.0)
    assert it.step(0.003) == ERROR
    assert it.load(late) == OK
    assert it.step(0.003) == OK
    assert it.load(early) == OK
    assert it.get("offset") == [7.0]
    it.start().steps(3)
    assert it.serialize(it.save())[64:] == it.serialize(late)[64:]
    it.free()


@check
def a_damaged_state_is_refused(folder: Path, version: int) -> None:
    it = new(folder, version)
    it.steps(2)
    content = it.serialize(it.save())
    for i in range(0, len(content) * 8):
        flipped = bytearray(content)
        flipped[i // 8] ^= 1 << i % 8
        assert it.deserialize(bytes(flipped))[0] == ERROR, i
    for size in range(len(content)):
        assert it.deserialize(content[:size])[0] == ERROR, size
    assert it.deserialize(content + b"\0")[0] == ERROR
    assert it.load(c_void_p()) == ERROR
    assert it.deserialize(content)[0] == OK
    it.free()


@check
def an_integer_that_does_not_fit_is_an_error(folder: Path, version: int) -> None:
    it = new(folder, version)
    assert it.get("big") == [1_000_000_000]
    it.set("u", -2.5)
    it.steps(1)
    big = [TABLE.references["big"]]
    assert it.get_references(big, 1, "Integer")[0] == ERROR
    assert "big = -2.5e+09 does not fit an integer" in it.messages()
    it.free()


@check
def a_state_of_another_build_is_refused(folder: Path, version: int) -> None:
    it = new(folder, version)
    place = folder.parent / f"other{version}"
    shutil.copytree(folder, place, symlinks=True)
    table = place / "resources" / "variables.txt"
    table.write_text(table.read_text(encoding="utf-8") + "# another\n", encoding="utf-8")
    other = new(place, version)
    assert other.deserialize(it.serialize(it.save()))[0] == ERROR
    assert "that of another FMU, or of another build" in other.messages()
    assert other.load(it.save()) == ERROR
    it.free()
    other.free()


@check
def the_rest_of_the_functions_say_that_they_are_not_offered(folder: Path, version: int) -> None:
    it = new(folder, version)
    one, number = (c_uint * 1)(0), (c_double * 1)()
    none = c_size_t(0)
    if version == 2:
        assert it("CancelStep") == ERROR
        assert (
            it("GetDirectionalDerivative", one, c_size_t(1), one, c_size_t(1), number, number)
            == ERROR
        )
        assert it("GetStatus", 0, byref(c_int())) == 2
        it.dll.fmi2GetVersion.restype = it.dll.fmi2GetTypesPlatform.restype = c_char_p
        assert it.dll.fmi2GetVersion() == b"2.0"
        assert it.dll.fmi2GetTypesPlatform() == b"default"
    else:
        assert it("GetFloat32", one, c_size_t(1), number, c_size_t(1)) == ERROR
        assert it("GetFloat32", one, none, number, none) == OK
        assert it("UpdateDiscreteStates", *[POINTER(c_bool)()] * 5, POINTER(c_double)()) == ERROR
        it.dll.fmi3GetVersion.restype = c_char_p
        assert it.dll.fmi3GetVersion() == b"3.0"
    assert it.step(0.0) == OK
    it.free()


def run(name: str, folder: str, version: int) -> None:
    """Run the check of a name."""
    next(c for c in CHECKS if c.__name__ == name)(Path(folder), version)
