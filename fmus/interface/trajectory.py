"""The interface of PandaTrajectory: its outputs are the controller's commands."""

from __future__ import annotations

from typing import Final

from .variables import Interface, Variable, output

TABLE_FILE: Final = "table.bin"  # float64, little-endian, one row of 14 per millisecond
# Equal to the controller's inputs of these names, which a test checks, so that the controller need
# not be imported here.
TRAJECTORY = Interface(
    "PandaTrajectory",
    "Plays a scenario's commands for PandaController, one row per millisecond",
    (
        output("pos_cmd", (3,), "m", "Commanded position of the hand body's origin, world frame"),
        output("quat_cmd", (4,), "1", "Commanded orientation of the hand body, world frame, "
               "(w, x, y, z)"),
        output("vel_cmd", (3,), "m/s", "Commanded velocity of the hand body's origin, world "
               "frame"),
        output("omega_cmd", (3,), "rad/s", "Commanded angular velocity of the hand body, world "
               "frame"),
        output("grip_cmd", (), "m", "Commanded opening between the fingertips"),
        Variable("table", (), "", "parameter", "fixed", "CSV file to play instead of the built-in "
                 "table, as `panda-cosim inputs` writes it; empty: the built-in one. Only FMUs of "
                 "kind python read it", "", kind="String"),
    ),
    {"command": ("pos_cmd", "quat_cmd", "vel_cmd", "omega_cmd", "grip_cmd")},
)  # fmt: skip
