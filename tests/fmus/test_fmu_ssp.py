"""The coupled system as an SSP file: written, checked against the schema, and read."""

from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import fmpy
import pytest
from lxml import etree

from fmu_support import members, pack
from panda_cosim import load_scenario
from panda_cosim.fmus.build.ssp import CONNECTORS_FILE, STRUCTURE_FILE, WrittenSystem, write_ssp
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.master.ssp_reader import system_from_ssp
from panda_cosim.fmus.sources.targets import Target
from panda_cosim.run.written import written_system
from refusals import refused

SCHEMAS = {"1.0": Path(fmpy.__file__).parent / "ssp" / "schema"}
if package := find_spec("pyssp_standard"):
    SCHEMAS["2.0"] = Path(str(package.origin)).parent / "resources" / "ssp2"
PARAMETERS = "resources/plant.ssv"
VALUES = {"block_pos[1]": 0.45, "block_mass": 0.2}


def system(fmi: int, name: str = "pick_and_place", *, flat: bool = False) -> WrittenSystem:
    scenario = load_scenario(name)
    scenario = replace(scenario, plant={**scenario.plant, **VALUES})
    return written_system(scenario, Target(fmi=fmi, flat=flat))


@pytest.fixture(scope="module")
def ssps(tmp_path_factory):
    """The system by its version of SSP."""
    folder = tmp_path_factory.mktemp("ssp")
    return {f"{fmi - 1}.0": write_ssp(folder / f"{fmi}.ssp", system(fmi)) for fmi in (2, 3)}


@pytest.fixture(scope="module")
def ssp(ssps):
    return ssps["1.0"]


def structure(ssp: Path, name: str = STRUCTURE_FILE) -> str:
    return members(ssp)[name].decode()


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_all_files_follow_the_schemas_of_their_version(ssps, version):
    if version not in SCHEMAS:
        pytest.skip("no pyssp_standard")
    schemas = {"ssd": "Description", "ssv": "ParameterValues"}
    names = [name for name in members(ssps[version]) if name.endswith((".ssd", ".ssv"))]
    assert {STRUCTURE_FILE, CONNECTORS_FILE, PARAMETERS} <= {*names}
    for name in names:
        document = etree.fromstring(structure(ssps[version], name).encode())
        assert document.get("version") == version
        schema = SCHEMAS[version] / f"SystemStructure{schemas[name[-3:]]}.xsd"
        etree.XMLSchema(etree.parse(schema)).assertValid(document)


def test_the_same_system_gives_the_same_bytes(ssp, tmp_path):
    assert write_ssp(tmp_path / "x.ssp", system(2)).read_bytes() == ssp.read_bytes()


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_every_input_connector_is_fed_and_every_unit_declared(ssps, version):
    document = etree.fromstring(structure(ssps[version]).encode()).find("{*}System")
    inputs = {
        (component.get("name"), connector.get("name"))
        for component in document.iterfind("{*}Elements/{*}Component")
        for connector in component.iterfind("{*}Connectors/{*}Connector[@kind='input']")
    }
    connections = document.findall("{*}Connections/{*}Connection")
    assert inputs == {(c.get("endElement"), c.get("endConnector")) for c in connections}
    used = {typed.get("unit") for typed in document.iterfind(".//{*}Connector/*[@unit]")}
    assert used <= {unit.get("name") for unit in document.getparent().iterfind(".//{*}Unit")}


def test_connectors_of_fmi_3_are_the_variables_of_the_fmus(ssps):
    document = etree.fromstring(structure(ssps["2.0"]).encode())
    fmus = system_from_ssp(ssps["2.0"]).system.fmus
    for component in document.iterfind(".//{*}Component"):
        described = Fmu(fmus[component.get("name")]).description
        shapes = {variable.name: variable.shape or () for variable in described.modelVariables}
        connectors = component.findall("{*}Connectors/{*}Connector")
        assert connectors
        for connector in connectors:
            sizes = [int(d.get("size")) for d in connector.iterfind("{*}Dimension")]
            assert [*shapes[connector.get("name")]] == sizes


def test_the_system_as_one_block_has_hand_block_and_servo_targets(ssp):
    system = etree.fromstring(structure(ssp, CONNECTORS_FILE).encode()).find("{*}System")
    shown = {c.get("name"): c for c in system.iterfind("{*}Connectors/{*}Connector")}
    assert {name.partition("[")[0] for name in shown} == {
        "hand_xpos", "hand_xquat", "target_xpos", "target_xmat", "ctrl"
    }  # fmt: skip
    own = [c for c in system.iterfind("{*}Connections/{*}Connection") if not c.get("endElement")]
    assert {c.get("endConnector") for c in own} == set(shown)
    assert all(c.get("startConnector") == c.get("endConnector") for c in own)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("flat", [False, True])
def test_it_is_read_as_it_was_written(tmp_path, fmi, flat):
    """Our master's names of elements stay where the FMUs have flat ones."""
    written, path = system(fmi), write_ssp(tmp_path / "x.ssp", system(fmi, flat=flat))
    coupled = system_from_ssp(path)
    assert ('startConnector="jac_6_7"' in structure(path)) == (flat and fmi == 2)
    assert list(coupled.system.fmus) == ["controller", "plant", "trajectory"]
    assert set(coupled.system.connections) == {*written.connections}
    given = {name: dict(each.start_values) for name, each in written.components.items()}
    assert coupled.start_values == {name: values for name, values in given.items() if values}
    assert given["plant"].items() >= VALUES.items()
    assert (coupled.name, coupled.stop_time, coupled.step_size) == ("Panda", 6.5, 0.001)
    assert (coupled.coupling, dict(coupled.system.steps)) == ("gauss-seidel", {})


def changed(ssp: Path, folder: Path, change: Callable[[str], str]) -> Path:
    """Copy an SSP with another structure."""
    before = members(ssp)
    texts = {name: change(before[name].decode()) for name in (STRUCTURE_FILE, PARAMETERS)}
    after = before | {name: text.encode() for name, text in texts.items()}
    assert after != before
    return pack(folder / "changed.ssp", after)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("ssd:SystemStructureDescription", "ssd:Other", "root element"),
        ('startElement="plant"', 'startElement="plnt"', "components; did you mean 'plant'"),
        ('startElement="plant"', "", "must be with a connector"),
        ('startConnector="qvel[1]"', 'startConnector="qvl[1]"', "did you mean 'qvel[1]'"),
        ('name="jac[1,1]" kind="output"', 'name="jack" kind="output"', "a variable of its FMU"),
        ('source="resources/PandaPlant.fmu"', 'source="../PandaPlant.fmu"', "a file inside"),
        ('source="resources/PandaPlant.fmu"', 'source="SystemStructure.ssd"', "not a valid zip"),
        ('name="controller"', 'name="plant"', "component name 'plant'; must be given, and unique"),
        ('<ssv:Real value="0.2"', '<ssv:Real value="heavy"', "= 'heavy'; must be of type Real"),
        ('<ssv:Real value="0.2"', '<ssv:Real value="99"',
         "SystemStructure.ssd: resources/plant.ssv: parameter plant.block_mass: value 99"),
        ('stepSize="0.001"', 'stepSize="-1"', "must be above 0"),
        ('stopTime="6.5"', 'stopTime="nan"', "stopTime = 'nan'; must be a finite number"),
        ("ssd:Component", "ssd:System", "no components; must be at least one"),
        ("xmlns:ssd=", "xmlns:sdd=", "not well-formed XML: unbound prefix"),
    ],
)  # fmt: skip
def test_a_broken_structure_is_refused_by_name(ssp, tmp_path, old, new, told):
    bad = changed(ssp, tmp_path, lambda text: text.replace(old, new))
    assert told in refused(system_from_ssp, bad)


def test_sensors_are_connected_between_plant_and_controller():
    measured = system(2, "calibrated").connections
    assert len({c.target for c in measured}) == len(measured)  # each input is fed once
    sources = {c.target: c.source for c in measured}
    assert sources["controller", "jac[6,7]"] == ("sensors", "jac_measured[6,7]")
    assert sources["sensors", "jac[6,7]"] == ("plant", "jac[6,7]")
    assert sources["sensors", "target_xpos[3]"] == ("plant", "target_xpos[3]")
    assert {c.target for c in system(2).connections} <= set(sources)
    assert {c.source[0] for c in measured if c.target[0] == "plant"} == {"controller"}
