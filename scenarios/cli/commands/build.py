"""`panda-cosim build`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from ....fmus.atomic import check_replaceable
from ....fmus.build.ssp import write_panda_ssp
from ....fmus.errors import CosimError, InputError
from ....fmus.interface.sensors import SENSORS
from ....fmus.interface.tables import INTERFACES
from ....fmus.sources.python_fmu import slave_fmu
from ....fmus.sources.targets import OWN, Kind, Target, build, build_fmu, build_trajectory
from ...check.experiments import (
    Experiment,
    add_experiment,
    experiments_of,
    write_compatibility,
)
from ...run.start import instants, resolve, start_values
from ...scenario.scenario import Scenario
from ..console import show_file, warn
from ..options import (
    DEFAULT_SCENARIO,
    FMI,
    KIND,
    NAMES,
    OVERWRITE,
    PLATFORM,
    SCALARS,
    FmiVersion,
    Names,
    announce_build,
    find_scenario,
    option,
    target_of,
)

SYSTEM_FILE: Final = "Panda.ssp"


def command(  # noqa: PLR0913 - one for each option
    out: Path = option("--out -o DIR", "Folder to write the files to.", Path()),
    scenario: str = option(
        "--scenario SCENARIO",
        "Scenario whose commands PandaTrajectory.fmu plays, and whose parameters Panda.ssp sets.",
        DEFAULT_SCENARIO,
    ),
    kind: Kind = KIND,
    fmi: FmiVersion = FMI,
    platform: str = PLATFORM,
    scalars: bool = SCALARS,
    names: Names = NAMES,
    slave: str = option(
        "--slave FILE.py[:CLASS]",
        "Build only this: a slave class of your own, written for PythonFMU.",
        "",
    ),
    compatibility: bool = option(
        "--compatibility",
        "Add a folder for each FMU, with the files that the FMI cross-check asks for.",
        False,
    ),
    overwrite: bool = OVERWRITE,
) -> None:
    """Build the FMUs, and Panda.ssp that connects them, for other tools.

    PandaTrajectory.fmu plays the commands of a scenario. Panda.ssp contains all three FMUs, their
    connections and the scenario's parameters; --names flat leaves it out. If the scenario's
    [mismatch] affects the readings, PandaSensors.fmu is added. Each FMU holds a reference
    experiment (FMI-LS-REF), driven as in the scenario, which `check` runs. `run` needs no `build`:
    it builds its FMUs itself and keeps them in a cache. With --slave, a class written for PythonFMU
    becomes CLASS.fmu; a machine that runs it needs the packages that the class imports.

    ```
    panda-cosim build --out fmus-for-my-tool
    panda-cosim build --scenario calibrated --out with-sensors
    panda-cosim build --fmi 3 --platform linux64,win64 --out fmus-for-all
    panda-cosim run fmus-for-my-tool/Panda.ssp
    panda-cosim build --slave my_sensor.py:Sensor --fmi 3
    ```
    """
    target = target_of(kind, fmi, platform, scalars=scalars, names=names)
    if slave:
        if scenario != DEFAULT_SCENARIO or kind != "native":
            name = "--kind" if scenario == DEFAULT_SCENARIO else "--scenario"
            raise InputError(f"{name}: cannot be combined with --slave")
        paths, experiments = [_build_slave(slave, out, target, overwrite=overwrite)], {}
    else:
        chosen = find_scenario(scenario)
        announce_build(target)
        paths = build_all(chosen, out, target, overwrite=overwrite)
        experiments = experiments_of(chosen)
    instances = {own.interface.model: name for name, own in OWN.items()}
    for path in paths:
        if path.suffix == ".fmu":
            experiment = experiments.get(instances.get(path.stem, ""))
            put_reference(path, experiment, compatibility=compatibility)
        show_file(path)


def put_reference(
    path: Path, experiment: Experiment | None = None, *, compatibility: bool = False
) -> None:
    """Put an experiment into an FMU that was built; warns if it does not run here."""
    try:
        whole = add_experiment(path, experiment)
    except CosimError as error:
        warn(f"{path}: holds no reference experiment, as it cannot be run here: {error}")
        return
    if compatibility:
        write_compatibility(path, whole)


def _build_slave(slave: str, out: Path, target: Target, *, overwrite: bool) -> Path:
    """Build the FMU of a class for PythonFMU, FILE.py or FILE.py:CLASS."""
    file, suffix, name = slave.rpartition(".py")  # a folder may be .pyenv
    if not suffix or (name and not name.startswith(":")):
        raise InputError(f"--slave {slave!r}: must be FILE.py or FILE.py:CLASS")
    fmu = slave_fmu(Path(f"{file}.py"), name[1:])
    path = out / f"{fmu.model}.fmu"
    check_replaceable(path, overwrite=overwrite)
    return build_fmu(fmu, path, target)


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
    if target is not None and target.flat:  # the system's connectors have structured names
        return copies
    # Few importers set parameters that are not Real: write these only where they differ.
    tables = {**INTERFACES, "sensors": SENSORS}
    defaults = {i: {s.name: s.start for s in t.scalars()} for i, t in tables.items()}
    parameters = {
        instance: {
            name: value
            for name, value in start.items()
            if isinstance(value, float) or value != defaults[instance][name]
        }
        for instance, start in values.items()
    }
    ssp = write_panda_ssp(system, fmus, parameters, scenario.duration)
    return [*copies, ssp]
