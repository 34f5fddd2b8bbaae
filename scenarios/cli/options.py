"""Arguments and options shared by several commands."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from ...fmus.build.compile import PLATFORMS
from ...fmus.interface.parameters import ParameterValue, parse_assignment
from ...fmus.interface.tables import INTERFACES
from ...fmus.sources.targets import Target, outdated
from ..run.options import Options
from ..run.settings import TOP, split_settings, with_values
from ..scenario.scenario import SCENARIO_FILE, Scenario, load_scenario, shipped_scenarios
from ..system.assembly import instances
from .console import tell, warn

ScenarioName = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="Name of a shipped scenario, or a scenario's folder.",
        autocompletion=lambda: list(shipped_scenarios()),
    ),
]
PARAMETERS = (
    "Start value of an FMU's parameter, such as plant.block_yaw=0.3 or controller.kp=8 (all seven "
    "joints). `panda-cosim info` lists the parameters. May be repeated."
)
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "-s",
        metavar="NAME=VALUE",
        help=f"{PARAMETERS} Also keys of the scenario: duration=3, table.rows[3].x=0.4, "
        "mismatch.delay=0.003.",
    ),
]
ParameterAssignments = Annotated[
    list[str] | None, typer.Option("--set", "-s", metavar="NAME=VALUE", help=PARAMETERS)
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
OutRun = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="DIR",
        help="New folder for the run. Default: one in runs/.",
    ),
]
Video = Annotated[
    bool, typer.Option("--video/--no-video", help="Draw the video and the contact sheet.")
]
Plot = Annotated[
    bool | None,
    typer.Option("--plot/--no-plot", help="Draw the plot. Default: as for the video."),
]
View = Annotated[
    bool, typer.Option("--view/--no-view", help="Write the page that shows the run in 3D.")
]
Isolate = Annotated[
    bool,
    typer.Option(
        "--isolate",
        help="Run each FMU in a process of its own, so that a crash ends only that process.",
    ),
]
StepTimeout = Annotated[
    float | None,
    typer.Option(
        "--step-timeout",
        metavar="SECONDS",
        help="With --isolate: stop the run if an FMU takes longer for one step.",
    ),
]
Junit = Annotated[
    Path | None,
    typer.Option("--junit", metavar="FILE.xml", help="Write the verdict as JUnit XML, for CI."),
]
CsvFile = Annotated[Path, typer.Argument(metavar="FILE.csv", help="The file to write.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON instead of tables.")]
Kind = Annotated[
    Literal["native", "python"],
    typer.Option("--kind", help="Compiled FMUs, or FMUs that run this project's Python code."),
]
FmiVersion = Annotated[Literal["2", "3"], typer.Option("--fmi", help="FMI version: 2.0 or 3.0.")]
Platforms = Annotated[
    str,
    typer.Option(
        "--platform",
        metavar="LIST",
        help=f"Platforms to build for, separated by commas: {', '.join(PLATFORMS)}. Default: this "
        "machine's. Others need the extra `cross`.",
    ),
]
Meshes = Annotated[
    Literal["never", "auto", "always"],
    typer.Option(
        "--meshes",
        help="Draw the arm with the meshes of MuJoCo Menagerie; auto: only if they are found.",
    ),
]
OpenPage = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]
Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace existing files, whoever made them."),
]
DEFAULT_SCENARIO = "pick_and_place"


def find_scenario(name: str) -> Scenario:
    """Load a scenario by name or folder; warns if a folder has the name of a shipped one."""
    scenario = load_scenario(name)
    used, namesake = scenario.folder, Path(name)
    if used and (namesake / SCENARIO_FILE).is_file() and not namesake.samefile(used):
        warn(f"{name} is the shipped scenario; for the folder {name} here, write ./{name}")
    return scenario


def overrides(
    assignments: list[str] | None, others: Iterable[str] = (), keys: Sequence[str] = ()
) -> dict[str, dict[str, ParameterValue]]:
    """Read the values of `--set`, by instance and name, in whatever order they stand."""
    given: dict[str, dict[str, ParameterValue]] = {}
    instances = tuple(dict.fromkeys((*INTERFACES, *others)))
    for text in assignments or ():
        instance, name, value = parse_assignment(text, instances, keys)
        given.setdefault(instance, {})[name] = value
    return given


def assigned(
    scenario: Scenario, assignments: list[str] | None, options: Options | None = None
) -> tuple[Scenario, Options]:
    """Return a scenario with its keys changed by `--set`, and options with the FMUs' parameters."""
    settings, parameters = split_settings(assignments or ())
    changed = overrides(parameters, instances(scenario), TOP)
    return with_values(scenario, settings), replace(options or Options(), overrides=changed)


def announce_build(target: Target | None = None) -> None:
    """Print which FMUs are about to be built, if any."""
    names = outdated(target=target)
    if names:
        tell(f"Building {' and '.join(names)}: the cache has none for this version of the code ...")
