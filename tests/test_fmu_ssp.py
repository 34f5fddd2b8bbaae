"""The coupled system as an SSP file: written, checked against the schema, and read."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from lxml import etree
from panda_cosim.fmus.build.ssp import (
    CONNECTORS_FILE,
    STRUCTURE_FILE,
    TABLES,
    panda_connections,
    write_panda_ssp,
)
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.inside.trajectory import HOME
from panda_cosim.fmus.master.ssp_reader import system_from_ssp
from panda_cosim.fmus.sources.targets import build, build_trajectory

SCHEMA = Path(fmpy.__file__).parent / "ssp" / "schema" / "SystemStructureDescription.xsd"
PARAMETERS = {"plant": {"block_pos[1]": 0.45, "block_mass": 0.2}}


@pytest.fixture(scope="module")
def fmus() -> dict[str, Path]:
    return build() | {"trajectory": build_trajectory(np.tile(HOME, (3, 1)))}


@pytest.fixture(scope="module")
def ssp(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_panda_ssp(tmp_path_factory.mktemp("ssp") / "Panda.ssp", fmus, PARAMETERS)


def structure(ssp: Path, name: str = STRUCTURE_FILE) -> str:
    with zipfile.ZipFile(ssp) as archive:
        return archive.read(name).decode()


@pytest.mark.parametrize("name", [STRUCTURE_FILE, CONNECTORS_FILE])
def test_the_structure_follows_the_schema(ssp: Path, name: str) -> None:
    document = etree.fromstring(structure(ssp, name).encode())
    etree.XMLSchema(etree.parse(SCHEMA)).assertValid(document)


def test_the_same_system_gives_the_same_bytes(
    fmus: dict[str, Path], ssp: Path, tmp_path: Path
) -> None:
    assert write_panda_ssp(tmp_path / "x.ssp", fmus, PARAMETERS).read_bytes() == ssp.read_bytes()


def test_every_input_connector_is_fed_and_every_unit_declared(ssp: Path) -> None:
    document = etree.fromstring(structure(ssp).encode())
    inputs = document.findall(".//{*}Connector[@kind='input']")
    connections = document.findall(".//{*}Connection")
    assert len(inputs) == len(connections) == len(panda_connections())
    used = {real.get("unit") for real in document.iterfind(".//{*}Connector/{*}Real")}
    assert used <= {unit.get("name") for unit in document.iterfind(".//{*}Unit")}


def test_the_system_as_one_block_has_hand_block_and_servo_targets(ssp: Path) -> None:
    system = etree.fromstring(structure(ssp, CONNECTORS_FILE).encode()).find("{*}System")
    shown = {c.get("name"): c for c in system.iterfind("{*}Connectors/{*}Connector")}
    assert {name.partition("[")[0] for name in shown} == {
        "hand_xpos", "hand_xquat", "target_xpos", "target_xmat", "ctrl"
    }  # fmt: skip
    own = [c for c in system.iterfind("{*}Connections/{*}Connection") if not c.get("endElement")]
    assert {c.get("endConnector") for c in own} == set(shown)
    assert all(c.get("startConnector") == c.get("endConnector") for c in own)


def test_it_is_read_as_it_was_written(ssp: Path) -> None:
    coupled = system_from_ssp(ssp)
    assert list(coupled.system.fmus) == list(TABLES)
    assert list(coupled.system.connections) == list(panda_connections())
    assert coupled.start_values == PARAMETERS
    assert (coupled.name, coupled.stop_time, coupled.step_size) == ("Panda", 6.5, 0.001)


def changed(ssp: Path, folder: Path, change: Callable[[str], str]) -> Path:
    """Copy an SSP with another structure."""
    target = folder / "changed.ssp"
    with zipfile.ZipFile(ssp) as source, zipfile.ZipFile(target, "w") as archive:
        for member in source.namelist():
            content = source.read(member)
            if member == STRUCTURE_FILE:
                text = change(content.decode())
                assert text != content.decode()
                content = text.encode()
            archive.writestr(member, content)
    return target


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("ssd:SystemStructureDescription", "ssd:Other", "root element"),
        ('startElement="plant"', 'startElement="plnt"', "components; did you mean 'plant'"),
        ('startElement="plant"', "", "must be with a connector"),
        ('startConnector="qvel[1]"', 'startConnector="qvl[1]"', "did you mean 'qvel[1]'"),
        ('endConnector="ctrl[1]"', 'endConnector="qpos[1]"', "must be from an output to an input"),
        ('name="jac[1,1]" kind="output"', 'name="jack" kind="output"', "a variable of its FMU"),
        ('name="jac[1,1]" kind="output"', 'name="jac[1,1]" kind="input"', "of kind 'input'"),
        ('source="resources/PandaPlant.fmu"', 'source="../PandaPlant.fmu"', "a path inside"),
        ('source="resources/PandaPlant.fmu"', 'source="resources/x.fmu"', "is missing"),
        ('source="resources/PandaPlant.fmu"', 'source="SystemStructure.ssd"', "d.ssp: Sy"),
        ('type="application/x-fmu-sharedlibrary"', 'type="x"', "of type 'x', implementation 'any'; must be an FMU"),
        ('name="controller"', 'name="plant"', "component name 'plant'; must be given, and unique"),
        ('<ssv:Real value="0.2"', '<ssv:Real value="heavy"', "= 'heavy'; must be of type Real"),
        ('<ssv:Real value="0.2"', '<ssv:Real value="99"',
         "changed.ssp: SystemStructure.ssd: parameter plant.block_mass: 99.0 kg is out of range"),
        ('<ssv:Real value="0.2"', '<ssv:Boolean value="true"', "must be one value of type Real"),
        ('<ssv:Real value="0.2"', '<ssv:Real value="0_2"', "= '0_2'; must be of type Real"),
        ('stepSize="0.001"', 'stepSize="-1"', "must be above 0"),
        ('stopTime="6.5"', 'stopTime="nan"', "stopTime = 'nan'; must be a finite number"),
        ("ssd:Component", "ssd:System", "no components; must be at least one"),
        ("xmlns:ssd=", "xmlns:sdd=", "not well-formed XML: unbound prefix"),
    ],
)  # fmt: skip
def test_a_broken_structure_is_refused_by_name(
    ssp: Path, tmp_path: Path, old: str, new: str, told: str
) -> None:
    bad = changed(ssp, tmp_path, lambda text: text.replace(old, new))
    with pytest.raises(InputError) as refused:
        system_from_ssp(bad)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_sensors_are_connected_between_plant_and_controller() -> None:
    plain, measured = panda_connections(), panda_connections(sensors=True)
    assert len({c.target for c in measured}) == len(measured)  # each input is fed once
    sources = {c.target: c.source for c in measured}
    assert sources["controller", "jac[6,7]"] == ("sensors", "jac_measured[6,7]")
    assert sources["sensors", "jac[6,7]"] == ("plant", "jac[6,7]")
    assert sources["sensors", "target_xpos[3]"] == ("plant", "target_xpos[3]")
    assert {c.target for c in plain} <= set(sources)
    assert {c.source[0] for c in measured if c.target[0] == "plant"} == {"controller"}
