"""What SSP files of other tools may hold: each feature once, with values worked out by hand."""

import zipfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from fmu_support import REFERENCE_FMUS, needs_reference_fmus
from forked import command
from panda_cosim import InputError, Recording
from panda_cosim.fmus.interface import variables
from panda_cosim.fmus.interface.tables import Connection
from panda_cosim.fmus.master.fmu_file import described_interface, read_fmu
from panda_cosim.fmus.master.ssp_parameters import read_parameters
from panda_cosim.fmus.master.ssp_reader import CoupledSystem, system_from_ssp
from refusals import refused
from toy_fmu import toy_fmu

SPACES = "".join(
    f' xmlns:{nick}="http://ssp-standard.org/SSP1/SystemStructure{name}"'
    for nick, name in {"ssd": "Description", "ssc": "Common", "ssv": "ParameterValues",
                       "ssm": "ParameterMapping"}.items()
)  # fmt: skip
UNITS = (
    '<ssc:Unit name="N"><ssc:BaseUnit kg="1" m="1" s="-2"/></ssc:Unit>'
    '<ssc:Unit name="kN"><ssc:BaseUnit kg="1" m="1" s="-2" factor="1000"/></ssc:Unit>'
    '<ssc:Unit name="s"><ssc:BaseUnit s="1"/></ssc:Unit>'
)
TYPE = "application/x-fmu-sharedlibrary"


def ssd(elements: str, connections: str = "", more: str = "", version: str = "1.0") -> str:
    """A system; `more` are its connectors, and its parameter bindings."""
    wires = f"<ssd:Connections>{connections}</ssd:Connections>" if connections else ""
    return (
        f'<ssd:SystemStructureDescription{SPACES} version="{version}" name="n"><ssd:System '
        f'name="root">{more}<ssd:Elements>{elements}</ssd:Elements>{wires}</ssd:System>'
        f'<ssd:Units>{UNITS}</ssd:Units><ssd:DefaultExperiment stopTime="0.004"/>'
        "</ssd:SystemStructureDescription>"
    )


def toy(name: str, connectors: str = "", more: str = "", fmi: int = 2) -> str:
    """A component; its connectors are written as `u[1,1] y[2,3]`."""
    return (
        f'<ssd:Component name="{name}" type="{TYPE}" source="resources/toy{fmi}.fmu">'
        f"{connectors_of(connectors)}{more}</ssd:Component>"
    )


def connectors_of(names: str) -> str:
    kinds = {"u": "input", "y": "output"}
    return own(*(f"{n} {kinds.get(n[0], 'parameter')} <ssc:Real/>" for n in names.split()))


def own(*connectors: str) -> str:
    """Connectors, written as name, kind and perhaps content."""
    each = (
        f'<ssd:Connector name="{name}" kind="{kind}">{"".join(content)}</ssd:Connector>'
        for name, kind, *content in (text.split(" ", 2) for text in connectors)
    )
    return f"<ssd:Connectors>{''.join(each)}</ssd:Connectors>" if connectors else ""


def wire(start: str, end: str, change: str = "", more: str = "") -> str:
    """A connection between `element:connector`s; without an element, of the system itself."""
    sides = []
    for side, text in (("start", start), ("end", end)):
        element, _, name = text.rpartition(":")
        own = f'{side}Element="{element}" ' if element else ""
        sides.append(f'{own}{side}Connector="{name}"')
    return f"<ssd:Connection {' '.join(sides)} {more}>{change}</ssd:Connection>"


def linear(factor: float, offset: float = 0.0) -> str:
    return f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>'


def parameters(values: str, more: str = "", mapping: str = "") -> str:
    return (
        f"<ssd:ParameterBindings><ssd:ParameterBinding {more}><ssd:ParameterValues>"
        f"{parameter_set(values)}</ssd:ParameterValues>{mapping}</ssd:ParameterBinding>"
        "</ssd:ParameterBindings>"
    )


def parameter_set(values: str) -> str:
    return (
        f'<ssv:ParameterSet{SPACES} version="1.0" name="p"><ssv:Parameters>{values}'
        f"</ssv:Parameters><ssv:Units>{UNITS}</ssv:Units></ssv:ParameterSet>"
    )


def value(name: str, text: str, kind: str = "Real", more: str = "") -> str:
    return f'<ssv:Parameter name="{name}"><ssv:{kind} value="{text}" {more}/></ssv:Parameter>'


def mapping(*entries: str) -> str:
    return (
        f'<ssd:ParameterMapping><ssm:ParameterMapping version="1.0">{"".join(entries)}'
        "</ssm:ParameterMapping></ssd:ParameterMapping>"
    )


def entry(source: str, target: str, change: str = "", more: str = "") -> str:
    return (
        f'<ssm:MappingEntry source="{source}" target="{target}" {more}>{change}</ssm:MappingEntry>'
    )


@cache
def schema() -> etree.XMLSchema:
    folder = Path(str(find_spec("pyssp_standard").origin)).parent / "resources" / "ssp2"
    return etree.XMLSchema(etree.parse(folder / "SystemStructureDescription.xsd"))


def write(folder: Path, structure: str, **files: str | bytes) -> Path:
    """Write an .ssp; file names have `__` for the dot."""
    if find_spec("pyssp_standard"):
        schema().assertValid(etree.fromstring(structure.encode()))
    path = folder / "test.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", structure)
        for name, content in files.items():
            archive.writestr(f"resources/{name.replace('__', '.')}", content)
        for fmi in (2, 3):
            archive.write(toy_fmu(folder / f"toy{fmi}.fmu", fmi), f"resources/toy{fmi}.fmu")
    return path


def read(folder: Path, structure: str, **files: str | bytes) -> CoupledSystem:
    return system_from_ssp(write(folder, structure, **files))


def ends(system: CoupledSystem) -> dict[str, str]:
    return {".".join(c.target): ".".join(c.source) for c in system.system.connections}


IN_KN = own('force input <ssc:Real unit="kN"/>', "out output")
# a feeds b, which is within S, by way of a connector of S in kN; what b gives is the system's.
NESTED = (
    toy("a", "u[1,1] y[1,1]") + f'<ssd:System name="S">{IN_KN}'
    f"<ssd:Elements>{toy('b', 'u[2,3] y[2,3]')}</ssd:Elements><ssd:Connections>"
    f"{wire('force', 'b:u[2,3]', linear(2.0))}{wire('out', 'b:y[2,3]')}</ssd:Connections>"
    "</ssd:System>"
)
OUTSIDE = (
    wire("a:y[1,1]", "S:force", linear(3.0, 1.0))
    + wire("S:out", "result")
    + wire("a:u[1,1]", "given")
)
OWN = own("result output", "given input")


def test_nested_systems_convert_and_transform_on_the_way(tmp_path):
    ssp = write(tmp_path, ssd(NESTED, OUTSIDE, OWN + parameters(value("given", "0.5"))))
    coupled = system_from_ssp(ssp)
    assert list(coupled.system.fmus) == ["a", "S/b"]
    # N to kN, 3 x + 1 in kN, kN to N, 2 x
    expected = Connection(("a", "y[1,1]"), ("S/b", "u[2,3]"), factor=6.0, offset=2000.0)
    (connection,) = coupled.system.connections
    assert (connection.source, connection.target) == (expected.source, expected.target)
    assert connection.factor == pytest.approx(6.0, rel=1e-15)
    assert connection.offset == 2000.0
    words = ("--set", "S/b.k=4", "--coupling", "jacobi", "--out", tmp_path / "run")
    command("run", ssp, *words, code=0)
    recording = Recording.open(tmp_path / "run")
    time, y = recording.time, recording["a.y[1,1]"]
    np.testing.assert_allclose(y, 0.5 + time, rtol=1e-15)  # k = 1: the input of the system, and t
    given = 6.0 * y[:-1] + 2000.0  # with Jacobi, b takes what a gave at the beginning of the step
    np.testing.assert_allclose(recording["S/b.y[2,3]"][1:], 4.0 * given + time[1:], rtol=1e-12)


def test_an_empty_element_is_the_system_itself(tmp_path):
    plain = ssd(NESTED, OUTSIDE, OWN)
    written = plain.replace('endConnector="result"', 'endElement="" endConnector="result"')
    written = written.replace('<ssd:Connection startConnector="force"',
                              '<ssd:Connection startElement="" startConnector="force"')  # fmt: skip
    assert written.count('Element=""') == 2
    assert ends(read(tmp_path, written)) == ends(read(tmp_path, plain))


def test_a_parameter_set_for_any_fmus_is_read_in_their_units(tmp_path):
    fmu = described_interface(read_fmu(toy_fmu(tmp_path / "toy.fmu", 3)))
    file, load = tmp_path / "all.ssv", value("S.a.u", "1 2 3 4 5 6", "Float64", 'unit="kN"')
    load = load.replace("/></", '/><ssc:Dimension size="2"/><ssc:Dimension size="3"/></')
    file.write_text(parameter_set(load + value("b.mode", "twice", "Enumeration")))
    values = read_parameters(file, {"S/a": fmu, "b": fmu})
    names = [f"S/a.u[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)]
    loads = zip(names, (1000.0 * k for k in range(1, 7)), strict=True)
    assert values == {**dict(loads), "b.mode": "twice"}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (value("a.w", "1"), "parameter: value 'a.w'; must be a variable, as FMU.NAME"),
        (value("a.u[1,1]", "1", more='unit="s"'), "parameter a.u[1,1]: unit: value 's'; must be N"),
        (value("a.u[1,1]", "1", more='unit="lbf"'), "unit: value 'lbf'; must be N, or defined"),
    ],
)
def test_what_a_parameter_set_cannot_set_is_refused(tmp_path, text, told):
    fmu = described_interface(read_fmu(toy_fmu(tmp_path / "toy.fmu", 2)))
    file = tmp_path / "all.ssv"
    file.write_text(parameter_set(text))
    said = refused(read_parameters, file, {"a": fmu})
    assert said.startswith(f"{file}: ")
    assert told in said


def test_suppressed_conversions_leave_the_numbers(tmp_path):
    outside = OUTSIDE.replace(
        'endConnector="force" >', 'endConnector="force" suppressUnitConversion="true">'
    )
    coupled = read(tmp_path, ssd(NESTED, outside, OWN))
    (connection,) = coupled.system.connections
    # 3 x + 1, then kN to N, and 2 x
    assert (connection.factor, connection.offset) == (6000.0, 2000.0)


@pytest.mark.parametrize("sizes", [["300"], ["1000000000"] * 3])
def test_arrays_of_too_many_elements_are_refused_before_they_are_made(tmp_path, monkeypatch, sizes):
    monkeypatch.setattr(variables, "MOST_ELEMENTS", 500)
    lines = "".join(f'<Dimension start="{n}"/>' for n in sizes)
    two = [f'<Float64 name="{n}" valueReference="5{i}" causality="output">{lines}</Float64>'
           for i, n in enumerate(("r", "s"))]  # fmt: skip
    path = toy_fmu(tmp_path / "x.fmu", 3, "".join(two))
    with pytest.raises(InputError, match=r"x\.fmu: .*'[rs]': array elements up to here: value \d"):
        read_fmu(path)
    lines = "".join(f'<ssc:Dimension size="{n}"/>' for n in sizes)
    system = own(*(f"{name} output <ssc:Float64/>{lines}" for name in ("r", "s")))
    with pytest.raises(InputError, match=r"connector [rs]: array elements up to here: value \d"):
        read(tmp_path, ssd(toy("a", fmi=3), "", system, version="2.0"))


def test_arrays_are_connected_whole_or_by_element(tmp_path):
    sizes = '<ssc:Dimension size="2"/><ssc:Dimension size="3"/>'
    array = own(f"u input <ssc:Float64/>{sizes}", "y output <ssc:Float64/>")
    system = own('v output <ssc:Float64/><ssc:Dimension size="4"/>')
    parts = toy("a", fmi=3).replace("></ssd:Component>", f">{array}</ssd:Component>")
    connections = (
        wire("a:y", "b:u")
        + wire("b:y", "c:u[2,3]", more='startIndices="1 2"')
        + wire("c:y[1,1]", "a:u", more='endIndices="2 1"')
        + wire("a:y", "v", more='startIndices="2 2" endIndices="4"')
    )
    coupled = read(
        tmp_path,
        ssd(parts + parts.replace('name="a"', 'name="b"') + toy("c", "u[2,3] y[1,1]"),
            connections, system, version="2.0"),
    )  # fmt: skip
    assert ends(coupled) == {
        **{f"b.u[{i},{j}]": f"a.y[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)},
        "c.u[2,3]": "b.y[1,2]",
        "a.u[2,1]": "c.y[1,1]",
    }
    assert len(coupled.system.outputs["b"]) == 6


def test_parameters_of_higher_levels_and_later_bindings_take_precedence(tmp_path):
    own = parameters(value("k", "1") + value("u[1,1]", "7")).replace(
        "</ssd:ParameterBindings>",
        '<ssd:ParameterBinding source="resources/more.ssv"/></ssd:ParameterBindings>',
    )
    inner = (
        '<ssd:System name="S">' + parameters(value("b.k", "3") + value("b.u[1,2]", "8"))
        + f"<ssd:Elements>{toy('b', more=own)}</ssd:Elements></ssd:System>"
    )  # fmt: skip
    outer = parameters(value("b.u[1,2]", "9") + value("nobody", "1"), 'prefix="S."')
    coupled = read(
        tmp_path,
        ssd(inner, "", outer),
        more__ssv=parameter_set(value("k", "2") + value("u[1,3]", "2.5", more='unit="kN"')),
    )
    values = {"k": 3.0, "u[1,1]": 7.0, "u[1,2]": 9.0, "u[1,3]": 2500.0}
    assert coupled.start_values == {"S/b": values}
    (warning,) = coupled.warnings
    assert "SystemStructure.ssd: no variable is called S.nobody" in warning


def test_parameter_mappings_rename_and_transform(tmp_path):
    inverse = (
        '<ssc:BooleanMappingTransformation><ssc:MapEntry source="true" target="false"/>'
        '<ssc:MapEntry source="false" target="true"/></ssc:BooleanMappingTransformation>'
    )
    words = '<ssc:EnumerationMappingTransformation><ssc:MapEntry source="double" target="twice"/>' \
            "</ssc:EnumerationMappingTransformation>"  # fmt: skip
    entries = mapping(
        entry("kind", "mode", words),
        entry("right", "flip", inverse),
        entry("gain", "k", linear(2.0, -1.0)),
        entry("load", "u[1,1]", linear(2.0, 1.0)),
        entry("load", "u[1,2]", linear(2.0), 'suppressUnitConversion="true"'),
    )
    values = (
        value("gain", "3") + value("load", "0.5", more='unit="kN"') + value("k", "100")
        + value("kind", "double", "Enumeration") + value("right", "0", "Boolean")
    )  # fmt: skip
    coupled = read(tmp_path, ssd(toy("a", more=parameters(values, mapping=entries))))
    assert coupled.start_values == {
        "a": {"k": 5.0, "u[1,1]": 1001.0, "u[1,2]": 1.0, "mode": "twice", "flip": True}
    }
    assert not coupled.warnings  # what is not mapped is not applied


def test_parameters_of_a_system_s_connectors_reach_all_that_they_feed(tmp_path):
    values = value("gain", "2") + value("load", "3", more='unit="kN"')
    more = own("gain parameter", "load input") + parameters(values)
    connections = (
        wire("gain", "a:k") + wire("gain", "b:k", linear(2.0, 1.0)) + wire("load", "b:u[1,1]")
    )
    coupled = read(tmp_path, ssd(toy("a", "k") + toy("b", "k u[1,1]"), connections, more))
    assert coupled.start_values == {"a": {"k": 2.0}, "b": {"k": 5.0, "u[1,1]": 3000.0}}
    assert not coupled.system.connections


MAPS = '<ssc:BooleanMappingTransformation><ssc:MapEntry source="true" target="true"/>' \
       "</ssc:BooleanMappingTransformation>"  # fmt: skip
A, B = toy("a", "u[1,1] y[1,1]"), toy("b", "u[1,1] y[1,1]")
MASS = own('v input <ssc:Real unit="s"/>') + parameters(value("v", "1"))


@pytest.mark.parametrize(
    ("structure", "expected"),
    [
        (ssd(A + B, wire("a:y[1,1]", "b:y[1,1]")), "y[1,1]; must be from an output to an input"),
        (ssd(A + B, wire("a:y[1,1]", "b:u[1,1]") * 2), "b.u[1,1] is fed twice; must be fed once"),
        (ssd(A + B, wire("v", "b:u[1,1]"), MASS), "unit 's' feeds unit 'N'; must be the same"),
        (ssd(A, wire("a:y[1,1]", "a:u[1,1]", MAPS)),
         "a.u[1,1]: BooleanMappingTransformation; must be a LinearTransformation"),
        (ssd(toy("a", more=parameters(value("k", "2"), mapping=mapping(entry("k", "flip", MAPS))))),
         "= '2'; must be one of true, which are mapped"),
        (ssd('<ssd:SignalDictionaryReference name="d" dictionary="x"/>' + A),
         "SignalDictionaryReference 'd' of type"),
        (ssd(A.replace(TYPE, "application/x-ssp-package")), "ssp-package', implementation 'any'"),
        (ssd(A.replace(" source", ' implementation="ModelExchange" source')),
         "implementation 'ModelExchange'; must be a System, or a Comp"),
        (ssd(toy("a", more=parameters(value("k", "1 2")))),
         "a.k: number of values: value 2; must be 1"),
        (ssd(toy("a", more=parameters(value("u[1,1]", "1", more='unit="s"')))),
         "parameter a.u[1,1]: unit 's' feeds unit 'N'; must be the same"),
        (ssd(toy("a", more=parameters(value("mode", "thrice", "Enumeration")))),
         "parameter a.mode = 'thrice'; must be of type Enumeration"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path, structure, expected):
    said = refused(read, tmp_path, structure)
    assert said.startswith(f"{tmp_path / 'test.ssp'}: SystemStructure.ssd: ")
    assert expected in said


TYPES = {"Int32": ("Integer", "7"), "Boolean": ("Boolean", "true"), "String": ("String", "a b"),
         "Enumeration": ("Enumeration", "Option 2")}  # fmt: skip


@needs_reference_fmus
@pytest.mark.parametrize("fmi", [2, 3])
def test_connections_and_parameters_of_all_types(tmp_path, fmi):
    names = [f"{name}_{kind}put" for name in TYPES for kind in ("in", "out")]
    plain = own(*(f"{name} {name.rpartition('_')[2]}" for name in names))
    values = parameters("".join(value(f"{n}_input", v, k) for n, (k, v) in TYPES.items()))
    components = [
        toy(name, "x", more).replace(connectors_of("x"), plain)
        for name, more in (("a", values), ("b", ""))
    ]
    connections = "".join(wire(f"a:{name}_output", f"b:{name}_input") for name in TYPES)
    ssp = write(tmp_path, ssd("".join(components).replace("toy2", "Feedthrough"), connections))
    with zipfile.ZipFile(ssp, "a") as archive:
        archive.write(REFERENCE_FMUS / f"fmi{fmi}" / "Feedthrough.fmu", "resources/Feedthrough.fmu")
    command("run", ssp, "--out", tmp_path / "run", "--no-plot", code=0)
    recording = Recording.open(tmp_path / "run")
    last = {name: recording[f"b.{name}_output"][-1] for name in TYPES}
    assert last == {"Int32": 7, "Boolean": True, "String": "a b", "Enumeration": 2}
