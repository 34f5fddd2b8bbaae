"""What the master carries from FMU to FMU: numbers in units of their own."""

from pathlib import Path

import fmpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_support import members, needs_compiler, pack
from forked import QUIET, command
from odd_fmu import odd_fmu, odd_ssp
from panda_cosim import Recording, load_scenario
from panda_cosim.fmus.interface.types import is_lossless
from panda_cosim.fmus.interface.units import PLAIN, Unit, conversion, doubt
from panda_cosim.fmus.interface.variables import Variable
from panda_cosim.run.prepare import prepare
from panda_cosim.study.check.diagnosis import check_folder, rehearse
from toy_fmu import UNITS, library, toy_fmu

pytestmark = needs_compiler
STEP, TICKS = 0.1, 20  # s
TIMES = STEP * np.arange(TICKS + 1)


def described(fmu: Path, *changes: tuple[str, str]) -> Path:
    """Change texts in an FMU's description."""
    content = members(fmu)
    text = content["modelDescription.xml"].decode()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return pack(fmu, content | {"modelDescription.xml": text.encode()})


def measuring(fmu: Path, version: int, unit: str, base: str = "") -> Path:
    """A toy, y = u + t, whose inputs and outputs have a unit, which may be defined, or none."""
    definition = f'<UnitDefinitions><Unit name="{unit}">{base}</Unit></UnitDefinitions>'
    named = f' unit="{unit}"' if unit else ""
    changes = ((UNITS, definition if unit else ""), (' unit="N"', named))
    return described(toy_fmu(fmu, version), *changes)


def run(folder: Path, text: str, *arguments: str) -> Recording:
    (folder / "scenario.toml").write_text(f"duration = {STEP * TICKS}\nstep = {STEP}\n{text}")
    out = folder / "run"
    command("run", folder, "--out", out, *QUIET, *arguments, code=0)
    return Recording.open(out)


DEGREE = '<BaseUnit rad="1" factor="0.017453292519943295"/>'
RADIAN, METRE, KELVIN = (f'<BaseUnit {unit}="1"/>' for unit in ("rad", "m", "K"))
MILLI = '<BaseUnit m="1" factor="1e-3"/>'
CELSIUS = '<BaseUnit K="1" offset="273.15"/>'
FAHRENHEIT = '<BaseUnit K="1" factor="0.5555555555555556" offset="255.37222222222223"/>'
TON, SHORT_TON = (f'<BaseUnit kg="1" factor="{factor}"/>' for factor in (1000, 907.18474))


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
    wanted = recording["a.y[2,1]"][1:] + TIMES[1:]
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
    source = Path(__file__).parents[1] / "c_fmu" / "sizes.c"
    binary = f"binaries/{fmpy.platform_tuple}/sizes.so"
    pack(path, {"modelDescription.xml": text, binary: library(source)})


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
def test_structural_parameters_give_arrays_their_sizes(tmp_path, isolate):
    sizes_fmu(tmp_path / "it.fmu")
    text = '[fmus]\nit = "it.fmu"\n[parameters.it]\nn = 5\n[inputs]\n"it.u" = [1, 2, 3, 4, 5]\n'
    recording = run(tmp_path, text, *isolate)
    wanted = np.arange(1, 6) ** 2 + TIMES[:, np.newaxis]
    np.testing.assert_allclose(recording["it.y"], wanted, rtol=1e-15)
    done = command("check", tmp_path, "--set", "it.n=2.5")
    assert "it.fmu: n: value 2.5; must be a whole multiple of 1" in done.stdout
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
        ("force", "pressure", False),
    ],
)  # fmt: skip
def test_check_suggests_connections_that_nearly_fit(tmp_path, output, input_, suggested):
    for name, (old, new) in {"a": ("y", output), "b": ("u", input_)}.items():
        toy_fmu(tmp_path / f"{name}.fmu", 3)
        described(tmp_path / f"{name}.fmu", (f'name="{old}"', f'name="{new}"'))
    (tmp_path / "scenario.toml").write_text(
        'duration = 1.0\n[fmus]\na = "a.fmu"\nb = "b.fmu"\n[connect]\n"a.u" = "b.y"\n'
    )
    said = " ".join(command("check", tmp_path).stdout.split())
    line = f'nothing feeds b.{input_}; perhaps [connect] "b.{input_}" = "a.{output}"'
    assert (line in said) == suggested


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
def test_an_fmu_is_told_that_its_steps_are_repeated(tmp_path, isolate):
    """It refuses to go back otherwise. The loop y = 0.5 z + t, z = 0.5 y + t has y = z = 2 t."""
    states = 'modelIdentifier="toy" canGetAndSetFMUState="true"'
    described(toy_fmu(tmp_path / "it.fmu", 3), ('modelIdentifier="toy"', states))
    text = 'coupling = "iterated"\n[fmus]\na = "it.fmu"\nb = "it.fmu"\n[connect]\n"a.u" = "b.y"\n'
    text += '"b.u" = "a.y"\n[parameters.a]\nk = 0.5\n[parameters.b]\nk = 0.5\n'
    recording = run(tmp_path, text, *isolate)
    for name in ("a", "b"):
        np.testing.assert_allclose(recording[f"{name}.y[2,2]"], 2.0 * TIMES, atol=1e-9)
    assert (recording["coupling.iterations"][1:] > 1).all()


def test_fmus_that_cannot_go_back_to_a_state_are_not_iterated(tmp_path):
    toy_fmu(tmp_path / "it.fmu", 3)
    text = 'duration = 1.0\ncoupling = "iterated"\n[fmus]\nit = "it.fmu"\n'
    (tmp_path / "scenario.toml").write_text(text)
    for name in ("run", "check"):
        done = command(name, tmp_path, cwd=tmp_path, code=2)
        said = " ".join((done.stdout + done.stderr).split())
        assert 'it.fmu: coupling = "iterated": it cannot restore its state; its FMU must' in said


# Units and types of the two ends of a connection, of FMUs in FMI 2.0 and 3.0.


NUMBERS = st.floats(1e-3, 1e3)
DEFINED = st.builds(
    Unit, st.sampled_from([(1,) + (0,) * 7, (0, 1) + (0,) * 6]), NUMBERS, st.floats(-1e3, 1e3)
)
NAMES = st.sampled_from(["", "1", "a", "b"])
DEFINITIONS = st.dictionaries(st.sampled_from(["a", "b"]), DEFINED)


@given(source=NAMES, sources=DEFINITIONS, target=NAMES, targets=DEFINITIONS)
def test_definitions_decide_not_names(source, sources, target, targets):
    scale = conversion(source, sources, target, targets)
    one, other = sources.get(source), targets.get(target)
    if one and other:
        assert (scale is None) == (one.exponents != other.exponents)
        assert doubt(source, sources, target, targets) == ""
        if scale is not None:  # both are the same value in base units
            value = scale[0] * 3.0 + scale[1]
            base = one.factor * 3.0 + one.offset
            error = abs(other.factor * value + other.offset - base)
            assert error <= 1e-9 * (abs(base) + abs(other.offset) + 1.0)
    else:
        assert scale == PLAIN
        is_known = source == target or {source, target} <= {"", "1"}
        assert bool(doubt(source, sources, target, targets)) != is_known


def system(folder: Path, connect: str) -> Path:
    (folder / "scenario.toml").write_text(
        'purpose = "x"\nduration = 0.01\n[fmus]\na = "a.fmu"\nb = "b.fmu"\n[connect]\n'
        f'"b.u[1,1]" = "{connect}"\n[inputs]\n"a.u[1,1]" = 4.0\n[success]\n'
    )
    return folder


def said(folder: Path) -> str:
    return " | ".join(f"{each.level} {each.text}" for each in check_folder(folder))


@pytest.mark.own_process
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("one", "other", "wanted", "told"),
    [
        (("deg", DEGREE), ("rad", RADIAN), np.radians, "good b.u [rad] = 0.0174533 * a.y [deg] + "),
        (("rad", RADIAN), ("deg", DEGREE), np.degrees, ""),
        (("mm", MILLI), ("m", METRE), lambda y: y / 1000, ""),
        (("degC", CELSIUS), ("K", KELVIN), lambda y: y + 273.15, "K] = 1 * a.y [degC] + 273.15"),
        (("degF", FAHRENHEIT), ("degC", CELSIUS), lambda y: (y - 32) / 1.8, ""),
        (("t", TON), ("t", SHORT_TON), lambda y: y * 1000 / 907.18474, "t] = 1.10231 * a.y [t] + "),
        (("t", TON), ("t", ""), lambda y: y, ""),
        (("Nm", ""), ("N.m", TON), lambda y: y,
         "hint b: no definition of Nm, so values are taken as they are: b.u [N.m] from a.y [Nm]"),
        (("", ""), ("t", TON), lambda y: y, "hint b: only one side has a unit, so values are"),
    ],
)  # fmt: skip
def test_values_are_converted_or_the_user_is_told(tmp_path, fmi, one, other, wanted, told):
    measuring(tmp_path / "a.fmu", fmi, *one)
    measuring(tmp_path / "b.fmu", 5 - fmi, *other)
    checked = said(system(tmp_path, "a.y[1,1]"))
    assert told in checked
    assert told or not any(word in checked for word in ("no definition", "one side"))
    recording = rehearse(prepare(load_scenario(tmp_path))).recording
    giving, taking, time = recording["a.y"], recording["b.y"], recording.time
    # b.y = u + t after the step, of whose end u is
    expected = wanted(giving[1:, 0, 0]) + time[1:]
    assert taking[1:, 0, 0] == pytest.approx(expected, rel=1e-12)
    assert recording.units["b.y[1,2]"] == other[0]


@pytest.mark.own_process
@pytest.mark.parametrize("fmi", [2, 3])
def test_what_cannot_be_converted_is_refused_unless_it_is_asked_for(tmp_path, fmi):
    measuring(tmp_path / "a.fmu", fmi, "t", TON)
    measuring(tmp_path / "b.fmu", 5 - fmi, "t", METRE)
    refused = said(system(tmp_path, "a.y[1,1]"))
    assert "must have the same unit, or both be defined by the same SI base units" in refused
    assert '"b.u[1,1]" = "convert(a.y[1,1])"' in refused
    assert "wrong" not in said(system(tmp_path, "convert(a.y[1,1])"))
    recording = rehearse(prepare(load_scenario(tmp_path))).recording
    assert recording["b.y"][-1, 0, 0] == recording["a.y"][-1, 0, 0] + recording.time[-1]


ITEMS = st.dictionaries(st.sampled_from("abcd"), st.integers(-3, 3), max_size=4)


def enumeration(items: dict[str, int]) -> Variable:
    """Two names of an enumeration never have one number."""
    unique = {number: name for name, number in items.items()}
    names, numbers = tuple(unique.values()), tuple(unique)
    return Variable("e", (), "", "input", "discrete", "", kind="Enumeration", choices=names,
                    numbers=numbers, fmi_type="Enumeration")  # fmt: skip


@given(one=ITEMS, other=ITEMS)
def test_an_enumeration_feeds_one_with_its_numbers_and_no_other_names_for_them(one, other):
    source, target = enumeration(one), enumeration(other)
    ours = dict(zip(source.choices, source.numbers, strict=True))
    theirs = dict(zip(target.choices, target.numbers, strict=True))
    clashes = any(name in theirs and theirs[name] != number for name, number in ours.items())
    has_all = all(number in theirs.values() for number in ours.values())
    assert is_lossless(source, target) == (not theirs or (has_all and not clashes))


ENUMERATED = (
    '<fmiModelDescription fmiVersion="2.0" modelName="Odd" guid="odd">'
    '<CoSimulation modelIdentifier="odd"/><TypeDefinitions><SimpleType name="modes">'
    '<Enumeration><Item name="off" value="-1"/><Item name="low" value="0"/></Enumeration>'
    '</SimpleType></TypeDefinitions><ModelVariables><ScalarVariable name="e" valueReference="0" '
    'causality="input" variability="discrete"><Enumeration declaredType="modes" start="0"/>'
    '</ScalarVariable><ScalarVariable name="z" valueReference="100" causality="output" '
    'variability="discrete"><Integer/></ScalarVariable></ModelVariables><ModelStructure/>'
    "</fmiModelDescription>"
)


@pytest.mark.own_process
def test_an_integer_feeds_an_enumeration_while_it_is_one_of_its_numbers(tmp_path):
    """The integer counts from its parameter on: -1, 0, 1."""
    odd_fmu(tmp_path / "a.fmu", [("n", "Integer", "parameter", 0), ("y", "Integer", "output", 100)])
    pack(tmp_path / "b.fmu", members(tmp_path / "a.fmu") | {"modelDescription.xml": ENUMERATED})
    text = 'duration = 0.01\ncoupling = "jacobi"\n[fmus]\na = "a.fmu"\nb = "b.fmu"\n'
    text += '[connect]\n"b.e" = "a.y"\n[parameters.a]\nn = -1\n'
    (tmp_path / "scenario.toml").write_text(text)
    run = rehearse(prepare(load_scenario(tmp_path)))
    assert not run.summary.complete
    reason = "at t = 0.002 s, in FMU 'b', variable e: value 1.0; must be -1 (off), 0 (low)"
    assert reason in str(run.summary.reason)
    assert run.recording["b.z"][1] == 0.0  # -1, and one step


def test_an_unknown_unit_in_a_parameter_set_is_told_and_refuses_nothing(tmp_path):
    toy = toy_fmu(tmp_path / "toy.fmu", 2)
    values = '<ssv:Parameter name="u[1,1]"><ssv:Real value="0.5" unit="[N]"/></ssv:Parameter>'
    ssp = odd_ssp(tmp_path / "x.ssp", {"c": toy}, {"c": ["y[1,1]"]}, {"c": values})
    done = command("run", "--system", ssp, "--no-video", "--out", tmp_path / "run", code=0)
    told = "parameter c.u[1,1]: no definition of [N], so the value is taken as it is"
    assert told in " ".join(done.stderr.split())
    assert Recording.open(tmp_path / "run")["c.y[1,1]"][0] == 0.5
