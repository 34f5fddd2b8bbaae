"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ...fmus.interface.parameters import Given

ScenarioName = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="Name of a shipped scenario, or a folder.")
]
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "-s",
        metavar="NAME=VALUE",
        help="Start value of an FMU's parameter, as plant.block_yaw=0.3 or controller.kp=8 "
        "(all seven); may be repeated.",
    ),
]
RunFolder = Annotated[
    Path,
    typer.Argument(metavar="RUN", help="Folder of a run, or its recording.", show_default=False),
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the file if it is there already.")
]


def overrides(assignments: list[str] | None) -> dict[str, dict[str, Given]]:
    """Turn what `--set` was given into parameters by instance and name; the last one holds.

    Raises:
        InputError: One is not of the form INSTANCE.NAME=VALUE.
    """
    from ...fmus.interface.parameters import parse_assignment  # noqa: PLC0415 - after --help
    from ...fmus.interface.tables import INTERFACES  # noqa: PLC0415

    given: dict[str, dict[str, Given]] = {}
    for text in assignments or ():
        instance, name, value = parse_assignment(text, tuple(INTERFACES))
        values = given.setdefault(instance, {})
        values.pop(name, None)  # so that it comes after what was given since, as kp after kp[3]
        values[name] = value
    return given
