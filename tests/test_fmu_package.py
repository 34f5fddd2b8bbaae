"""What is in an FMU in Python, and that it is the FMU's own."""

from __future__ import annotations

import html
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fmpy
import fmu_jobs
import numpy as np
import pytest
from fmu_support import in_process
from lxml import etree
from panda_cosim.controller import controller as controller_module
from panda_cosim.fmus.build.description import shaped_name
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.inside.base import LOG_CATEGORIES
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.fmus.interface.trajectory import TRAJECTORY
from panda_cosim.fmus.interface.variables import Causality, Value
from panda_cosim.fmus.sources.targets import (
    Target,
    build,
    build_fmu,
    build_trajectory,
    own_code,
    own_fmu,
)
from panda_cosim.plant import plant as plant_module

TABLES = {**INTERFACES, "trajectory": TRAJECTORY}
NAMES = tuple(TABLES)
SCHEMAS = Path(fmpy.__file__).parent / "schema" / "fmi2"
MAX_BYTES = 200_000


@pytest.fixture(scope="module")
def fmus() -> dict[str, Path]:
    return build(target=Target("python")) | {
        "trajectory": build_trajectory(np.ones((5, 14)), target=Target("python"))
    }


@pytest.mark.parametrize("name", NAMES)
def test_the_description_follows_the_schema(fmus: dict[str, Path], name: str) -> None:
    schema = etree.XMLSchema(etree.parse(SCHEMAS / "fmi2ModelDescription.xsd"))
    with zipfile.ZipFile(fmus[name]) as archive:
        document = etree.fromstring(archive.read("modelDescription.xml"))
    schema.assertValid(document)


@pytest.mark.parametrize("name", NAMES)
def test_an_fmu_is_small(fmus: dict[str, Path], name: str) -> None:
    assert fmus[name].stat().st_size < MAX_BYTES


@pytest.mark.parametrize("name", NAMES)
def test_the_description_says_what_the_table_says(fmus: dict[str, Path], name: str) -> None:
    found = Fmu(fmus[name]).variables
    scalars = TABLES[name].scalars()
    assert list(found) == [s.name for s in scalars]
    for s in scalars:
        v = found[s.name]
        assert (v.value_reference, v.variable.causality) == (
            s.value_reference,
            s.variable.causality,
        )
        assert (v.variable.kind, v.unit) == (s.variable.kind, s.unit)
        assert v.variable.description == s.variable.description
        assert v.unit or v.variable.kind != "Real"
        for said, bound in ((v.minimum, s.minimum), (v.maximum, s.maximum)):
            assert (said is None) == (bound is None)
            assert bound is None or float(said) == bound


def _starts(path: Path) -> Iterator[tuple[str, str, Value]]:
    for name, v in Fmu(path).variables.items():
        if v.start is not None:
            yield name, v.variable.kind, v.start


@pytest.mark.fmu
@pytest.mark.parametrize("name", NAMES)
def test_start_values_are_those_of_the_binary(fmus: dict[str, Path], name: str) -> None:
    starts = [(n, v) for n, kind, v in _starts(fmus[name]) if kind == "Real"]
    names = [n for n, _ in starts]
    held = in_process(fmu_jobs.scripted, str(fmus[name]), [["get", *names]])["results"][0]
    assert held == [float(v) for _, v in starts]


@pytest.mark.parametrize(
    ("name", "causality", "dtype"),
    [("plant", "input", plant_module.INPUTS), ("plant", "output", plant_module.OUTPUTS),
     ("controller", "input", controller_module.INPUTS),
     ("controller", "output", controller_module.OUTPUTS)],
)  # fmt: skip
def test_a_table_fits_its_buffer(name: str, causality: Causality, dtype: np.dtype[Any]) -> None:
    fields = dtype.fields or {}
    table = [(v.name, v.shape) for v in TABLES[name].of(causality)]
    assert table == [(field, fields[field][0].shape) for field in dtype.names or ()]


@pytest.mark.parametrize("name", NAMES)
def test_no_output_depends_on_an_input(fmus: dict[str, Path], name: str) -> None:
    description = Fmu(fmus[name]).description
    outputs = [v for v in description.modelVariables if v.causality == "output"]
    assert [u.variable for u in description.outputs] == outputs
    assert all(u.dependencies == [] for u in description.outputs)
    assert [u.variable for u in description.initialUnknowns] == outputs


@pytest.mark.parametrize("name", NAMES)
def test_log_categories_are_declared(fmus: dict[str, Path], name: str) -> None:
    declared = [c.name for c in Fmu(fmus[name]).description.logCategories]
    assert declared == list(LOG_CATEGORIES)


@pytest.mark.parametrize("name", NAMES)
def test_an_fmu_brings_its_documentation_licences_and_picture(
    fmus: dict[str, Path], name: str
) -> None:
    with zipfile.ZipFile(fmus[name]) as archive:
        page = archive.read("documentation/index.html").decode()
        assert b"Apache License" in archive.read("documentation/licenses/license.txt")
        assert archive.read("model.png").startswith(b"\x89PNG")
        needs = archive.read("documentation/externalDependencies.txt").decode()
    for variable in TABLES[name].variables:
        assert f"<td>{shaped_name(variable)}</td>" in page
        assert variable.description in html.unescape(page)
    etree.fromstring(page.partition("\n")[2].replace('<meta charset="utf-8">', "").encode(),
                     etree.HTMLParser(recover=False))  # fmt: skip
    assert "numpy 2.3" in needs


@pytest.mark.fmu
@pytest.mark.parametrize("name", NAMES)
def test_the_hosts_modules_are_never_what_an_fmu_runs(
    fmus: dict[str, Path], name: str, tmp_path: Path
) -> None:
    for module in ("plant", "controller", "assets"):
        (tmp_path / f"{module}.py").write_text("raise RuntimeError('the host's module was run')")
    path = str(fmus[name])
    expected = in_process(fmu_jobs.plain, path)
    assert in_process(fmu_jobs.poisoned, path, str(tmp_path)) == expected


@pytest.mark.fmu
def test_two_builds_run_side_by_side_each_its_own_code(
    fmus: dict[str, Path], tmp_path: Path
) -> None:
    changed = tmp_path / "other.fmu"
    plant = own_code("plant")["plant/plant.py"].replace(
        b'ctrl, self.inputs["ctrl"])', b"ctrl, np.full(8, 0.5))"
    )
    build_fmu(own_fmu("plant", in_python=True, changed={"plant/plant.py": plant}), changed)
    assert Fmu(changed).guid != Fmu(fmus["plant"]).guid
    one, two, one_again, two_again = in_process(
        fmu_jobs.side_by_side, str(fmus["plant"]), str(changed)
    )
    assert one == one_again == in_process(fmu_jobs.plain, str(fmus["plant"]))
    assert two == two_again == in_process(fmu_jobs.plain, str(changed))
    assert one != two


@pytest.mark.fmu
@pytest.mark.parametrize("name", NAMES)
def test_an_fmu_runs_again_from_another_folder(
    fmus: dict[str, Path], name: str, tmp_path: Path
) -> None:
    first, second = in_process(fmu_jobs.moved, str(fmus[name]), str(tmp_path))
    assert first == second
