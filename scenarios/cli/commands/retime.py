"""`panda-cosim retime`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...definition.scenario import SCENARIO_FILE, TABLE_FILE
from ...definition.writer import write_scenario
from ...files import as_argument, check_new
from ...running.assembly import instances
from ...running.options import Options, with_options
from ...running.retime import retime
from ...running.settings import TOP, split_settings, with_values
from ..console import show, table, tell
from ..options import Assignments, ScenarioName, find_scenario, overrides


def command(
    scenario: ScenarioName,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="New folder. Default: NAME_fast, or NAME_feasible with --keep-times.",
        ),
    ] = None,
    share: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            max=1.0,
            help="Share of the robot's limits to use. Default: the scenario's timing_share, 0.9 "
            "unless set.",
        ),
    ] = None,
    keep_times: Annotated[
        bool,
        typer.Option("--keep-times", help="Only slow down rows that exceed the share."),
    ] = False,
    assignments: Assignments = None,
) -> None:
    """Fit a scenario's times to the robot's limits.

    The motion becomes as fast as possible (this needs the extra `retime`). Dwells keep their
    length; corners are rounded where the table has a `blend` [m]. The new scenario's table has a
    row at least every 10 ms, in the world frame: it fits only the block's present pose.

    With `--keep-times`, the rows stay as they are. Those that ask too much of the robot get more
    time; the others keep theirs.

    ```
    panda-cosim retime pick_and_place
    panda-cosim retime my-scenarios/hasty --keep-times
    panda-cosim retime pick_and_place --share 0.7 --out my-scenarios/gentle
    ```
    """
    settings, parameters = split_settings(assignments or ())
    chosen = find_scenario(scenario)
    values = overrides(parameters, instances(chosen), TOP)
    given = with_options(with_values(chosen, settings), Options(overrides=values))
    folder = out or Path(f"{given.name}_{'feasible' if keep_times else 'fast'}")
    check_new((folder / SCENARIO_FILE, folder / TABLE_FILE))
    tell(f"Timing {given.name} ...")
    made, shares = retime(given, share, keep_times=keep_times)
    write_scenario(made, folder)
    before, rows = given.table.rows[-1].time, made.table.rows
    used = table(("limit*", "largest share"), right=("largest share",))
    for name, value in shares.items():
        used.add_row(name, f"{value:.1%}")
    show(used)
    show(f"{given.name}: {before:g} s becomes {rows[-1].time:g} s, {len(rows)} rows")
    show(f"{folder}\nNext: panda-cosim run {as_argument(folder)}")
