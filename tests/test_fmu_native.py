"""What is in an FMU of either kind, in both versions of FMI."""

from __future__ import annotations

import zipfile
from pathlib import Path

import fmpy
import fmu_jobs
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from fmu_support import in_process
from forked import command
from lxml import etree
from panda_cosim.fmus.build.libraries import PLATFORMS, this_platform
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.fmus.interface.trajectory import TRAJECTORY
from panda_cosim.fmus.sources.targets import Target, build, build_trajectory
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.run.options import Options
from panda_cosim.scenarios.run.run import run_scenario

TABLES = {**INTERFACES, "trajectory": TRAJECTORY}
SCHEMAS = Path(fmpy.__file__).parent / "schema" / "fmi3"
PLANT_BYTES, ALL_BYTES = 3_500_000, 7_000_000


@pytest.fixture(
    scope="module",
    params=[Target(), Target(fmi=3), Target("python"), Target("python", 3)],
    ids=lambda target: f"{target.kind}-{target.fmi}",
)
def target(request: pytest.FixtureRequest) -> Target:
    built: Target = request.param
    return built


@pytest.fixture(scope="module")
def fmus(target: Target) -> dict[str, Path]:
    return build(target=target) | {"trajectory": build_trajectory(np.ones((5, 14)), target=target)}


@pytest.mark.parametrize("name", TABLES)
def test_the_validator_finds_no_problem(fmus: dict[str, Path], name: str) -> None:
    assert validate_fmu(str(fmus[name])) == []


@pytest.mark.parametrize("name", TABLES)
def test_the_description_says_what_the_table_says(fmus: dict[str, Path], name: str) -> None:
    found = Fmu(fmus[name]).variables
    scalars = {s.name: s for s in TABLES[name].scalars()}
    assert [n for n in found if n != "time"] == list(scalars)
    for n, s in scalars.items():
        assert (found[n].variable.kind, found[n].variable.causality) == (
            s.variable.kind,
            s.variable.causality,
        )
        assert found[n].value_reference + found[n].element in (
            s.value_reference, s.value_reference + found[n].element
        )  # fmt: skip
        assert found[n].unit in (s.unit, "")
        if s.start is not None:
            assert found[n].start_value() == found[n].converted(s.start)


def test_no_type_has_the_name_of_a_variable(fmus: dict[str, Path]) -> None:
    """Neither FMI version allows it; FMPy's validator does not look."""
    description = Fmu(fmus["plant"]).description
    types = [each.name for each in description.typeDefinitions]
    assert len(types) == 1
    assert not {*types} & {variable.name for variable in description.modelVariables}


def test_fmus_are_small(fmus: dict[str, Path]) -> None:
    assert fmus["plant"].stat().st_size <= PLANT_BYTES
    assert sum(path.stat().st_size for path in fmus.values()) <= ALL_BYTES


@pytest.mark.parametrize("name", TABLES)
def test_an_fmu_holds_its_libraries_and_papers_and_no_path_of_this_machine(
    fmus: dict[str, Path], target: Target, name: str
) -> None:
    platform, is_native = PLATFORMS[this_platform()], target.kind == "native"
    folder = f"binaries/{platform.fmi2 if target.fmi == 2 else platform.fmi3}"
    with zipfile.ZipFile(fmus[name]) as archive:
        members = {n: archive.read(n) for n in archive.namelist()}
    assert f"{folder}/{TABLES[name].model}{platform.suffix}" in members
    assert (f"{folder}/{platform.mujoco}" in members) == (is_native and name != "trajectory")
    assert b"Apache License" in members["documentation/licenses/license.txt"]
    assert ("terminalsAndIcons/terminalsAndIcons.xml" in members) == (target.fmi == 3)
    places = (str(Path(__file__).parents[1]).encode(), b"site-packages")
    recorded = {n for n, content in members.items() if any(place in content for place in places)}
    assert recorded == (set() if is_native else {"resources/variables.txt"})
    assert any(n.endswith(".py") for n in members) == (not is_native)


def test_terminals_follow_the_schema(tmp_path: Path) -> None:
    schema = etree.XMLSchema(etree.parse(SCHEMAS / "fmi3TerminalsAndIcons.xsd"))
    for path in build(target=Target(fmi=3)).values():
        with zipfile.ZipFile(path) as archive:
            schema.assertValid(
                etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
            )


def test_the_same_content_gives_the_same_bytes(
    fmus: dict[str, Path], target: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path))
    again = build(target=target)
    assert {n: again[n].read_bytes() == fmus[n].read_bytes() for n in again} == {
        "plant": True, "controller": True
    }  # fmt: skip


def record(out: str, kind: str) -> None:
    """Run a scenario."""
    run_scenario("push", out, Options(kind=kind))  # type: ignore[arg-type]


@pytest.mark.fmu
def test_the_python_kind_gives_the_same_in_fmi_3() -> None:
    two, three = (build(target=Target("python", fmi))["plant"] for fmi in (2, 3))
    assert in_process(fmu_jobs.ours, str(two)) == in_process(fmu_jobs.ours, str(three))


@pytest.mark.fmu
def test_both_kinds_give_the_same_recording(tmp_path: Path) -> None:
    native, python = (tmp_path / kind for kind in ("native", "python"))
    for folder in (native, python):
        in_process(record, str(folder), folder.name)
    one, other = Recording.open(native), Recording.open(python)
    assert one.rows == other.rows
    for column in one.columns:
        if column.startswith("controller."):
            np.testing.assert_allclose(one[column], other[column], rtol=1e-12, atol=1e-12)
        else:
            np.testing.assert_array_equal(one[column], other[column])


@pytest.mark.parametrize("platform", [name for name in PLATFORMS if name != this_platform()])
def test_libraries_of_other_platforms_are_of_their_kind(platform: str) -> None:
    pytest.importorskip("ziglang")
    from panda_cosim.fmus.build.libraries import library  # noqa: PLC0415

    magic = {"win64": b"MZ", "linux-arm64": b"\x7fELF", "darwin64": b"\xcf\xfa\xed\xfe"}
    content = library("player", platform).read_bytes()
    assert content.startswith(magic.get(platform, b"\xcf\xfa\xed\xfe"))


def test_the_program_refuses_an_unknown_platform() -> None:
    done = command("build", "--platform", "win46")
    assert done.returncode == 2
    assert "did you mean 'win64'?" in done.stderr.replace("\n", " ")
