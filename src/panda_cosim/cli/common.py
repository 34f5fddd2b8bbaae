"""Arguments and options shared by several commands, and what they stand for.

Attributes:
    SCENARIO: Name of a shipped scenario, or a scenario's folder.
    SCENARIO_OR_DEFAULT: Name of a shipped scenario, or a scenario's folder.
    RUN: Folder of a run, or its recording.
    SWEEP: Folder of a sweep.
    ROW: Number of a row, from 0: the column index of the results.
    SETTINGS: Start value of an FMU's parameter, such as plant.block_yaw=0.3 or controller.kp=8 (all
        seven joints), or a key of the scenario: duration=3, table.rows[3].x=0.4, mismatch.seed=4.
        `panda-cosim info` lists the parameters. May be repeated.
    CONTROLLER: Replace the controller by LAW.py:CLASS or an .fmu file. Its code runs with your
        permissions.
    PLANT: Replace the plant by a MuJoCo model (.xml, .urdf, .mjb) or an .fmu file.
    ROBOT: Real robot whose limits count: the Panda is fer.
    ISOLATE: Run each FMU in a process of its own, so that a crash ends only that process.
    STEP_TIMEOUT: With --isolate: stop the run if an FMU takes longer for one step.
    SSV: Parameter set of SSP, by FMU.VARIABLE, in any units; --set goes before it.
    OUT_RUN: New folder for the run. Default: one in runs/.
    VIDEO: Draw the video and the contact sheet.
    PLOT: Draw the plot. Default: as for the video.
    VIEW: Write the page that shows the run in 3D.
    JUNIT: Write the verdict as JUnit XML, for CI.
    JSON: Print the result as JSON instead of tables.
    MAP: Names of a log's columns: [names] "plant.qpos[1]" = ["q1"]; also time, seconds and start.
    OPEN_PAGE: Open the page in the browser.
    OVERWRITE: Also replace files that panda-cosim did not write.
    KIND: Compiled FMUs, Python, or Python packed by PythonFMU; auto: compiled while proven equal.
    FMI: FMI version: 2.0 or 3.0.
    MUJOCO: MuJoCo version, such as 3.11.0. Default: the installed one.
    ENGINES: Versions of MuJoCo to run with, such as 3.10.0,3.17.0.
    SCALARS: FMI 3.0 without arrays, for importers that read only scalars.
    NAMES: Names of elements: q[1,2], or q_1_2 for tools without brackets.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import typer

from ..fmus.build.platforms import PLATFORMS
from ..fmus.errors import InputError
from ..fmus.interface.parameters import ParameterValue, literal
from ..fmus.sources.targets import Kind, Target, outdated
from ..fmus.twins import IN_RUNS, notice
from ..result.judging.verdicts import MISSED
from ..task.fields import check_choice
from ..task.scenario import SCENARIO_FILE, Scenario, load_scenario
from ..task.values import Values
from .console import tell, warn
from .forms import argument, described, flag, option, scenario_argument

DEFAULT_SCENARIO = "pick_and_place"
FmiVersion = Literal["2", "3"]
Names = Literal["structured", "flat"]
Robot = Literal["fer", "fr3"]


SCENARIO = scenario_argument()
SCENARIO_OR_DEFAULT = scenario_argument(DEFAULT_SCENARIO)
RUN = argument("RUN", show_default=False)
SWEEP = argument("DIR")
ROW = argument("ROW", min=0)
SETTINGS = option("--set -s KEY=VALUE")
CONTROLLER = option("--controller FILE")
PLANT = option("--plant FILE")
ROBOT = option("--robot")
ISOLATE = flag("--isolate")
STEP_TIMEOUT = option("--step-timeout SECONDS")
SSV = option("--ssv FILE")
OUT_RUN = option("--out -o DIR")
VIDEO = option("--video/--no-video", True)
PLOT = option("--plot/--no-plot")
VIEW = option("--view/--no-view", True)
JUNIT = option("--junit FILE.xml")
JSON = flag("--json")
MAP = option("--map NAMES.toml")
OPEN_PAGE = flag("--open")
OVERWRITE = flag("--overwrite")
KIND = option("--kind", "auto")
FMI = option("--fmi", "2")
PLATFORM = option(
    "--platform LIST", "",
    help=f"Platforms to build for, separated by commas: {', '.join(PLATFORMS)}. Default: this "
    "machine's. Others need the extra `cross`.",
)  # fmt: skip
MUJOCO = option("--mujoco VERSION", "")
ENGINES = option("--mujoco LIST", "")
SCALARS = flag("--scalars")
NAMES = option("--names", "structured")
described(globals(), __doc__)


def target_of(
    kind: Kind = "native", fmi: str = "2", platforms: str = "", *, scalars: bool = False,
    names: Names = "structured",
) -> Target:  # fmt: skip
    """Return what FMUs are built for."""
    if scalars and fmi == "2":
        raise InputError("--scalars: needs --fmi 3; FMI 2.0 has no arrays")
    keys = tuple(name.strip() for name in platforms.split(",")) if platforms.strip() else ()
    for name in keys:
        check_choice("--platform", name, PLATFORMS)
    return Target(kind, int(fmi), keys, scalars, names == "flat")


def find_scenario(name: str) -> Scenario:
    """Load a scenario by name or folder; warns if a folder has the name of a shipped one."""
    scenario = load_scenario(name)
    used, namesake = scenario.folder, Path(name)
    if used and (namesake / SCENARIO_FILE).is_file() and not namesake.samefile(used):
        warn(f"{name} is the shipped scenario; for the folder {name} here, write ./{name}")
    return scenario


def values_of(
    assignments: Iterable[str] | None, controller: str | None = None, plant: str | None = None,
    **options: ParameterValue | None,
) -> Values:  # fmt: skip
    """Return the values that `--set` and other options give, by key of `Scenario.changed`."""
    values: dict[str, ParameterValue] = {}
    for text in assignments or ():
        key, equals, value = (part.strip() for part in text.partition("="))
        if not (key and equals and value):
            valid = "such as plant.block_pos[1]=0.45 or duration=3"
            raise InputError(f"--set {text!r}: must be KEY=VALUE, {valid}")
        values[key] = literal(value)
    others = {"fmus.controller": controller, "fmus.plant": plant, **options}
    return values | {key: value for key, value in others.items() if value is not None}


def end(*, missed: bool) -> None:
    """End a command; if what was asked for is missed, with the exit code that says so."""
    if missed:
        raise typer.Exit(MISSED.exit_code)


def announce_python(kind: Kind = "auto", twins: Iterable[str] = IN_RUNS) -> None:
    """Warn of FMUs, or a master's step, that run in Python as their twins in C are outdated."""
    if kind == "auto" and (text := notice(twins)):
        warn(text)


def announce_build(target: Target | None = None) -> None:
    """Print which FMUs are about to be built, if any."""
    if names := outdated(target=target):
        tell(f"Building {' and '.join(names)}: the cache has none for this version of the code ...")
