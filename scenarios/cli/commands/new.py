"""`panda-cosim new`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...files import as_argument
from ...scenario.writer import make_scenario
from ..console import show


def command(
    name: Annotated[Path, typer.Argument(metavar="NAME", help="Folder to make.")],
    controller: Annotated[
        bool, typer.Option("--controller", help="Add a control law in Python, for you to edit.")
    ] = False,
) -> None:
    """Make a scenario of your own, ready to run.

    A scenario is a folder with a table of waypoints, trajectory.csv, and a file of settings,
    scenario.toml.

    ```
    panda-cosim new my-scenarios/lift
    panda-cosim run my-scenarios/lift
    panda-cosim new my-law --controller
    ```
    """
    for path in make_scenario(name, controller=controller):
        show(str(path))
    given = as_argument(name)
    show(f"Next: panda-cosim check {given}; panda-cosim run {given}", "dim")
