"""`panda-cosim build`."""

from __future__ import annotations

from pathlib import Path

from ....fmus.atomic import check_replaceable
from ....fmus.errors import InputError
from ....fmus.sources.python_fmu import slave_fmu
from ....fmus.sources.targets import Kind, Target, build_fmu
from ...run.package import build_all
from ..console import show_file
from ..options import (
    DEFAULT_SCENARIO,
    FMI,
    KIND,
    OVERWRITE,
    PLATFORM,
    FmiVersion,
    announce_build,
    find_scenario,
    option,
    target_of,
)


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
    slave: str = option(
        "--slave FILE.py[:CLASS]",
        "Build only this: a slave class of your own, written for PythonFMU.",
        "",
    ),
    overwrite: bool = OVERWRITE,
) -> None:
    """Build the FMUs, and Panda.ssp that connects them, for other tools.

    PandaTrajectory.fmu plays the commands of a scenario. Panda.ssp contains all three FMUs, their
    connections and the scenario's parameters. If the scenario's [mismatch] affects the readings,
    PandaSensors.fmu is added. `run` needs no `build`: it builds its FMUs itself and keeps them in a
    cache. With --slave, a class written for PythonFMU becomes CLASS.fmu; a machine that runs it
    needs the packages that the class imports.

    ```
    panda-cosim build --out fmus-for-my-tool
    panda-cosim build --scenario calibrated --out with-sensors
    panda-cosim build --fmi 3 --platform linux64,win64 --out fmus-for-all
    panda-cosim run fmus-for-my-tool/Panda.ssp
    panda-cosim build --slave my_sensor.py:Sensor --fmi 3
    ```
    """
    target = target_of(kind, fmi, platform)
    if slave:
        if scenario != DEFAULT_SCENARIO or kind != "native":
            name = "--kind" if scenario == DEFAULT_SCENARIO else "--scenario"
            raise InputError(f"{name}: cannot be combined with --slave")
        show_file(_build_slave(slave, out, target, overwrite=overwrite))
        return
    chosen = find_scenario(scenario)
    announce_build(target)
    for path in build_all(chosen, out, target, overwrite=overwrite):
        show_file(path)


def _build_slave(slave: str, out: Path, target: Target, *, overwrite: bool) -> Path:
    """Build the FMU of a class for PythonFMU, FILE.py or FILE.py:CLASS."""
    file, suffix, name = slave.rpartition(".py")  # a folder may be .pyenv
    if not suffix or (name and not name.startswith(":")):
        raise InputError(f"--slave {slave!r}: must be FILE.py or FILE.py:CLASS")
    fmu = slave_fmu(Path(f"{file}.py"), name[1:])
    path = out / f"{fmu.model}.fmu"
    check_replaceable(path, overwrite=overwrite)
    return build_fmu(fmu, path, target)
