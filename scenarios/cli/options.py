"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

import typer

from ...fmus.interface.parameters import Given, parse_assignment
from ...fmus.interface.tables import INTERFACES
from ..definition.scenario import SCENARIO_FILE, Scenario, load_scenario, shipped_scenarios
from .console import warn

ScenarioName = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="Name of a shipped scenario, or a folder.",
        autocompletion=lambda: list(shipped_scenarios()),
    ),
]
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "-s",
        metavar="NAME=VALUE",
        help="Start value of an FMU's parameter, such as plant.block_yaw=0.3 or controller.kp=8 "
        "(all seven joints); may be repeated. `panda-cosim info` lists the parameters. `run` also "
        "takes keys of the scenario: duration, table.rows[3].x, push[1].force[2].",
    ),
]
RunFolder = Annotated[
    Path,
    typer.Argument(metavar="RUN", help="Folder of a run, or its recording.", show_default=False),
]
OutFolder = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="DIR",
        help="Folder for the pictures. Default: the folder of the run.",
    ),
]
CsvFile = Annotated[Path, typer.Argument(metavar="FILE.csv", help="The file to write.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON instead of tables.")]
Kind = Annotated[
    Literal["native", "python"],
    typer.Option("--kind", help="Compiled FMUs, or FMUs that run this project's Python code."),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the file if it exists.")]


def find_scenario(name: str) -> Scenario:
    """Load a scenario by name or folder; warns where a folder has the name of a shipped one.

    Raises:
        InputError: There is no such scenario, or its files cannot be used.
    """
    scenario = load_scenario(name)
    used, namesake = scenario.folder, Path(name)
    if used and (namesake / SCENARIO_FILE).is_file() and not namesake.samefile(used):
        warn(f"{name} is the shipped scenario; for the folder {name} here, write ./{name}")
    return scenario


def overrides(
    assignments: list[str] | None, others: Iterable[str] = ()
) -> dict[str, dict[str, Given]]:
    """Read what `--set` was given, as values by instance and name; the last one counts.

    Args:
        assignments: What was given.
        others: Instances that there are beside plant and controller.

    Raises:
        InputError: One is not of the form INSTANCE.NAME=VALUE.
    """
    given: dict[str, dict[str, Given]] = {}
    instances = tuple(dict.fromkeys((*INTERFACES, *others)))
    for text in assignments or ():
        instance, name, value = parse_assignment(text, instances)
        values = given.setdefault(instance, {})
        values.pop(name, None)  # so that it comes after what was given since, as kp after kp[3]
        values[name] = value
    return given
