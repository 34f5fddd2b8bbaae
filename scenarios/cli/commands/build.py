"""`panda-cosim build`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ....fmus.packaging.build import outdated
from ....fmus.packaging.bundle import BUNDLES
from ...running.package import build_all
from ..console import show, tell
from ..options import find_scenario


def command(
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder to write the files to.")
    ] = Path(),
    scenario: Annotated[
        str,
        typer.Option(
            "--scenario",
            metavar="SCENARIO",
            help="Scenario whose commands PandaTrajectory.fmu plays.",
        ),
    ] = "pick_and_place",
) -> None:
    """Build the FMUs, and Panda.ssp that connects them, for other tools.

    PandaTrajectory.fmu plays the commands of a scenario. Panda.ssp holds all three FMUs, their
    connections and the scenario's parameters. `run` builds the FMUs by itself and keeps them in a
    cache.

    ```
    panda-cosim build --out fmus-for-my-tool
    panda-cosim run --system fmus-for-my-tool/Panda.ssp
    ```
    """
    chosen = find_scenario(scenario)
    announce_build()
    for path in build_all(chosen, out):
        show(f"{path}  {path.stat().st_size / 1e6:.2f} MB")


def announce_build() -> None:
    """Say which FMUs are about to be built, if any."""
    names = [BUNDLES[name].model for name in outdated()]
    if names:
        tell(f"Building {' and '.join(names)}: the cache has none for this version of the code ...")
