"""The FMUs and the system that couples them, as files for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from ...fmus.atomic import check_replaceable
from ...fmus.build.ssp import write_panda_ssp
from ...fmus.errors import InputError
from ...fmus.interface.sensors import SENSORS
from ...fmus.interface.tables import INTERFACES
from ...fmus.sources.targets import Target, build, build_trajectory
from ..scenario.scenario import Scenario
from .start import instants, resolve, start_values

SYSTEM_FILE: Final = "Panda.ssp"


def build_all(
    scenario: Scenario, out: Path, target: Target | None = None, *, overwrite: bool = True
) -> list[Path]:
    """Build PandaPlant, PandaController, PandaTrajectory and Panda.ssp.

    A scenario whose readings have errors adds PandaSensors.
    """
    if scenario.has_own_parts:
        raise InputError(
            f"scenario {scenario.name!r}: has FMUs, connections or parameters of its own; must "
            "have only the project's plant and controller"
        )
    values = start_values(scenario)
    commands = resolve(scenario, values).sample(instants(scenario))
    # The system is made of those in the cache: another `build` may write to the same folder.
    fmus = build(values, target=target)
    fmus["trajectory"] = build_trajectory(commands, target=target)
    system = out / SYSTEM_FILE
    check_replaceable(*(out / path.name for path in fmus.values()), system, overwrite=overwrite)
    copies = [*build(values, out, target).values()]
    copies.append(build_trajectory(commands, out / fmus["trajectory"].name, target))
    # Few importers set parameters that are not Real: write these only where they differ.
    tables = {**INTERFACES, "sensors": SENSORS}
    defaults = {i: {s.name: s.start for s in t.scalars()} for i, t in tables.items()}
    parameters = {
        instance: {
            name: value
            for name, value in given.items()
            if isinstance(value, float) or value != defaults[instance][name]
        }
        for instance, given in values.items()
    }
    ssp = write_panda_ssp(system, fmus, parameters, scenario.duration)
    return [*copies, ssp]
