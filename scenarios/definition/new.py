"""Makes the folder of a new scenario, which runs as it is."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from ...fmus.errors import InputError
from ...fmus.messages import excerpt
from ..files import write_all
from .scenario import SCENARIO_FILE, TABLE_FILE

SETTINGS: Final = """\
# What this scenario is for, in one line.
purpose = "Picks the block up and holds it"
duration = 3.4  # s; all that follows may be left out

scene = "tabletop"         # or "tutorial", with a weak gripper
gains = "default"          # or "tutorial", a simpler control law
coupling = "gauss-seidel"  # or "jacobi": each command acts one step late
interpolation = "quintic"  # a stop at each row; "spline": none; "linear": no velocity commands
align = true               # rows of frame "target" turn with the block

# Start values of the FMUs' parameters; `panda-cosim info` lists them.
[plant]
block_pos = [0.4, -0.2]  # m
block_yaw = 0.0          # rad
block_mass = 0.18        # kg

[controller]
# kp = 8.0       # all seven joints
# "kp[3]" = 7.0  # one of them

# A force on the hand, in world axes. There may be several.
# [[push]]
# start = 1.0               # s
# duration = 0.1            # s
# force = [0.0, 20.0, 0.0]  # N

# When the run is a success. Further keys: block_position and position_tolerance [m],
# max_yaw_error, max_tilt and orientation_rms [deg], tracking_rms [m].
[success]
min_lift = 0.10       # m
max_slip = 0.002      # m, in the hand
tracking_max = 0.002  # m

# How near a run must be to its reference (`panda-cosim regress`); there are good defaults.
[regression]
# time = 0.001               # s
scale = 10.0                 # of the defaults: where something is grasped, rounding matters more
# "plant.contact_force" = 2  # N
"""

# Positions are the hand's, which is 0.1 m above the fingertips; its frame's origin is `home`, the
# world, or the centre of the block's top (`target`).
TABLE: Final = """\
time,frame,x,y,z,grip
0.0,home,0.0,0.0,0.0,0.08
1.2,target,0.0,0.0,0.185,0.08
1.7,target,0.0,0.0,0.085,0.0
2.2,target,0.0,0.0,0.085,0.0
3.0,target,0.0,0.0,0.235,0.0
"""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*", re.A)


def make_scenario(folder: Path) -> list[Path]:
    """Make a scenario's folder with its two files.

    Args:
        folder: Where; its last part is the scenario's name.

    Returns:
        The files.

    Raises:
        InputError: The name is no good, something is there already, or it cannot be written.
    """
    if not _NAME.fullmatch(folder.name):
        raise InputError(
            f"scenario name {excerpt(folder.name)}: must be letters, digits, _ . and -, and not "
            "begin with a sign"
        )
    contents = {folder / SCENARIO_FILE: SETTINGS, folder / TABLE_FILE: TABLE}
    for path in contents:
        if path.exists():
            raise InputError(f"{path}: exists already; must be a new folder")
    write_all(contents)
    return list(contents)


__all__ = ["make_scenario"]
