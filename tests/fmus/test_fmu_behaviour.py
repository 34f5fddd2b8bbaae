"""How an FMU behaves, of either kind and version: values, steps, states, many instances."""

import gc
import math
import os
import random
import threading
from contextlib import suppress
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest

from fmu_instance import ERROR, OK, STEP, Instance, RefusedError, Unpacked, unpacked, unpacked_fmu
from fmu_support import changed_plant, in_fork
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.sources.targets import Kind, Target, build_trajectory

pytestmark = pytest.mark.own_process
VERSIONS = {"params": (2, 3), "ids": ("fmi2", "fmi3")}
MIXED: list[tuple[Kind, str, int]] = [
    ("native", "plant", 3), ("native", "controller", 2), ("native", "trajectory", 3),
    ("python", "plant", 2), ("python", "controller", 3), ("python", "trajectory", 2),
]  # fmt: skip
VALUES = {
    "PandaPlant": {"block_mass": [0.4], "block_friction": [0.5], "scene": [2]},
    "PandaController": {"kp": [3.0] * 7, "ki": [1.0] * 7, "kd": [0.01] * 7, "period": [0.002]},
    "PandaTrajectory": {},
}
MEMORY_BOUND = 3.0  # [kB] that an instance may leave behind, on average
MEMORY_NOISE = 8000.0  # [kB] by which resident memory goes up and down


@pytest.fixture(params=MIXED, ids=lambda each: "-".join(map(str, each)))
def fmu(request):
    """An FMU, so that each kind, model and version is there."""
    return unpacked(*request.param)


@pytest.fixture(**VERSIONS)
def controller(request):
    """The FMU for what all FMUs have in common: inputs, outputs, parameters of several types."""
    return unpacked("native", "controller", request.param)


@pytest.fixture(**VERSIONS)
def counter(request):
    """One whose first output is the number of steps."""
    commands = np.zeros((5000, 14))
    commands[:, 0] = np.arange(5000)
    return Unpacked(Fmu(build_trajectory(commands, target=Target(fmi=request.param))).folder)


@pytest.fixture(**VERSIONS)
def changed(request):
    """Builds a plant in Python that does something else in place of a step."""
    old = b"self._plant.step(count)"
    return lambda step: unpacked_fmu(changed_plant("python", old, step), request.param)


# Steps.


def count(it: Instance) -> float:
    """How many internal steps have been taken."""
    number: float = it.get("pos_cmd")[0]
    return number


def test_a_step_of_any_length_counts_whole_internal_steps(counter):
    it, time = Instance(counter).start(), 0.0
    for size, steps in ((0.0044, 4), (0.0044, 8), (0.0044, 13), (0.0, 13), (0.0003, 13),
                        (0.0005, 14)):  # fmt: skip
        assert it.step(time, size) == OK, it.messages()
        time += size
        assert count(it) == steps
        assert it.get("time") == [time]
    it = Instance(counter).start()
    for i in range(500):  # an importer that divides 2.2 s in 500 parts
        assert it.step(i * 2.2 / 500, (i + 1) * 2.2 / 500 - i * 2.2 / 500) == OK
        assert count(it) == math.floor((i + 1) * 4.4 + 1e-6)


@pytest.mark.parametrize(("start", "size"), [(0.0, 0.001), (1e6, 0.001), (-2.0, 0.007)])
def test_a_sum_of_rounded_times_loses_no_step(counter, start, size):
    it, time = Instance(counter).start(start_time=start), start
    for i in range(600):
        assert it.step(time, size) == OK, it.messages()
        time += size
        if start == 0.0:
            assert count(it) == i + 1
    if start < 0.0:
        assert abs(count(it) - time / STEP) <= 1.0


def test_one_step_of_5_ms_is_five_of_1_ms(fmu):
    coarse, fine = Instance(fmu).start(), Instance(fmu).start()
    coarse.play(0, 1)
    fine.play(0, 1)
    assert coarse.step(STEP, 5 * STEP) == OK
    fine.steps(5, 1)
    assert coarse.outputs() == fine.outputs()


def test_a_wrong_communication_point_is_refused(counter):
    it = Instance(counter).start()
    it.steps(3)
    for time in (0.002, 0.0031, math.nan, math.inf, -1.0):
        assert it.step(time) == ERROR
    for size in (-STEP, math.nan, math.inf, 1e300):
        assert it.step(0.003, size) == ERROR
    assert "is not where the last step has ended, 0.003 s" in it.log[0][2]
    assert {category for _, category, _ in it.log} == {"logStatusError"}
    assert it.step(0.003) == OK  # a refused call changes nothing
    assert count(it) == 4.0
    it = Instance(counter).start(stop_time=0.002)
    it.steps(2)
    assert it.step(0.002) == ERROR
    assert "after the stop time of 0.002 s" in it.messages()


def test_a_failed_step_is_an_error_with_cause_and_traceback(changed):
    late = b"self._plant.data.time > 0.0005 and 1 / 0; self._plant.step(count)  # 100%"
    it = Instance(changed(late)).start()
    it.steps(1)
    state, before = it.save(), it.outputs()
    assert it.step(STEP) == ERROR
    ((_, category, text),) = it.log
    assert category == "logStatusError"
    for words in ("DoStep: ", "ZeroDivisionError: division by zero", "Traceback", "# 100%"):
        assert words in text
    if it.version == 3:
        assert [it.event.value, it.terminate.value, it.early.value] == [False] * 3
        assert it.last.value == STEP
    else:
        terminated, last = c_int(7), c_double()
        assert it("GetBooleanStatus", 3, byref(terminated)) == OK
        assert it("GetRealStatus", 2, byref(last)) == OK
        assert (terminated.value, last.value) == (0, STEP)
    assert it.outputs() == before  # what was read last can be read again
    assert it.step(STEP) == ERROR
    assert "in the error state after an earlier failure" in it.messages()
    assert it.load(state) == OK
    assert it.outputs() == before
    assert it("Reset") == OK
    it.start().steps(1)


def test_diverging_physics_is_an_error_with_time_and_cause(changed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fast = b"self._plant.data.qvel[:] = 1e9; self._plant.step(count)"
    it = Instance(changed(fast)).start()
    assert ERROR in (it.step(0.0), it.step(STEP))
    assert "the physics diverged at t = 0.00" in it.messages()
    assert list(tmp_path.iterdir()) == []  # no MUJOCO_LOG.TXT


def test_warnings_of_the_plants_engine_are_counted_from_the_start(changed):
    it = Instance(
        changed(b"self._plant.data.warning[1].number += 2; self._plant.step(count)")
    ).start()
    it.steps(3)
    assert it.get("mujoco_warnings") == [0.0, 6.0, 0.0]
    assert it("Reset") == OK
    assert it.start().get("mujoco_warnings") == [0.0] * 3


# Values.


@pytest.mark.parametrize("kind", ["native", "python"])
def test_an_impossible_parameter_is_refused_and_changes_nothing(kind):
    it = Instance(unpacked(kind, "plant", 3))
    for name, value, told in (("block_mass", -1.0, "block_mass = -1 is out of range"),
                              ("scene", 5, "scene = 5 is out of range [1, 4]"),
                              ("scene", 0, "scene = 0 is out of range [1, 4]")):  # fmt: skip
        assert it.set(name, value) == ERROR
        assert told in it.log[-1][2]
    it.start().steps(1)
    it("Reset")
    assert it.set("block_pos", 0.0, 0.0) == OK  # inside the arm's base
    assert ERROR in (it.enter(), it("ExitInitializationMode"))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_an_input_that_is_not_finite_is_refused_by_name(controller, value):
    it = Instance(controller).start()
    it.set("jac", *[0.0] * 11, value, *[0.0] * 30)
    assert it.step(0.0) == ERROR
    assert "input jac[2,5]" in it.messages()
    assert "not finite" in it.messages()
    it.set("jac", *[0.0] * 42)
    assert it.step(0.0) == OK  # nothing has happened, so it may go on


@pytest.mark.parametrize("version", [2, 3])
def test_an_input_out_of_range_is_clamped_with_one_warning(version):
    it = Instance(unpacked("native", "plant", version)).start()
    it.set("ctrl", *it.get("ctrl")[:7], 300.0)
    it.set("push_force", -2e3, 0.0, 0.0)
    it.steps(2)
    assert (it.get("ctrl")[7], it.get("push_force")[0]) == (255.0, -1000.0)
    assert [category for _, category, _ in it.log] == ["logStatusWarning"] * 2
    assert "ctrl[8]" in it.messages()
    assert "clamped" in it.messages()


@pytest.mark.parametrize("kind", ["native", "python"])
def test_zeros_for_all_inputs_are_survived(kind):
    it = Instance(unpacked(kind, "controller", 2)).start()
    it.set_inputs([0.0] * 109)
    it.steps(2)
    assert all(abs(x) < 1e3 for x in it.outputs())
    assert "input quat_cmd is zero; the last valid one is used" in it.messages()


def test_references_and_types_are_checked(controller):
    it = Instance(controller).start()
    kp, flag = controller.rows["kp"].reference, controller.rows["use_reference"].reference
    assert it.get_references([4711], 1)[0] == ERROR
    assert it.set_references([4294967295], [1.0]) == ERROR
    assert "no variable has the value reference 4711" in it.messages()
    for kind in ("Integer", "String"):
        assert it.get_references([kp], 1, kind)[0] == ERROR
    assert it.get_references([flag], 1)[0] == ERROR
    assert f"use_reference (value reference {flag}) is of type Boolean" in it.messages()
    if it.version == 3:
        assert it.get_references([kp + 1], 1)[0] == ERROR  # inside an array
        for size in (6, 8):
            assert it.get_references([kp], size)[0] == ERROR
        places = (c_double * 7)(*[9.0] * 7)
        assert it("GetFloat64", (c_uint * 1)(kp), c_size_t(1), places, c_size_t(6)) == ERROR
        assert places[6] == 9.0
    array, missing = (c_uint * 1)(0), c_void_p()
    sizes = (c_size_t(1),) if it.version == 3 else ()
    name = "GetReal" if it.version == 2 else "GetFloat64"
    assert it(name, array, c_size_t(1), missing, *sizes) == ERROR
    assert it(name, missing, c_size_t(1), (c_double * 1)(), *sizes) == ERROR
    assert it(name, missing, c_size_t(0), missing, *((c_size_t(0),) if sizes else ())) == OK
    assert it.step(0.0) == OK  # none of these had an effect


def test_what_must_not_be_set_is_refused_by_its_name(controller):
    it = Instance(controller).start()
    for name, value, reason in (
        ("dq", [1.0] * 7, "dq cannot be set: it is computed by the FMU"),
        ("time", [1.0], "time cannot be set: it is computed by the FMU"),
        ("period", [0.002],
         "period cannot be set: it is a fixed parameter, and initialization is over"),
        ("limit_share", [2.0], "limit_share = 2 is out of range"),
        ("kp", [1.0, math.nan, *[1.0] * 5], "kp[2] = nan is out of range"),
    ):  # fmt: skip
        before = it.get(name)
        assert it.set(name, *value) == ERROR
        assert reason in it.log[-1][2]
        assert it.get(name) == before  # none of several is set where one is refused
    it.log.clear()
    assert it.set("kp", *[20.0] * 7) == it.set("use_reference", False) == OK
    it.steps(1)
    assert (it.get("kp")[0], it.get("use_reference"), it.log) == (20.0, [0], [])
    it("Terminate")
    assert it.set("grip_cmd", 0.0) == ERROR
    it("Reset")
    assert it.set("period", 0.0015) == it.enter() == OK  # no multiple of the step
    assert it("ExitInitializationMode") == ERROR
    assert "period" in it.messages()


@pytest.mark.parametrize(("kind", "version"), [("controller", 2), ("controller", 3), ("mjcf", 3)])
def test_a_damaged_model_is_refused_by_name(kind, version, tmp_path):
    place = unpacked("native", kind, version).copy(tmp_path / "fmu")
    for model in (place.folder / "resources").glob("*.mjb"):
        model.write_bytes(model.read_bytes()[:5000])
    with pytest.raises(RefusedError, match=r"\w+\.mjb"):
        Instance(place)


def test_calls_out_of_order_are_refused(fmu):
    it = Instance(fmu)
    first = fmu.names("output")[0]
    assert it("ExitInitializationMode") == it("Terminate") == it.step(0.0) == ERROR
    assert it.get_references(it._references(first), fmu.rows[first].size)[0] == ERROR
    assert "is not known before initialization" in it.messages()
    assert it.enter() == OK
    assert it.step(0.0) == ERROR
    assert "initialization mode" in it.messages()
    assert it("ExitInitializationMode") == OK
    assert it.enter() == it("ExitInitializationMode") == ERROR
    assert "the instance is initialized" in it.messages()
    it.steps(1)
    assert it("Terminate") == OK
    assert it("Terminate") == it.step(STEP) == ERROR
    assert "the instance is terminated" in it.messages()
    assert it("Reset") == it("Reset") == OK
    it.start().steps(1)
    it.c = c_void_p()
    assert it.step(0.0) == ERROR  # without an instance
    it.free()


def test_reset_makes_an_instance_new(fmu):
    used, fresh = Instance(fmu).start(VALUES[fmu.library.stem]), Instance(fmu).start()
    used.play(0, 20)
    assert used("Reset") == OK
    assert used.start().play(0, 20) == fresh.play(0, 20)


# Instances, and where they find their resources.


def test_a_wrong_token_type_or_mode_is_refused(controller):
    with pytest.raises(RefusedError, match=r"the token '\{0\}' is not that of this FMU"):
        Instance(controller, token="{0}")
    it = Instance(controller)
    token, where = controller.token.encode(), controller.location.encode()
    no, yes, none = c_bool(False), c_bool(True), c_size_t(0)
    if it.version == 2:
        made = it.dll.fmi2Instantiate(b"it", 0, token, where, byref(it.callbacks), 0, 1)
    else:
        make = it.dll.fmi3InstantiateModelExchange
        made = make(b"it", token, where, no, no, None, it.logger)
    assert not made
    assert "for co-simulation, not for model exchange" in it.messages()
    if it.version == 2:
        return
    head, one = (b"it", token, where, no, yes), (c_uint * 1)(0)
    make = it.dll.fmi3InstantiateCoSimulation
    assert make(*head, yes, no, None, none, None, it.logger, None) is None
    assert "hasEventMode is false" in it.messages()
    assert make(*head, no, no, one, c_size_t(1), None, it.logger, None) is None
    assert "providesIntermediateUpdate is false" in it.messages()
    assert it("EnterEventMode") == it("EnterConfigurationMode") == ERROR


def test_all_forms_of_a_resource_location_are_understood(counter, tmp_path):
    for name in ("a b", "a+b", "(a)", "a#b", "a&b", "a@b,c", "Müller", "日本", "a%20b", "a%b", "x"):
        place = counter.copy(tmp_path / name)
        path = f"{place.folder}/resources"
        forms = [f"file://{quote(path)}", f"file:{quote(path)}", f"file://localhost{quote(path)}"]
        forms += [f"FILE://{quote(path)}/", path, f"{path}/", f"file://{path}"]
        forms += ["file://" + quote(path, safe="/+()#&@,")]
        for form in forms:
            if name == "a%20b" and form == f"file://{path}":
                continue  # which the standard reads as "a b"
            it = Instance(place, location=form).start()
            assert it.log == [], form


@pytest.mark.parametrize(
    ("location", "reason"),
    [("file:///nowhere", "/nowhere/variables.txt cannot be read: No such file"),
     ("http://example.org/resources", "is not a local file URI"),
     ("file://other.host/x", "is not a local file URI"),
     *((text, "cannot be read") for text in
       ("file:", "%", "file:///%", "file:///%00", "x" * 100000))],
    ids=range(8),
)  # fmt: skip
def test_a_location_without_resources_is_refused_with_the_reason(counter, location, reason):
    with pytest.raises(RefusedError, match=reason):
        Instance(counter, location=location)


def test_a_damaged_table_is_refused(counter, tmp_path):
    place = counter.copy(tmp_path / "damaged")
    lines = place.table.read_bytes().split(b"\n")
    for i, line in enumerate(lines):
        for damage in (b"", b"variable", line[:-1], line + b"0", b"\xff\x00\t\t\t"):
            place.table.write_bytes(b"\n".join([*lines[:i], damage, *lines[i + 1 :]]))
            with suppress(RefusedError):  # or what is damaged is a text that nothing needs
                Instance(place, token=counter.token).free()


def test_log_categories_are_honoured(controller):
    it = Instance(controller).start()
    yes, no = (c_bool(True), c_bool(False)) if it.version == 3 else (c_int(1), c_int(0))

    def provoke() -> list[str]:
        it.log.clear()
        it.set("time", 1.0)  # an error
        it("Reset")
        it.start().set("grip_cmd", -1.0)  # a warning
        it.step(0.0)
        return [category for _, category, _ in it.log]

    for names, heard in (([b"logStatusWarning"], ["logStatusWarning"]),
                         ([b"logStatusError"], ["logStatusError"]),
                         ([], ["logStatusError"])):  # fmt: skip
        switch, chosen = (yes, (c_char_p * 1)(*names)) if names else (no, None)
        assert it("SetDebugLogging", switch, c_size_t(len(names)), chosen) == OK
        assert provoke() == heard
    assert it("SetDebugLogging", yes, c_size_t(1), (c_char_p * 1)(b"wrong")) == ERROR
    assert "'wrong' is not a log category" in it.messages()


def test_the_rest_of_the_functions_say_that_they_are_not_offered(controller):
    it = Instance(controller).start()
    one, number, size = (c_uint * 1)(0), (c_double * 1)(), c_size_t(1)
    if it.version == 2:
        assert it("CancelStep") == ERROR
        assert it("GetDirectionalDerivative", one, size, one, size, number, number) == ERROR
        assert it("GetStatus", 0, byref(c_int())) == 2
        it.dll.fmi2GetVersion.restype = it.dll.fmi2GetTypesPlatform.restype = c_char_p
        assert (it.dll.fmi2GetVersion(), it.dll.fmi2GetTypesPlatform()) == (b"2.0", b"default")
    else:
        assert it("GetFloat32", one, size, number, size) == ERROR
        assert it("GetFloat32", one, c_size_t(0), number, c_size_t(0)) == OK
        assert it("UpdateDiscreteStates", *[POINTER(c_bool)()] * 5, POINTER(c_double)()) == ERROR
        it.dll.fmi3GetVersion.restype = c_char_p
        assert it.dll.fmi3GetVersion() == b"3.0"
    assert it.step(0.0) == OK


# States.


def test_a_state_replays_bit_for_bit_in_another_process(fmu):
    """Of an FMU whose parameters have other values there."""

    def play(state: bytes) -> list[list[float]]:
        it = Instance(fmu).start()
        status, copy = it.deserialize(state)
        assert status == it.load(copy) == OK
        return it.play(70, 20)

    it = Instance(fmu).start(VALUES[fmu.library.stem])
    it.play(0, 70)
    state = it.serialize(it.save())
    assert in_fork(play, state) == it.play(70, 20)


def test_a_state_of_before_initialization_is_restored(controller):
    it = Instance(controller)
    it.set("period", 0.002)
    early = it.save()
    it.start().steps(3)
    late = it.save()
    assert it.load(early) == OK
    assert it.get("period") == [0.002]
    it.start().steps(3)
    assert it.serialize(it.save())[64:] == it.serialize(late)[64:]


@pytest.mark.parametrize("kind", ["native", "python"])
def test_a_damaged_or_foreign_state_is_refused(kind, tmp_path):
    fmu = unpacked(kind, "trajectory", 3)
    it = Instance(fmu).start()
    it.steps(2)
    content = it.serialize(it.save())
    for i in range(len(content) * 8):
        flipped = bytearray(content)
        flipped[i // 8] ^= 1 << i % 8
        assert it.deserialize(bytes(flipped))[0] == ERROR, i
    assert all(it.deserialize(content[:size])[0] == ERROR for size in range(len(content)))
    assert it.deserialize(content + b"\0")[0] == ERROR
    assert "the state cannot be used" in it.messages()
    assert it.load(c_void_p()) == ERROR
    assert it.deserialize(content)[0] == OK
    other = Instance(fmu.copy(tmp_path / "other", lambda text: text + "# another\n")).start()
    assert other.deserialize(content)[0] == other.load(it.save()) == ERROR
    assert "that of another FMU, or of another build" in other.messages()


# Many instances.


def test_instances_do_not_disturb_each_other_in_turns_or_threads(fmu):
    alone = Instance(fmu).start().play(0, 40)
    source = random.Random(3)
    crowd = [Instance(fmu).start() for _ in range(6)]
    ticks = [0] * 6
    while min(ticks) < 20:
        i = source.randrange(6)
        if ticks[i] < 40:
            assert crowd[i].play(ticks[i], 1) == [alone[ticks[i]]]
            ticks[i] += 1
    for it in source.sample(crowd, 6):
        it.free()
    ends: list[Any] = []

    def work() -> None:
        it = Instance(fmu).start()
        ends.append(it.play(0, 40))
        it.free()

    threads = [threading.Thread(target=work) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(300.0)
    assert ends == [alone] * 6


@pytest.mark.parametrize("count", [50, pytest.param(2000, marks=pytest.mark.long)])
def test_instances_leave_nothing_behind(fmu, count, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    before = (0, 0)
    for i in range(count):
        if i == 30:
            gc.collect()
            before = resident(), len(os.listdir("/proc/self/fd"))  # noqa: PTH208
        it = Instance(fmu).start()
        it.steps(1)
        if i % 3:
            it("Terminate")
        it.free()
    gc.collect()
    assert len(os.listdir("/proc/self/fd")) == before[1]  # noqa: PTH208
    assert list(tmp_path.iterdir()) == []
    assert resident() - before[0] < MEMORY_NOISE + MEMORY_BOUND * count


def resident() -> int:
    """Resident memory of this process [kB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))
