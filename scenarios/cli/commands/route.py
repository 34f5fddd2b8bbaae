"""`panda-cosim route`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...files import as_argument
from ...run.folder import keep_scenario, refuse_existing
from ...run.options import with_options
from ...run.prepare import prepare
from ..console import show, tell
from ..options import ROBOT, SCENARIO, SETTINGS, Robot, assigned, find_scenario, option


def command(
    scenario: str = SCENARIO,
    out: Path | None = option("--out -o DIR", "New folder. Default: NAME_routed."),
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
    """
    chosen = with_options(*assigned(find_scenario(scenario), assignments, robot=robot))
    folder = out or Path(f"{chosen.name}_routed")
    refuse_existing(folder)
    tell(f"Planning {chosen.name} ...")
    prepared = prepare(replace(chosen, route="auto"))
    keep_scenario(prepared.scenario, prepared.assembly, folder)
    rows = prepared.scenario.table.rows
    show(f"{chosen.name}: {rows[-1].time:.2f} s, {len(rows)} rows")
    show(f"{folder}\nNext: panda-cosim run {as_argument(folder)}")
