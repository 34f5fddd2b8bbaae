"""What the plant takes and gives; the fields' order is that of the flat buffers."""

import numpy as np

from .parameters import MOVING_LINKS

INPUTS = np.dtype(
    [
        ("ctrl", float, 8),
        ("push_force", float, 3),
        ("block_force", float, 3),
        ("torque", float, 7),
        *((f"{link}_force", float, 3) for link in MOVING_LINKS),
    ]
)
OUTPUTS = np.dtype(
    [
        ("qpos", float, 16),
        ("qvel", float, 15),
        ("hand_xpos", float, 3),
        ("hand_xquat", float, 4),
        ("target_xpos", float, 3),
        ("target_xmat", float, 9),
        ("jac", float, (6, 7)),
        ("qfrc_bias", float, 7),
        ("actuator_force", float, 8),
        ("contact_force", float),
        ("unwanted_contact_force", float),
        ("support_force", float),
        ("table_force", float),
        ("mass_matrix", float, (7, 7)),
    ]
)
