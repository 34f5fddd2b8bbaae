"""`panda-cosim retime` and `panda-cosim route`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from ...assets import STEP_SIZE
from ...assets.checks import ARMS
from ...fmus.atomic import write_whole
from ...fmus.errors import InputError, located
from ...result.recording.logs import SUFFIXES
from ...run.folder import keep_scenario, refuse_existing
from ...run.prepare import prepare
from ...run.start import new_timing, start_values
from ...study.check.motion import motion_text, retimed
from ...task.files import as_argument, check_new
from ...task.scenario import MAX_DURATION, SCENARIO_FILE, TABLE_FILE, Scenario
from ...task.table import TrajectoryTable
from ...task.timing.demand import Shares
from ...task.writer import write_scenario
from ..common import ROBOT, SCENARIO, SETTINGS, Robot, find_scenario, values_of
from ..console import show, table, tell
from ..forms import flag, option, scenario_argument


def command(  # noqa: PLR0913 - one for each option
    scenario: str = scenario_argument(),
    out: Path | None = option("--out -o DIR|FILE.csv"),
    share: float | None = option("--share", min=0.1, max=1.0),
    keep_times: bool = flag("--keep-times"),
    robot: Robot | None = ROBOT,
    assignments: list[str] | None = SETTINGS,
) -> None:
    """Fit a scenario's times to the robot's limits.

    The motion becomes as fast as possible (this needs the extra `retime`). Dwells keep their
    length; corners are rounded where the table has a `blend` [m]. The new scenario's table has a
    row at least every 10 ms, in the world frame: it fits only the block's present pose.

    With `--keep-times`, the rows stay as they are. Those that exceed the robot's limits get more
    time; the others keep theirs.

    With `--robot fr3`, the times are for that arm, and the new scenario has `robot = "fr3"`.

    A motion, a file as `check` takes it, becomes slower or faster as a whole, until its robot
    refuses nothing and it uses at most the share.

    ```
    panda-cosim retime pick_and_place
    panda-cosim retime my-scenarios/hasty --keep-times
    panda-cosim retime motion.csv --robot fr3
    panda-cosim retime pick_and_place --share 0.7 --out my-scenarios/gentle
    ```

    Args:
        scenario: Name of a shipped scenario, a scenario's folder, or a motion: .csv, .parquet or
            .mcap.
        out: New folder, or file of a motion. Default: NAME_fast, or NAME_feasible with
            --keep-times.
        share: Share of the robot's limits to use. Default: the scenario's timing_share, 0.9 unless
            set.
        keep_times: Only slow down rows that exceed the share.
    """
    suffix = "feasible" if keep_times else "fast"
    if Path(scenario).suffix in SUFFIXES:
        _retime_motion(Path(scenario), out, robot, share or Scenario.timing_share, suffix)
        return
    chosen = find_scenario(scenario).changed(values_of(assignments, robot=ARMS.get(robot or "")))
    folder = out or Path(f"{chosen.name}_{suffix}")
    check_new((folder / SCENARIO_FILE, folder / TABLE_FILE))
    tell(f"Timing {chosen.name} ...")
    retimed, shares = retime(chosen, share, keep_times=keep_times)
    write_scenario(retimed, folder)
    before, rows = chosen.rows[-1].time, retimed.rows
    used = [(name, f"{value:.1%}") for name, value in shares.items()]
    show(table(("limit*", "largest share"), used, right=("largest share",)))
    show(f"{chosen.name}: {before:g} s becomes {rows[-1].time:g} s, {len(rows)} rows")
    show(f"{folder}\nNext: panda-cosim run {as_argument(folder)}")


def _retime_motion(
    path: Path, out: Path | None, robot: Robot | None, share: float, suffix: str
) -> None:
    """Write a motion at new times as CSV."""
    file = out or Path(f"{path.stem}_{suffix}.csv")
    check_new([file])
    motion, factor = retimed(path, robot, share, keep_times=suffix == "feasible")
    write_whole(file, motion_text(motion))
    show(f"{path}: takes {factor:.3g} times as long: {motion.times[-1] - motion.times[0]:.3f} s")
    show(f"{file}\nNext: panda-cosim check {file} --robot {robot}")


def retime(
    scenario: Scenario, share: float | None = None, *, keep_times: bool = False
) -> tuple[Scenario, Shares]:
    """Compute new times for a scenario's table and the block's start pose."""
    if scenario.has_own_parts:
        raise InputError(
            f"{scenario.name}: has FMUs of its own; must have our plant and controller"
        )
    share, word = share or scenario.timing_share, "feasible" if keep_times else "optimal"
    new = replace(scenario, timing=word, timing_share=share, duration=MAX_DURATION)
    with located(scenario.name):
        timing = new_timing(new, start_values(scenario))
    table, interpolation, duration = timing.table, "spline", timing.cycle
    if table is None:  # the rows at new times, and as much time after the last one as before
        rows, times = scenario.rows, timing.trajectory.times.tolist()
        moved = (replace(row, time=time) for row, time in zip(rows, times, strict=True))
        table, interpolation = TrajectoryTable(tuple(moved)), scenario.interpolation
        duration = scenario.duration + timing.cycle - rows[-1].time
    duration = round(math.ceil(duration / STEP_SIZE - 1e-6) * STEP_SIZE, 9)
    new = replace(
        scenario, table=table, timing="table", interpolation=interpolation, duration=duration
    )
    return new, timing.shares


def route(
    scenario: str = SCENARIO,
    out: Path | None = option("--out -o DIR"),
    robot: Robot | None = ROBOT,
    assignments: list[str] | None = SETTINGS,
) -> None:
    """Plan a scenario's motion: any block, any place, past all obstacles.

    The new scenario grasps the block where it stands, carries it past everything in the scene, and
    sets it down at `[success] block_position`. Arm, hand and block keep 4 mm from everything else.
    Its table also sets the arm's posture (`q1` to `q7`), and uses at most `timing_share` of the
    limits. The same input gives the same table. Needs OMPL: pip install 'panda-cosim[route]'.

    With `--robot fr3`, the route is for that arm, and the new scenario has `robot = "fr3"`.

    ```
    panda-cosim route pick_and_place --out behind --set plant.block_pos=-0.4,0.3
    panda-cosim run behind
    ```

    Args:
        out: New folder. Default: NAME_routed.
    """
    chosen = find_scenario(scenario).changed(values_of(assignments, robot=ARMS.get(robot or "")))
    folder = out or Path(f"{chosen.name}_routed")
    refuse_existing(folder)
    tell(f"Planning {chosen.name} ...")
    prepared = prepare(replace(chosen, route="auto"))
    keep_scenario(prepared.scenario, prepared.assembly, folder)
    rows = prepared.scenario.rows
    show(f"{chosen.name}: {rows[-1].time:.2f} s, {len(rows)} rows")
    show(f"{folder}\nNext: panda-cosim run {as_argument(folder)}")
