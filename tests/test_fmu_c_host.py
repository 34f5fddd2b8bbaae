"""The FMUs in a host that is not Python, with an empty environment."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import fmu_jobs
import numpy as np
import pytest
from fmu_support import (
    ERROR,
    OK,
    Answer,
    Host,
    compile_host,
    compiler,
    in_process,
    resources_uri,
)
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.sources.python_fmu import python_library
from panda_cosim.fmus.sources.targets import Target, build
from panda_cosim.scenarios.run.start import resolve, start_values
from panda_cosim.scenarios.scenario.scenario import load_scenario

TICKS = 1000
CHECKED = 50  # [tick] between two comparisons of everything
pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
    pytest.mark.skipif(python_library() is None, reason="this Python has no shared library"),
]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compile_host(tmp_path_factory.mktemp("host"))


@pytest.fixture(scope="module")
def fmus() -> dict[str, Fmu]:
    return {
        name: Fmu(path)
        for name, path in build(("plant", "controller"), target=Target("python")).items()
    }


@pytest.fixture
def host(program: Path) -> Iterator[Host]:
    with Host(program) as running:
        yield running


def start(host: Host, slot: int, fmu: Fmu, *values: tuple[object, ...]) -> Answer:
    """Load, instantiate and initialize; returns the answer of the last call."""
    host.load(slot, fmu.folder, fmu.description.modelName)
    assert host("new", slot, slot, fmu.guid, resources_uri(fmu.folder)).status == OK
    for command in [("setup", slot, 0.0, 10.0), *values, ("enter", slot)]:
        assert host(*command).status == OK
    return host("exit", slot)


def test_a_c_host_gets_the_same_bits_as_fmpy(host: Host, fmus: dict[str, Fmu]) -> None:
    scenario = load_scenario("pick_and_place")
    trajectory = resolve(scenario, start_values(scenario))
    # At three times its speed, so that the grasp takes part.
    commands = trajectory.sample(np.arange(TICKS) * 0.003).tolist()
    paths = [str(fmus[name].path) for name in ("plant", "controller")]
    expected = in_process(fmu_jobs.coupled, *paths, commands)

    for slot, name in enumerate(("plant", "controller")):
        assert start(host, slot, fmus[name]).messages == []
    measured, ctrl = fmu_jobs.wires()
    references = {
        name: [[fmu.variables[n].value_reference for n in names] for names in (measured, ctrl)]
        for name, fmu in fmus.items()
    }
    (out, to_plant), (into, from_controller) = references["plant"], references["controller"]
    outputs = [v.value_reference for v in fmus["plant"].variables.values()
               if v.variable.causality == "output"]  # fmt: skip
    for tick, command in enumerate(commands):
        for words in (
            ("setr", 1, 14, range_words(14), command),
            ("copy", 0, 1, len(out), out, into),
            ("step", 1, tick * 0.001, 0.001),
            ("copy", 1, 0, 8, from_controller, to_plant),
            ("step", 0, tick * 0.001, 0.001),
        ):
            answer = host(*words)
            assert (answer.status, answer.messages) == (OK, [])
        if tick % CHECKED == 0 or tick == TICKS - 1:
            got = host("getr", 0, len(outputs), outputs)
            assert " ".join(x.hex() for x in got) == expected[tick]
    for slot in (0, 1):
        host("term", slot)
        host("free", slot)
    assert host.close() == 0


def range_words(count: int) -> list[int]:
    """Value references from 0 on."""
    return list(range(count))


def test_many_instances_come_and_go_in_a_c_host(host: Host, fmus: dict[str, Fmu]) -> None:
    fmu = fmus["controller"]
    start(host, 0, fmu)
    for i in range(60):
        slot = 1 + i % 7
        if i >= 7:
            host("free", slot)
        assert host("new", slot, 0, fmu.guid, resources_uri(fmu.folder)).status == OK
        for command in (("setup", slot, 0.0, 1.0), ("enter", slot), ("exit", slot)):
            host(*command)
        assert host("step", slot, 0.0, 0.001).status == OK
    assert host.close() == 0


def test_missing_packages_are_named_through_the_log(program: Path, fmus: dict[str, Fmu]) -> None:
    with Host(program, {"PANDA_COSIM_PYTHONPATH": "/nowhere"}) as host:
        fmu = fmus["plant"]
        host.load(0, fmu.folder, fmu.description.modelName)
        answer = host("new", 0, 0, fmu.guid, resources_uri(fmu.folder))
        assert answer.status == ERROR
        (told,) = answer.messages
        assert told.startswith("3 logStatusError")
        assert "cannot be imported: No module named" in told
        assert "set PANDA_COSIM_PYTHONPATH to the folder that holds them" in told
        assert host.close() == 0


def test_packages_of_an_unsuitable_version_are_named(
    program: Path, fmus: dict[str, Fmu], tmp_path: Path
) -> None:
    for name in ("numpy", "mujoco"):
        (tmp_path / f"{name}.py").write_text("__version__ = '1.26.4'\n")
    with Host(program, {"PANDA_COSIM_PYTHONPATH": str(tmp_path)}) as host:
        fmu = fmus["plant"]
        host.load(0, fmu.folder, fmu.description.modelName)
        answer = host("new", 0, 0, fmu.guid, resources_uri(fmu.folder))
        assert answer.status == ERROR
        assert "numpy 1.26.4" in answer.messages[0]
        assert "is too old, 2.3 is needed" in answer.messages[0]


@pytest.mark.parametrize("damage", ["resources", "variables.txt", "python_host.py", "code"])
def test_a_damaged_fmu_is_an_error_and_the_host_lives(
    host: Host, fmus: dict[str, Fmu], tmp_path: Path, damage: str
) -> None:
    fmu, folder = fmus["controller"], tmp_path / "damaged"
    shutil.copytree(fmu.folder, folder)
    if damage == "resources":
        shutil.rmtree(folder / damage)
    elif damage == "code":
        (package,) = (p for p in (folder / "resources").iterdir() if p.is_dir())
        shutil.rmtree(package)
    else:
        (folder / "resources" / damage).unlink()
    host.load(0, folder, "PandaController")
    answer = host("new", 0, 0, fmu.guid, resources_uri(folder))
    assert answer.status == ERROR
    assert answer.messages
    assert host.load(1, fmu.folder, "PandaController").status == OK
    assert host("new", 1, 1, fmu.guid, resources_uri(fmu.folder)).status == OK


def test_a_folder_with_a_space_is_found(host: Host, fmus: dict[str, Fmu], tmp_path: Path) -> None:
    fmu, folder = fmus["plant"], tmp_path / "a b"
    shutil.copytree(fmu.folder, folder)
    host.load(0, folder, "PandaPlant")
    assert host("new", 0, 0, fmu.guid, resources_uri(folder)).status == OK
    for command in (("setup", 0, 0.0, 1.0), ("enter", 0), ("exit", 0)):
        assert host(*command).messages == []
    assert host("step", 0, 0.0, 0.001).status == OK


def test_parameters_of_all_types_arrive(host: Host, fmus: dict[str, Fmu]) -> None:
    fmu = fmus["plant"]
    mass, scene = (fmu.variables[name].value_reference for name in ("block_mass", "scene"))
    start(host, 0, fmu, ("seti", 0, 1, scene, 2), ("setr", 0, 1, mass, 0.25))
    assert host("geti", 0, 1, scene) == [2.0]
    assert host("getr", 0, 1, mass) == [0.25]
    assert host("step", 0, 0.0, 0.001).status == OK
