"""Makes the folder of a new scenario, which can be run without changes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from ...fmus.errors import InputError
from ...fmus.messages import excerpt
from ..files import as_argument, write_all
from .scenario import SCENARIO_FILE, TABLE_FILE

SETTINGS: Final = """\
# What this scenario is for, in one line.
purpose = "Picks the block up and holds it"
duration = 3.4  # s; everything below is optional

scene = "tabletop"         # or "tutorial", with a weak gripper
gains = "default"          # or "tutorial", a simpler control law
coupling = "gauss-seidel"  # or "jacobi": each command acts one step later
interpolation = "quintic"  # stops at each row; "spline": does not; "linear": no velocity commands
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

# Conditions of success. Further keys: block_position and position_tolerance [m],
# max_drop [m] and max_set_down_force [N] when it is released, max_yaw_error, max_tilt and
# orientation_rms [deg], tracking_rms [m].
[success]
min_lift = 0.10       # m
max_slip = 0.002      # m, in the hand, while it is carried
tracking_max = 0.002  # m

# Tolerances about the reference, for `panda-cosim regress`; all have defaults.
[regression]
# time = 0.001               # s
scale = 10.0                 # widens the defaults: grasping amplifies rounding
# "plant.contact_force" = 2  # N
"""

# Positions are those of the hand, 0.1 m above the fingertips, relative to `home`, the world, or the
# centre of the block's top (`target`).
TABLE: Final = """\
time,frame,x,y,z,grip
0.0,home,0.0,0.0,0.0,0.08
1.2,target,0.0,0.0,0.185,0.08
1.7,target,0.0,0.0,0.085,0.0
2.2,target,0.0,0.0,0.085,0.0
3.0,target,0.0,0.0,0.235,0.0
"""

# A scenario for a user's law: the same task, with criteria that a simple law can meet.
LAW_SETTINGS: Final = """\
# What this scenario is for, in one line.
purpose = "Picks the block up with my own control law"
duration = 3.4  # s

# A class in a Python file, or an .fmu file. It is code, and runs with your permissions.
[fmus]
controller = "my_law.py:ResolvedRate"

# Its parameters, by their names in the class.
[controller]
# gain = 12.0

[success]
min_lift = 0.10   # m
max_slip = 0.002  # m, in the hand

[[success.signal]]
name = "error at rest"
signal = { norm = ["plant.hand_xpos", "controller.pos_cmd"] }
reduce = "final"
below = 0.003  # m

[regression]
scale = 10.0  # widens the defaults: grasping amplifies rounding
"""

LAW_FILE: Final = "my_law.py"
LAW: Final = '''\
"""A control law. Its class becomes an FMU when the scenario is run."""

import numpy as np


class ResolvedRate:
    """Resolved rate: joint velocities that move the hand as commanded, by damped least squares."""

    # Numbers here are parameters of the FMU.
    gain = 10.0  # 1/s, rate at which a pose error is driven to zero
    damping = 0.05  # of the least squares
    lag = 0.1  # s, by which a servo lags behind a ramp; its target is that much ahead

    def start(self):
        self.target = None  # of the seven joint servos [rad]

    # The arguments name its inputs: commands, and outputs of the plant (see `panda-cosim info`).
    # Positions [m] and quaternions (w, x, y, z) are in the world frame.
    def update(self, time, pos_cmd, quat_cmd, vel_cmd, grip_cmd, hand_xpos, hand_xquat, jac, qpos):
        """Called every millisecond; returns seven servo targets [rad] and the gripper's (0-255)."""
        if self.target is None:
            self.target = qpos
        error = np.hstack((pos_cmd - hand_xpos, self.turn(quat_cmd, hand_xquat)))
        twist = np.hstack((vel_cmd, np.zeros(3))) + self.gain * error  # of the hand [m/s, rad/s]
        square = jac @ jac.T + self.damping**2 * np.eye(6)
        speed = jac.T @ np.linalg.solve(square, twist)  # of the joints [rad/s]
        self.target = self.target + 0.001 * speed
        return np.hstack((self.target + self.lag * speed, np.clip(255 * grip_cmd / 0.08, 0, 255)))

    def turn(self, wanted, measured):
        """Rotation from `measured` to `wanted` as a vector [rad], for small angles."""
        w = wanted @ measured
        v = measured[0] * wanted[1:] - wanted[0] * measured[1:] + np.cross(measured[1:], wanted[1:])
        return 2 * np.copysign(1.0, w) * v
'''

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,199}", re.A)


def make_scenario(folder: Path, *, controller: bool = False) -> list[Path]:
    """Make a scenario's folder with its two files.

    Args:
        folder: The folder; its name becomes the scenario's name.
        controller: Add a control law.

    Returns:
        The files.

    Raises:
        InputError: The name is not valid, or the folder exists or cannot be written.
    """
    if not _NAME.fullmatch(folder.name):
        raise InputError(
            f"scenario name {excerpt(folder.name)}: must be at most 200 letters, digits, _ . and "
            "-, and not begin with a sign"
        )
    contents = {folder / SCENARIO_FILE: SETTINGS, folder / TABLE_FILE: TABLE}
    if controller:
        contents |= {folder / SCENARIO_FILE: LAW_SETTINGS, folder / LAW_FILE: LAW}
    for path in contents:
        if path.exists():
            raise InputError(
                f"{path}: already exists; must be a new folder "
                f"(`panda-cosim check {as_argument(folder)}` says whether it runs)"
            )
    write_all(contents)
    return list(contents)
