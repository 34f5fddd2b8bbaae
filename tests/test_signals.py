"""What the master carries from FMU to FMU: numbers in units of their own."""

from __future__ import annotations

import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest

from fmu_support import needs_compiler
from forked import command
from panda_cosim import Recording
from toy_fmu import UNITS, library, toy_fmu

pytestmark = needs_compiler
STEP, TICKS = 0.1, 20  # s
TIMES = STEP * np.arange(TICKS + 1)


def described(fmu: Path, *changes: tuple[str, str]) -> Path:
    """Change texts in an FMU's description."""
    with zipfile.ZipFile(fmu) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    text = members["modelDescription.xml"].decode()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    members["modelDescription.xml"] = text.encode()
    with zipfile.ZipFile(fmu, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return fmu


def measuring(fmu: Path, version: int, unit: str, base: str) -> Path:
    """A toy, y = u + t, whose inputs and outputs have a unit."""
    definition = f'<UnitDefinitions><Unit name="{unit}">{base}</Unit></UnitDefinitions>'
    changes = ((UNITS, definition), ('unit="N"', f'unit="{unit}"'))
    return described(toy_fmu(fmu, version), *changes)


def run(folder: Path, text: str, *arguments: str) -> Recording:
    (folder / "scenario.toml").write_text(f"duration = {STEP * TICKS}\nstep = {STEP}\n{text}")
    out = folder / "run"
    quiet = ("--no-video", "--no-view", "--no-plot")
    command("run", folder, "--out", out, *quiet, *arguments, code=0)
    return Recording.open(out)


DEGREE = '<BaseUnit rad="1" factor="0.017453292519943295"/>'
CELSIUS = '<BaseUnit K="1" offset="273.15"/>'
FAHRENHEIT = '<BaseUnit K="1" factor="0.5555555555555556" offset="255.37222222222223"/>'


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
@pytest.mark.parametrize(
    ("source", "target", "wanted"),
    [
        (("deg", DEGREE), ("rad", '<BaseUnit rad="1"/>'), np.radians),
        (("rad", '<BaseUnit rad="1"/>'), ("deg", DEGREE), np.degrees),
        (("mm", '<BaseUnit m="1" factor="1e-3"/>'), ("m", '<BaseUnit m="1"/>'), lambda y: y / 1000),
        (("degC", CELSIUS), ("K", '<BaseUnit K="1"/>'), lambda y: y + 273.15),
        (("degF", FAHRENHEIT), ("degC", CELSIUS), lambda y: (y - 32) / 1.8),
    ],
    ids=lambda side: side[0] if isinstance(side, tuple) else "",
)
def test_units_are_converted_as_both_sides_define_them(tmp_path, source, target, wanted, isolate):
    measuring(tmp_path / "a.fmu", 2, *source)
    measuring(tmp_path / "b.fmu", 3, *target)
    recording = run(
        tmp_path,
        '[fmus]\na = "a.fmu"\nb = "b.fmu"\n[connect]\n"b.u[1,2]" = "a.y[2,1]"\n',
        *isolate,
    )
    given = TIMES[:-1] + STEP  # a's outputs after its step, in the row before
    np.testing.assert_array_equal(recording["a.y[2,1]"][:-1], given)
    np.testing.assert_allclose(recording["b.y[1,2]"][1:], wanted(given) + TIMES[1:], rtol=1e-14)
    assert recording.units["b.y[1,2]"] == target[0]


def test_differences_of_temperatures_have_no_offset(tmp_path):
    measuring(tmp_path / "a.fmu", 2, "degC", CELSIUS)
    measuring(tmp_path / "b.fmu", 3, "K", '<BaseUnit K="1"/>')
    kind = '<Float64Type name="difference" unit="K" relativeQuantity="true"/>'
    described(
        tmp_path / "b.fmu",
        ('unit="K"', 'unit="K" declaredType="difference"'),
        ("<TypeDefinitions>", f"<TypeDefinitions>{kind}"),
    )
    recording = run(
        tmp_path, '[fmus]\na = "a.fmu"\nb = "b.fmu"\n[connect]\n"b.u[1,2]" = "a.y[2,1]"\n'
    )
    wanted = recording["a.y[2,1]"][:-1] + TIMES[1:]
    np.testing.assert_allclose(recording["b.y[1,2]"][1:], wanted, rtol=1e-15)


def sizes_fmu(path: Path) -> None:
    """An FMU whose arrays u and y, y[i] = i * u[i] + t, have the size n."""
    dimension = '<Dimension valueReference="0"/>'
    text = (
        '<fmiModelDescription fmiVersion="3.0" modelName="sizes" instantiationToken="sizes">'
        '<CoSimulation modelIdentifier="sizes"/><ModelVariables>'
        '<UInt64 name="n" valueReference="0" causality="structuralParameter" variability="fixed" '
        'start="3" max="8"/>'
        f'<Float64 name="u" valueReference="1" causality="input" start="0">{dimension}</Float64>'
        f'<Float64 name="y" valueReference="2" causality="output">{dimension}</Float64>'
        '</ModelVariables><ModelStructure><Output valueReference="2"/></ModelStructure>'
        "</fmiModelDescription>"
    )
    source = Path(__file__).parent / "c_fmu" / "sizes.c"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr(f"binaries/{fmpy.platform_tuple}/sizes.so", library(source))


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
def test_structural_parameters_give_arrays_their_sizes(tmp_path, isolate):
    sizes_fmu(tmp_path / "it.fmu")
    text = '[fmus]\nit = "it.fmu"\n[parameters.it]\nn = 5\n[inputs]\n"it.u" = [1, 2, 3, 4, 5]\n'
    recording = run(tmp_path, text, *isolate)
    wanted = np.arange(1, 6) ** 2 + TIMES[:, np.newaxis]
    np.testing.assert_allclose(recording["it.y"], wanted, rtol=1e-15)
    done = command("check", tmp_path, "--set", "it.n=2.5")
    assert "it.fmu: n: 2.5; must be a whole multiple of 1" in done.stdout
    done = command("run", tmp_path, "--set", "it.n=4", code=2)
    assert "it.u: a list of 5; must be one number for all, or 4 values" in done.stderr


def test_an_fmu_of_one_step_size_is_asked_with_it(tmp_path):
    sizes_fmu(tmp_path / "it.fmu")
    fixed = 'modelIdentifier="sizes" fixedInternalStepSize="0.4"'
    described(tmp_path / "it.fmu", ('modelIdentifier="sizes"', fixed))
    recording = run(tmp_path, '[fmus]\nit = "it.fmu"\n')
    wanted = 4 * STEP * (np.arange(TICKS + 1) // 4)  # y[1] is the time that it has reached
    np.testing.assert_allclose(recording["it.y[1]"], wanted, rtol=1e-12)
    done = command("check", tmp_path)
    assert "it: supports a single step size, 0.4 s: 4 system steps" in " ".join(done.stdout.split())


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
def test_a_step_that_returns_early_is_taken_to_its_end(tmp_path, isolate):
    toy_fmu(tmp_path / "it.fmu", 3)
    text = '[fmus]\nit = "it.fmu"\n[inputs]\n"it.u" = 0.5\n[parameters.it]\nact = "early"\n'
    recording = run(tmp_path, text, *isolate)
    np.testing.assert_allclose(recording["it.y[2,3]"], 0.5 + TIMES, rtol=1e-15)


def test_clocks_and_clocked_variables_are_left_out_with_a_line(tmp_path):
    clocked = (
        '<Clock name="tick" valueReference="17" causality="input" intervalVariability="triggered"/>'
        '<Float64 name="w" valueReference="18" causality="input" clocks="17" variability="discrete"'
        ' start="0"/>'
    )
    toy_fmu(tmp_path / "it.fmu", 3, more=clocked)
    recording = run(tmp_path, '[fmus]\nit = "it.fmu"\n[inputs]\n"it.u" = 0.5\n')
    np.testing.assert_allclose(recording["it.y[1,1]"], 0.5 + TIMES, rtol=1e-15)
    said = " ".join(command("check", tmp_path).stdout.split())
    assert "it: clocks are not supported; left out: tick, w" in said


@pytest.mark.parametrize(
    ("output", "input_", "suggested"),
    [
        ("motor_torque_out", "motor_torque_in", True), ("speed", "Speed_cmd", True),
        ("force", "pressure", True), ("position", "velocity", False),
    ],
)  # fmt: skip
def test_check_suggests_connections_that_nearly_fit(tmp_path, output, input_, suggested):
    """By their names; or by unit, N here, if only one output has it and `position` has none."""
    for name, (old, new) in {"a": ("y", output), "b": ("u", input_)}.items():
        toy_fmu(tmp_path / f"{name}.fmu", 3)
        names = [(f'name="{old}"', f'name="{new}"')]
        if output == "position":
            names.append((f'name="{new}" valueReference="6" causality="output" unit="N"',
                          f'name="{new}" valueReference="6" causality="output"'))  # fmt: skip
        described(tmp_path / f"{name}.fmu", *names[: 2 if name == "a" else 1])
    (tmp_path / "scenario.toml").write_text(
        'duration = 1.0\n[fmus]\na = "a.fmu"\nb = "b.fmu"\n[connect]\n"a.u" = "b.y"\n'
    )
    said = " ".join(command("check", tmp_path).stdout.split())
    line = f'nothing feeds b.{input_}; perhaps [connect] "b.{input_}" = "a.{output}"'
    assert (line in said) == suggested


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
def test_an_fmu_is_told_that_its_steps_are_repeated(tmp_path, isolate):
    """It refuses to go back otherwise. The loop y = 0.5 y + t has the solution y = 2 t."""
    states = 'modelIdentifier="toy" canGetAndSetFMUState="true"'
    described(toy_fmu(tmp_path / "it.fmu", 3), ('modelIdentifier="toy"', states))
    text = '[fmus]\nit = "it.fmu"\n[connect]\n"it.u" = "it.y"\n[parameters.it]\nk = 0.5\n'
    recording = run(tmp_path, f'coupling = "iterated"\n{text}', *isolate)
    np.testing.assert_allclose(recording["it.y[2,2]"], 2.0 * TIMES, atol=1e-9)


def test_fmus_that_cannot_go_back_to_a_state_are_not_iterated(tmp_path):
    toy_fmu(tmp_path / "it.fmu", 3)
    text = 'duration = 1.0\ncoupling = "iterated"\n[fmus]\nit = "it.fmu"\n'
    (tmp_path / "scenario.toml").write_text(text)
    for name in ("run", "check"):
        done = command(name, tmp_path, cwd=tmp_path, code=2)
        said = " ".join((done.stdout + done.stderr).split())
        assert 'it.fmu: coupling = "iterated": it cannot restore its state; its FMU must' in said
