"""The master runs FMUs of FMI 2.0 and 3.0, alone and mixed, and treats their answers alike."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_support import initialize, needs_compiler
from master_support import all_rows
from panda_cosim.fmus.errors import CosimError, InputError
from panda_cosim.fmus.interface.parameters import expand
from panda_cosim.fmus.interface.tables import Connection
from panda_cosim.fmus.interface.variables import Variable
from panda_cosim.fmus.master.fmi import open_slave
from panda_cosim.fmus.master.fmu_file import Fmu, described_interface, read_value
from panda_cosim.fmus.master.system import open_system
from panda_cosim.fmus.master.wiring import System
from toy_fmu import INDICES, toy_fmu

pytestmark = [pytest.mark.own_process, needs_compiler]
U, Y = ([f"{name}{index}" for index in INDICES] for name in "uy")


@pytest.fixture(scope="module", params=(2, 3), ids=("fmi2", "fmi3"))
def toy(request, tmp_path_factory):
    return toy_fmu(tmp_path_factory.mktemp("toy") / f"toy{request.param}.fmu", request.param)


def test_both_descriptions_read_the_same(tmp_path):
    two, three = (Fmu(toy_fmu(tmp_path / f"{fmi}.fmu", fmi)) for fmi in (2, 3))
    assert (two.fmi, three.fmi) == (2, 3)
    names = [name for name in three.variables if name != "time"]
    assert list(two.variables) == names == [*U, *Y, "k", "flip", "mode", "act"]
    for name in names:
        a, b = two.variables[name], three.variables[name]
        assert (a.unit, a.minimum, a.maximum) == (b.unit, b.minimum, b.maximum)
        same = ("kind", "causality", "choices", "numbers", "description")
        assert [getattr(a.variable, n) for n in same] == [getattr(b.variable, n) for n in same]
        assert a.start_value() == b.start_value()
    assert three.variables["u[2,1]"].element == 3


@pytest.mark.parametrize(
    ("gets", "sets"),
    [(Y, U), (Y[::-1], U[::-1]), (Y[1:3], U[4:]), (["y[2,2]", "y[1,1]"], ["u[1,1]"]),
     ([*Y, "k"], U[:3])],
)  # fmt: skip
def test_any_choice_of_elements_is_exchanged(toy, gets, sets):
    slave = open_slave("it", Fmu(toy))
    initialize(slave, {"k": 3.0, "flip": True, "mode": 2, "u[2,2]": 0.5})
    inputs, outputs = np.zeros((1, len(sets))), np.zeros((2, len(gets)))
    put, get = slave.bind_set(sets, inputs), slave.bind_get(gets, outputs)
    u = dict.fromkeys(U, 0.0) | {"u[2,2]": 0.5}
    for tick in range(5):
        inputs[:] = np.arange(len(sets)) + 10.0 * tick
        put(0)
        slave.step(tick * 0.001, 0.001)
        get(tick % 2)
        u |= {name: i + 10.0 * tick for i, name in enumerate(sets)}
        y = {f"y{n}": -2.0 * (3.0 * u[f"u{n}"] + tick * 0.001 + 0.001) for n in INDICES}
        expected = [(y | {"k": 3.0})[name] for name in gets]
        np.testing.assert_allclose(outputs[tick % 2], expected, atol=1e-12)
    slave.close()
    slave.close()


def fail(path: Path, act: str) -> tuple[str, list[str]]:
    """Step until what `act` says happens; return the error and all messages."""
    messages: list[str] = []
    slave = open_slave("it", Fmu(path), lambda _name, _category, text: messages.append(text))
    initialize(slave, {"act": act})
    error = ""
    try:
        for tick in range(4):
            slave.step(tick * 0.001, 0.001)
    except CosimError as raised:
        error = str(raised)
    slave.close()
    return error, messages


@pytest.mark.parametrize(
    ("act", "status", "calls"),
    [("warn", None, ["terminated", "freed"]), ("discard", "Discard", ["terminated", "freed"]),
     ("error", "Error", ["freed"]), ("fatal", "Fatal", []),
     ("complain", None, ["terminated", "freed"])],
)  # fmt: skip
def test_a_failed_fmu_is_called_no_more_than_fmi_allows(toy, act, status, calls):
    error, messages = fail(toy, act)
    said = "100 % as it was told"
    assert said in messages
    assert [message for message in messages if message != said] == calls
    if status is None:
        assert not error
    else:
        assert error.startswith("at t = 0.002 s, in FMU 'it': fmi")
        assert error.endswith(f"DoStep returned {status}: {said}")


def test_values_that_are_no_numbers_are_shown(tmp_path):
    blob = (
        '<Binary name="blob" valueReference="16" causality="parameter" variability="fixed">'
        '<Start value="666F6F"/></Binary><Clock name="tick" valueReference="17" '
        'causality="input" intervalVariability="triggered"/>'
    )
    path = toy_fmu(tmp_path / "toy.fmu", 3, more=blob)
    it = described_interface(Fmu(path))
    assert (it.variable("blob").kind, it.variable("blob").start) == ("Binary", "666F6F")
    assert Fmu(path).clocked == ["tick"]
    assert expand("toy", it, {"blob": "00"}) == {"blob": "00"}
    assert fail(path, "warn")[0] == ""


def test_an_fmu_that_is_not_instantiated_is_named(toy):
    with pytest.raises(CosimError, match="in FMU 'refused': cannot be instantiated"):
        open_slave("refused", Fmu(toy))


def couple(first: Path, second: Path, isolate: bool = False) -> Any:
    """Couple two of them, the second's outputs back to the first; returns the rows."""
    wires = [
        *(Connection(("a", y), ("b", u)) for y, u in zip(Y, U, strict=True)),
        Connection(("b", "y[1,2]"), ("a", "u[2,3]")),
    ]
    system = System({"a": first, "b": second}, wires, [("a", "u[1,1]")], {"a": Y, "b": Y})
    start = {"a": {"k": 0.5}, "b": {"flip": True}}
    with open_system(system, start, stop=1.0, isolate=isolate) as session:
        return all_rows(session.master, 300, np.arange(301.0).reshape(-1, 1))


def test_versions_are_coupled_and_agree(tmp_path):
    two, three = (toy_fmu(tmp_path / f"{fmi}.fmu", fmi) for fmi in (2, 3))
    expected = couple(two, two)
    assert expected.shape == (301, 14)
    assert np.ptp(expected[-3:]) > 1.0
    for first, second in ((two, three), (three, two), (three, three)):
        np.testing.assert_array_equal(couple(first, second), expected)
    np.testing.assert_array_equal(couple(three, two, isolate=True), expected)


@pytest.mark.parametrize(
    ("start", "number"),
    [("9223372036854775807", 2**63 - 1), ("-9007199254740993", -(2**53) - 1), (" 7 ", 7)],
)
def test_an_integer_starts_at_its_value_to_the_last_digit(start, number):
    """It is set again if another element of its array is given."""
    seed = Variable("seed", (2,), "", "parameter", "fixed", "", kind="Integer", fmi_type="Int64")
    value = read_value("seed", seed, start)
    first, _ = replace(seed, start=value).scalars(0)
    assert first.start_value() == first.checked("seed", value) == number
    with pytest.raises(InputError, match="a whole number from -9223372036854775808 to 92233720"):
        first.checked("seed", 2**63)


@pytest.mark.parametrize(("number", "name"), [("0", "off"), ("7", "on"), ("on", "on")])
def test_an_enumeration_is_known_by_name_and_set_by_number(number, name):
    """Whatever its items' numbers are."""
    mode = Variable("mode", (), "", "parameter", "fixed", "", kind="Enumeration",
                    choices=("off", "on"), numbers=(0, 7))  # fmt: skip
    assert read_value("mode", mode, number) == name
    (scalar,) = mode.scalars(0)
    assert scalar.converted(scalar.checked("mode", name)) == {"off": 0, "on": 7}[name]
    with pytest.raises(InputError, match="must be of type Enumeration"):
        read_value("mode", mode, "1")
