"""`panda-cosim build`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ....fmus.atomic import check_replaceable
from ....fmus.build.compile import PLATFORMS
from ....fmus.errors import InputError
from ....fmus.messages import did_you_mean
from ....fmus.sources.slave_fmu import slave_fmu
from ....fmus.sources.targets import Target, build_fmu
from ...run.package import build_all
from ..console import show
from ..options import (
    DEFAULT_SCENARIO,
    FmiVersion,
    Kind,
    Overwrite,
    Platforms,
    announce_build,
    find_scenario,
)


def command(  # noqa: PLR0913 - one for each option
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder to write the files to.")
    ] = Path(),
    scenario: Annotated[
        str,
        typer.Option(
            "--scenario",
            metavar="SCENARIO",
            help="Scenario whose commands PandaTrajectory.fmu plays, and whose parameters "
            "Panda.ssp sets.",
        ),
    ] = DEFAULT_SCENARIO,
    kind: Kind = "native",
    fmi: FmiVersion = "2",
    platform: Platforms = "",
    slave: Annotated[
        str,
        typer.Option(
            "--slave",
            metavar="FILE.py[:CLASS]",
            help="Build only this: a slave class of your own, written for PythonFMU.",
        ),
    ] = "",
    overwrite: Overwrite = False,
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
    if slave:
        if scenario != DEFAULT_SCENARIO or kind != "native":
            option = "--kind" if scenario == DEFAULT_SCENARIO else "--scenario"
            raise InputError(f"{option}: cannot be combined with --slave")
        file, found, name = slave.rpartition(".py")  # a folder may be .pyenv
        if not found or (name and not name.startswith(":")):
            raise InputError(f"--slave {slave!r}: must be FILE.py or FILE.py:CLASS")
        fmu = slave_fmu(Path(f"{file}.py"), name[1:])
        path = out / f"{fmu.model}.fmu"
        check_replaceable(path, overwrite=overwrite)
        build_fmu(fmu, path, Target(fmi=int(fmi), platforms=platforms(platform)))
        show(f"{path}  {path.stat().st_size / 1e6:.2f} MB")
        return
    chosen = find_scenario(scenario)
    target = Target(kind, int(fmi), platforms(platform))
    announce_build(target)
    for path in build_all(chosen, out, target, overwrite=overwrite):
        show(f"{path}  {path.stat().st_size / 1e6:.2f} MB")


def platforms(text: str) -> tuple[str, ...]:
    """Read a list of platforms."""
    names = tuple(name.strip() for name in text.split(",")) if text.strip() else ()
    for name in names:
        if name not in PLATFORMS:
            valid = ", ".join(PLATFORMS)
            raise InputError(f"--platform {name!r}: valid: {valid}{did_you_mean(name, PLATFORMS)}")
    return names
