"""The coupled system in other people's importers: they agree with our master."""

import ctypes
import zipfile
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from master_support import all_rows
from panda_cosim.fmus.build.container import write_container
from panda_cosim.fmus.build.ssp import write_ssp
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.master.ssp_reader import system_from_ssp
from panda_cosim.fmus.master.step import Coupling
from panda_cosim.fmus.master.system import open_system
from panda_cosim.fmus.sources.targets import Target
from panda_cosim.run.written import written_system
from panda_cosim.task.scenario import load_scenario

TICKS, TICK = 300, 0.001
TOLERANCE = 1e-12  # [1] largest relative difference
pytestmark = pytest.mark.own_process


@pytest.fixture(scope="module")
def ssp(tmp_path_factory):
    """The system, with a task that has moved on to where it gets interesting."""
    system = written_system(load_scenario("pick_and_place"), Target())
    return write_ssp(tmp_path_factory.mktemp("importers") / "Panda.ssp", system)


def outputs(ssp: Path) -> dict[str, int]:
    """Value references of the plant's outputs."""
    variables = Fmu(system_from_ssp(ssp).system.fmus["plant"]).variables
    return {n: v.value_reference for n, v in variables.items() if v.variable.causality == "output"}


def ours(ssp: Path, coupling: Coupling = "jacobi") -> Any:
    """The plant's outputs after each step, by our master."""
    coupled = system_from_ssp(ssp)
    with open_system(
        coupled.system,
        coupled.start_values,
        stop=coupled.stop_time,
        step_size=coupled.step_size,
        coupling=coupling,
    ) as session:
        columns = [session.master.columns.index(("plant", n)) + 1 for n in outputs(ssp)]
        return all_rows(session.master, TICKS)[1:, columns]


def check(ssp: Path, rows: Any) -> None:
    np.testing.assert_allclose(np.array(rows), ours(ssp), rtol=TOLERANCE, atol=TOLERANCE)


@pytest.mark.skipif(find_spec("libcosimpy") is None, reason="no libcosimpy")
def test_libcosim_agrees(ssp, tmp_path):
    from libcosimpy.CosimExecution import CosimExecution  # noqa: PLC0415 - loads its library
    from libcosimpy.CosimObserver import CosimObserver  # noqa: PLC0415

    with zipfile.ZipFile(ssp) as archive:
        archive.extractall(tmp_path)
    execution = CosimExecution.from_ssp_file(ssp_path=str(tmp_path))
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    plant = execution.slave_index_from_instance_name("plant")
    references, rows = list(outputs(ssp).values()), []
    for _ in range(TICKS):
        assert execution.step()
        rows.append(list(observer.last_real_values(plant, references)))
    check(ssp, rows)


@pytest.mark.skipif(find_spec("ecospy") is None, reason="no ecospy")
def test_ecos_agrees(ssp):
    try:  # oneTBB's library, which Ecos needs
        (library,) = [f for f in files("tbb") or [] if f.name == "libtbb.so.12"]
        ctypes.CDLL(str(Path(str(library.locate())).resolve()), ctypes.RTLD_GLOBAL)
    except PackageNotFoundError:
        pass  # the system's
    from ecospy import EcosSimulation  # noqa: PLC0415 - loads its library

    names, rows = list(outputs(ssp)), []
    with EcosSimulation(ssp_path=str(ssp), step_size=TICK) as simulation:
        simulation.init()
        for _ in range(TICKS):
            simulation.step()
            rows.append([simulation.get_real(f"plant::{name}") for name in names])
    check(ssp, rows)


def test_fmpy_runs_it_though_it_sends_zeros_first(ssp):
    from fmpy.ssp.simulation import simulate_ssp  # noqa: PLC0415 - only here

    result = simulate_ssp(str(ssp), stop_time=(TICKS - 0.5) * TICK, step_size=TICK)
    assert len(result) == TICKS
    for i, name in enumerate(outputs(ssp)):
        if name.startswith("hand_xpos"):
            assert abs(result[f"plant.{name}"][-1] - ours(ssp)[-1, i]) < 1e-4  # [m]


@pytest.mark.skipif(find_spec("pyssp_standard") is None, reason="no pyssp_standard")
def test_pyssp_finds_nothing_to_complain_of(ssp):
    from pyssp_standard.ssp import SSP  # noqa: PLC0415 - only here

    with SSP(str(ssp), mode="r") as opened, opened.system_structure as structure:
        structure.__check_compliance__()
        assert not structure.check_connections()


needs_toolbox = pytest.mark.skipif(
    find_spec("fmu_manipulation_toolbox") is None, reason="no toolbox"
)


@needs_toolbox
@pytest.mark.parametrize(("coupling", "fmi"), [("gauss-seidel", 3), ("jacobi", 2)])
def test_a_container_is_the_coupled_system_in_plain_fmpy(ssp, tmp_path, coupling, fmi):
    scenario = replace(load_scenario("pick_and_place"), coupling=coupling)
    fmu = write_container(tmp_path / "Panda.fmu", written_system(scenario, Target()), fmi)
    description = fmpy.read_model_description(fmu)
    assert (description.fmiVersion, description.defaultExperiment.stopTime) == (f"{fmi}.0", "6.5")
    assert description.author == "The panda-cosim engineers"
    result = fmpy.simulate_fmu(fmu, stop_time=TICKS * TICK, output_interval=TICK)
    expected = ours(ssp, coupling)
    shown = [n for n in outputs(ssp) if n.startswith(("hand_x", "target_x"))]
    assert len(shown) == 19
    for i, name in enumerate(outputs(ssp)):
        if name in shown:
            assert (result[name][1:] == expected[:, i]).all(), name


@needs_toolbox
@pytest.mark.long
def test_the_toolbox_makes_a_container_of_the_ssp(ssp):
    from fmu_manipulation_toolbox.assembly import Assembly  # noqa: PLC0415 - only here

    assembly = Assembly(ssp.name, fmu_directory=ssp.parent, default_step_size=TICK)
    assembly.make_fmu()
    fmu = ssp.with_suffix(".fmu")
    result = fmpy.simulate_fmu(fmu, stop_time=TICKS * TICK, output_interval=TICK)
    assert len(result.dtype.names) == 1 + 27  # time; hand, block and servo targets
    names = list(outputs(ssp))
    for name in ("hand_xpos[1]", "target_xpos[3]"):
        assert (result[name][1:] == ours(ssp)[:, names.index(name)]).all()
