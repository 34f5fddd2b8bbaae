"""Limits of both arms from Franka's documents, once more."""

import numpy as np

from panda_cosim.task.rotations import Array

FER = {
    "low": np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]),
    "high": np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]),
    "velocity": np.array([2.175] * 4 + [2.61] * 3),
    "acceleration": np.array([15, 7.5, 10, 12.5, 15, 20, 20]),
    "jerk": np.array([7500.0, 3750, 5000, 6250, 7500, 10000, 10000]),
    "translation": [1.7, 13.0, 6500.0],
    "rotation": [2.5, 25.0, 12500.0],
    "elbow": [2.175, 10.0, 5000.0],
}
FR3 = {
    "low": np.array([-2.9007, -1.8361, -2.9007, -3.0770, -2.8763, 0.4398, -3.0508]),
    "high": np.array([2.9007, 1.8361, 2.9007, -0.1169, 2.8763, 4.6216, 3.0508]),
    "velocity": np.array([2.62] * 4 + [5.26, 4.18, 5.26]),
    "acceleration": np.full(7, 10.0),
    "jerk": np.full(7, 5000.0),
    "translation": [3.0, 9.0, 4500.0],
    "rotation": [2.5, 17.0, 8500.0],
    "elbow": [1.5, 10.0, 5000.0],
}


def speed(robot: str, q: Array, qd: Array) -> Array:
    """Largest speed at a position (n, 7), as libfranka's rate_limiting.h has it."""
    if robot == "fer":
        return FER["velocity"]
    most, offset, slope, low, high = np.transpose([
        (2.62, 0.30, 12.0, -2.7501, 2.7501), (2.62, 0.20, 5.17, -1.7918, 1.7918),
        (2.62, 0.20, 7.0, -2.9065, 2.9065), (2.62, 0.30, 8.0, -3.0481, -0.1458),
        (5.26, 0.35, 34.0, -2.8101, 2.8101), (4.18, 0.35, 11.0, 0.54092, 4.5205),
        (5.26, 0.35, 34.0, -3.0196, 3.0196),
    ])  # fmt: skip
    room = np.where(qd >= 0.0, high - q, q - low)
    return np.clip(np.sqrt(np.maximum(slope * room, 0.0)) - offset, 0.0, most)
