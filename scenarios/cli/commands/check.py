"""`panda-cosim check`."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import typer

from ....fmus.errors import InputError
from ...check.check import check_folder
from ...run.options import TOP, split_settings
from ...scenario.scenario import Scenario
from ...system.assembly import instances
from ..console import show, show_json
from ..options import JSON, SETTINGS, argument, overrides

STYLES = {"wrong": "bold red", "hint": "yellow", "good": "green"}


def command(
    folder: Path = argument("FOLDER", "Folder of a scenario."),
    assignments: list[str] | None = SETTINGS,
    json: bool = JSON,
) -> None:
    """Explain what is wrong with a scenario, before it is run.

    The table is compared with the robot's limits of velocity, acceleration, jerk, torque and torque
    rate. Then it is run in memory, which shows contacts that nobody wants, servos without torque
    left, a high torque rate, a weak grip, a block that is let go too late, and missed criteria. A
    scenario with FMUs of its own is only read: none of their code runs.

    Exit code 0: the scenario can be run (there may be hints). Exit code 2: it cannot, or a
    criterion could not be measured.

    ```
    panda-cosim check my-scenarios/lift
    panda-cosim check my-scenarios/lift --set plant.block_mass=2 --set mismatch.preset=worn
    ```
    """
    settings, parameters = split_settings(assignments or ())
    names: tuple[str, ...] = ()
    with suppress(InputError):  # a scenario that cannot be read: the check explains why
        names = tuple(instances(Scenario.read(folder)))
    diagnostics = check_folder(folder, overrides(parameters, names, TOP), settings)
    wrong = any(diagnostic.level == "wrong" for diagnostic in diagnostics)
    if json:
        show_json({"folder": folder, "ok": not wrong, "findings": diagnostics})
    else:
        for diagnostic in diagnostics:
            show(f"{diagnostic.level:<6} {diagnostic.text}", STYLES[diagnostic.level])
    if wrong:
        raise typer.Exit(InputError.exit_code)
