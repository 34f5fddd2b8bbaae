"""`panda-cosim retime`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...files import as_argument, check_new
from ...run.options import with_options
from ...run.retime import retime
from ...scenario.scenario import SCENARIO_FILE, TABLE_FILE
from ...scenario.writer import write_scenario
from ..console import show, table, tell
from ..options import Assignments, ScenarioName, assigned, find_scenario


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
    chosen = with_options(*assigned(find_scenario(scenario), assignments))
    folder = out or Path(f"{chosen.name}_{'feasible' if keep_times else 'fast'}")
    check_new((folder / SCENARIO_FILE, folder / TABLE_FILE))
    tell(f"Timing {chosen.name} ...")
    retimed, shares = retime(chosen, share, keep_times=keep_times)
    write_scenario(retimed, folder)
    before, rows = chosen.table.rows[-1].time, retimed.table.rows
    used = table(("limit*", "largest share"), right=("largest share",))
    for name, value in shares.items():
        used.add_row(name, f"{value:.1%}")
    show(used)
    show(f"{chosen.name}: {before:g} s becomes {rows[-1].time:g} s, {len(rows)} rows")
    show(f"{folder}\nNext: panda-cosim run {as_argument(folder)}")
