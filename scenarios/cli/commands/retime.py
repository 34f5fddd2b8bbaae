"""`panda-cosim retime`."""

from __future__ import annotations

from pathlib import Path

from ...files import as_argument, check_new
from ...run.options import with_options
from ...run.retime import retime
from ...scenario.scenario import SCENARIO_FILE, TABLE_FILE
from ...scenario.writer import write_scenario
from ..console import show, table, tell
from ..options import SCENARIO, SETTINGS, assigned, find_scenario, option


def command(
    scenario: str = SCENARIO,
    out: Path | None = option(
        "--out -o DIR", "New folder. Default: NAME_fast, or NAME_feasible with --keep-times."
    ),
    share: float | None = option(
        "--share",
        "Share of the robot's limits to use. Default: the scenario's timing_share, 0.9 unless set.",
        min=0.1,
        max=1.0,
    ),
    keep_times: bool = option("--keep-times", "Only slow down rows that exceed the share.", False),
    assignments: list[str] | None = SETTINGS,
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
    used = [(name, f"{value:.1%}") for name, value in shares.items()]
    show(table(("limit*", "largest share"), used, right=("largest share",)))
    show(f"{chosen.name}: {before:g} s becomes {rows[-1].time:g} s, {len(rows)} rows")
    show(f"{folder}\nNext: panda-cosim run {as_argument(folder)}")
