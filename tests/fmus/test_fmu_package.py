"""What is in an FMU of either kind, in both versions of FMI, and that it is the FMU's own."""

import html
import re
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from fmu_instance import ERROR, Instance, Unpacked, unpacked
from fmu_support import copy_libraries, in_fork
from panda_cosim import InputError
from panda_cosim.fmus.build.description import LOG_CATEGORIES, Layout, described
from panda_cosim.fmus.build.platforms import PLATFORMS, this_platform
from panda_cosim.fmus.interface.tables import INTERFACES, TRAJECTORY
from panda_cosim.fmus.interface.variables import Interface, Variable
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.sources.targets import Target, build, build_trajectory

TABLES = {**INTERFACES, "trajectory": TRAJECTORY}
SCHEMAS = Path(fmpy.__file__).parent / "schema"
MOST_BYTES = {"native": 3_500_000, "python": 200_000}


@pytest.fixture(
    scope="module",
    params=[Target("native"), Target("native", 3), Target("python"), Target("python", 3)],
    ids=lambda target: f"{target.kind}-{target.fmi}",
)
def target(request):
    built: Target = request.param
    return built


@pytest.fixture(scope="module", params=TABLES)
def name(request):
    model: str = request.param
    return model


@pytest.fixture(scope="module")
def path(target, name):
    if name == "trajectory":
        return build_trajectory(np.ones((5, 14)), target=target)
    return build((name,), target=target)[name]


def test_the_validator_and_the_schema_find_no_problem(path, target):
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        place = SCHEMAS / f"fmi{target.fmi}" / f"fmi{target.fmi}ModelDescription.xsd"
        schema = etree.XMLSchema(etree.parse(place))
        schema.assertValid(etree.fromstring(archive.read("modelDescription.xml")))
        if target.fmi == 3:
            schema = etree.XMLSchema(etree.parse(SCHEMAS / "fmi3" / "fmi3TerminalsAndIcons.xsd"))
            terminals = archive.read("terminalsAndIcons/terminalsAndIcons.xml")
            schema.assertValid(etree.fromstring(terminals))


def test_the_description_says_what_the_table_says(path, name, target):
    """Our master knows the elements of FMI 3.0's arrays by the names of FMI 2.0."""
    variables = Fmu(path).variables
    scalars = {s.name: s for s in TABLES[name].scalars()}
    assert [n for n in variables if n != "time"] == list(scalars)
    for n, s in scalars.items():
        v = variables[n]
        assert (v.variable.kind, v.variable.causality) == (s.variable.kind, s.variable.causality)
        assert s.value_reference == v.value_reference + (v.element if target.fmi == 3 else 0)
        assert v.unit == s.unit
        assert v.unit or v.variable.kind != "Real"
        if target.fmi == 2 or not v.variable.shape:
            assert (v.minimum, v.maximum) == (s.minimum, s.maximum)
        elif s.minimum is not None:  # an array of FMI 3.0 has one pair of bounds
            assert v.minimum <= s.minimum <= s.maximum <= v.maximum
        if s.start is not None:
            assert v.start_value() == v.converted(s.start)


def test_arrays_of_fmi_3_have_one_unit_and_people_see_degrees_and_millimetres():
    description = Fmu(build(("plant",), target=Target(fmi=3))["plant"]).description
    shown = {v.name: (v.shape or (), v.unit, v.displayUnit) for v in description.modelVariables}
    assert shown["qpos"] == shown["ctrl"] == ((7,), "rad", "deg")
    assert (shown["qpos_fingers"], shown["qpos_block"]) == (((2,), "m", "mm"), ((3,), "m", "mm"))
    assert shown["qpos_block_quat"] == ((4,), "1", None)
    assert shown["ctrl_gripper"] == ((), "1", None)
    assert (shown["jac"], shown["jac_angular"]) == (((3, 7), "m/rad", None), ((3, 7), "1", None))
    factors = {u.name: [d.factor for d in u.displayUnits] for u in description.unitDefinitions}
    assert [float(f) for f in (*factors["rad"], *factors["m"])] == [np.rad2deg(1.0), 1000.0]


@pytest.mark.parametrize(
    ("target", "name", "count"),
    [(Target(flat=True), "jac_6_7", 248), (Target(scalars=True, fmi=3), "qpos[8]", 249)],
)
def test_importers_that_want_scalars_or_plain_names_get_them(target, name, count):
    path = build(("plant",), target=target)["plant"]
    assert validate_fmu(str(path)) == []
    variables = {v.name: v for v in Fmu(path).description.modelVariables}
    assert len(variables) == count
    assert not any(v.shape for v in variables.values())
    assert target.flat == all(n.isidentifier() for n in variables)
    result = fmpy.simulate_fmu(str(path), stop_time=0.003, step_size=0.001, output=[name])
    plain = build(("plant",))["plant"]
    whole = fmpy.simulate_fmu(str(plain), stop_time=0.003, step_size=0.001,
                              output=["qpos[8]", "jac[6,7]"])  # fmt: skip
    assert list(result[name]) == list(whole["jac[6,7]" if name.startswith("jac") else "qpos[8]"])


def test_names_that_would_be_equal_are_refused():
    rows = tuple(
        Variable(n, s, "m", "output", "continuous", "") for n, s in (("a", (2,)), ("a_1", ()))
    )
    with pytest.raises(InputError, match="two variables would have the name 'a_1'"):
        described(Interface("M", "", rows), Layout(flat=True))


@pytest.mark.parametrize("version", [2, 3])
def test_an_importer_can_bind_all_functions_of_the_standard(version):
    """Those for model exchange and events return an error."""
    header = Path(fmpy.__file__).parent / "c-code" / f"fmi{version}Functions.h"
    pattern = rf"#define (fmi{version}\w+) +fmi{version}FullName"
    names = re.findall(pattern, header.read_text())
    assert len(names) > 40
    instance = Instance(unpacked("native", "plant", version))
    assert not [name for name in names if not hasattr(instance.dll, name)]
    for name in ("EnterEventMode", "EnterContinuousTimeMode"):
        assert instance(name) == ERROR
    instance.free()


def test_no_output_depends_on_an_input_and_no_type_is_called_as_a_variable(path):
    """Neither FMI version allows the latter; FMPy's validator does not look."""
    description = Fmu(path).description
    outputs = [v for v in description.modelVariables if v.causality == "output"]
    assert [u.variable for u in description.outputs] == outputs
    assert all(u.dependencies == [] for u in description.outputs)
    assert [u.variable for u in description.initialUnknowns] == outputs
    assert [c.name for c in description.logCategories] == list(LOG_CATEGORIES)
    types = {each.name for each in description.typeDefinitions}
    assert not types & {variable.name for variable in description.modelVariables}


def test_an_fmu_is_small_and_holds_libraries_papers_and_no_local_path(path, target, name):
    platform, is_native = PLATFORMS[this_platform()], target.kind == "native"
    folder = f"binaries/{platform.fmi2 if target.fmi == 2 else platform.fmi3}"
    assert path.stat().st_size <= MOST_BYTES[target.kind]
    with zipfile.ZipFile(path) as archive:
        members = {n: archive.read(n) for n in archive.namelist()}
    assert f"{folder}/{TABLES[name].model}{platform.suffix}" in members
    assert (f"{folder}/{platform.mujoco}" in members) == (is_native and name != "trajectory")
    assert b"Apache License" in members["documentation/licenses/license.txt"]
    places = (str(Path(__file__).parents[2]).encode(), b"site-packages")
    recorded = {n for n, content in members.items() if any(place in content for place in places)}
    assert recorded == (set() if is_native else {"resources/variables.txt"})
    assert any(n.endswith(".py") for n in members) == (not is_native)
    needs = members["documentation/externalDependencies.txt"].decode()
    assert ("numpy 2.3" in needs) == (not is_native)


def test_an_fmu_brings_its_documentation_and_picture(path, name, target):
    with zipfile.ZipFile(path) as archive:
        page = archive.read("documentation/index.html").decode()
        icon = "model.png" if target.fmi == 2 else "terminalsAndIcons/icon.png"
        assert archive.read(icon).startswith(b"\x89PNG")
    for variable in TABLES[name].variables:
        for array in variable.arrays():
            assert array.description in html.unescape(page)
        assert f">{variable.name}" in page
    etree.fromstring(page.partition("\n")[2].replace('<meta charset="utf-8">', "").encode(),
                     etree.HTMLParser(recover=False))  # fmt: skip


@pytest.mark.parametrize("target", [Target(), Target("python", 3)], ids=str)
def test_the_same_content_gives_the_same_bytes(target, tmp_path, monkeypatch):
    first = {name: path.read_bytes() for name, path in build(target=target).items()}
    copy_libraries(tmp_path / "libraries")
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path))
    assert {name: path.read_bytes() for name, path in build(target=target).items()} == first


# What it does in a host.


def three_steps(fmu: Unpacked) -> list[float]:
    """Outputs after three steps."""
    it = Instance(fmu).start()
    it.steps(3)
    return it.outputs()


@pytest.mark.own_process
@pytest.mark.parametrize("kind", ["native", "python"])
@pytest.mark.parametrize("name", TABLES)
def test_start_values_are_those_of_the_binary(kind, name):
    fmu = unpacked(kind, name, 2)
    it = Instance(fmu)
    for parameter in fmu.names("parameter"):
        assert it.get(parameter) == list(fmu.rows[parameter].start)


@pytest.mark.parametrize("name", TABLES)
def test_an_fmu_runs_its_own_modules_and_from_another_folder(name, tmp_path):
    fmu = unpacked("python", name, 2)
    expected = in_fork(three_steps, fmu)
    for module in ("plant", "controller", "assets", "fmus"):
        (tmp_path / f"{module}.py").write_text("raise RuntimeError('the host's module was run')")

    def poisoned() -> list[list[float]]:
        own = ("plant", "controller", "assets", "fmus")
        for module in [m for m in sys.modules if m.partition(".")[0] in own]:
            del sys.modules[module]
        sys.path.insert(0, str(tmp_path))
        sys.modules["fmus"] = ModuleType("fmus")
        first = three_steps(fmu.copy(tmp_path / "b c+ä"))
        (tmp_path / "b c+ä").rename(tmp_path / "gone")
        return [first, three_steps(fmu.copy(tmp_path / "elsewhere"))]

    assert in_fork(poisoned) == [expected, expected]
