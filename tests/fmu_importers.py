"""The coupled system in other people's importers, in a process of their own."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from panda_cosim.fmus.master.ssp_reader import system_from_ssp
from panda_cosim.fmus.master.system import open_system

TICK = 0.001


def plant_outputs(ssp: str) -> dict[str, int]:
    """Value references of the plant's outputs."""
    from panda_cosim.fmus.files.fmu_file import Fmu  # noqa: PLC0415

    fmu = Fmu(system_from_ssp(Path(ssp)).system.fmus["plant"])
    return {
        n: v.value_reference for n, v in fmu.variables.items() if v.variable.causality == "output"
    }


def ours(ssp: str, ticks: int, coupling: str) -> list[list[float]]:
    """Plant outputs after each step, by our master."""
    coupled = system_from_ssp(Path(ssp))
    blocks: list[Any] = []
    with open_system(
        coupled.system,
        coupled.start_values,
        stop=coupled.stop_time,
        step_size=coupled.step_size,
        coupling=coupling,  # type: ignore[arg-type]
    ) as session:
        columns = [session.master.columns.index(("plant", n)) + 1 for n in plant_outputs(ssp)]
        empty = np.zeros((ticks + 1, 0))
        session.master.run(ticks, empty, lambda rows: blocks.append(rows.copy()))
    rows: list[list[float]] = np.concatenate(blocks)[1:, columns].tolist()
    return rows


def libcosim(ssp: str, ticks: int, folder: str) -> list[list[float]]:
    """Plant outputs after each step, by libcosim."""
    from libcosimpy.CosimExecution import CosimExecution  # noqa: PLC0415
    from libcosimpy.CosimObserver import CosimObserver  # noqa: PLC0415

    with zipfile.ZipFile(ssp) as archive:
        archive.extractall(folder)
    execution = CosimExecution.from_ssp_file(ssp_path=folder)
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    plant = execution.slave_index_from_instance_name("plant")
    references = list(plant_outputs(ssp).values())
    rows = []
    for _ in range(ticks):
        assert execution.step()
        rows.append(list(observer.last_real_values(plant, references)))
    return rows


def ecos(ssp: str, ticks: int) -> list[list[float]]:
    """Plant outputs after each step, by Ecos."""
    from ecospy import EcosSimulation  # noqa: PLC0415

    names = list(plant_outputs(ssp))
    rows = []
    with EcosSimulation(ssp_path=ssp, step_size=TICK) as simulation:
        simulation.init()
        for _ in range(ticks):
            simulation.step()
            rows.append([simulation.get_real(f"plant::{name}") for name in names])
    return rows


def fmpy(ssp: str, ticks: int) -> list[list[float]]:
    """Plant outputs after each step, by FMPy's simulate_ssp."""
    from fmpy.ssp.simulation import simulate_ssp  # noqa: PLC0415

    result = simulate_ssp(ssp, stop_time=(ticks - 0.5) * TICK, step_size=TICK)
    assert len(result) == ticks
    names = [f"plant.{name}" for name in plant_outputs(ssp)]
    return [[float(row[name]) for name in names] for row in result]


def pyssp(ssp: str) -> None:
    """Check the file with pyssp_standard; raises where it does not follow the standard."""
    from pyssp_standard.ssp import SSP  # noqa: PLC0415

    with SSP(ssp, mode="r") as opened, opened.system_structure as structure:
        structure.__check_compliance__()
        assert not structure.check_connections()


def parts(paths: dict[str, str], values: dict[str, Any], ticks: int) -> list[list[float]]:
    """Plant outputs after each step, by our master that is given the table's rows itself."""
    from couple_support import panda_system  # noqa: PLC0415
    from panda_cosim.fmus.interface.plant import PLANT  # noqa: PLC0415
    from panda_cosim.fmus.interface.trajectory import TABLE_FILE  # noqa: PLC0415

    with zipfile.ZipFile(paths["trajectory"]) as archive:
        table = next(n for n in archive.namelist() if n.endswith(TABLE_FILE))
        commands = np.frombuffer(archive.read(table)).reshape(-1, 14)
    blocks: list[Any] = []
    asked = [f"plant.{v.name}" for v in PLANT.of("output") if v.on_request]
    files = {name: Path(paths[name]) for name in ("controller", "plant")}
    with open_system(panda_system(asked, files), values, stop=1.0) as session:
        columns = [
            i + 1
            for i, (instance, name) in enumerate(session.master.columns)
            if instance == "plant" and name not in ("ctrl",)
        ]
        names = [session.master.columns[i - 1][1] for i in columns]
        session.master.run(ticks, commands, lambda rows: blocks.append(rows.copy()))
    rows = dict(zip(names, np.concatenate(blocks)[1:, columns].T, strict=True))
    from panda_cosim.fmus.files.fmu_file import Fmu  # noqa: PLC0415

    variables = Fmu(Path(paths["plant"])).variables
    order = [n for n, v in variables.items() if v.variable.causality == "output"]
    found: list[list[float]] = np.array([rows[n] for n in order]).T.tolist()
    return found
