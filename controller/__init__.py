"""The controller: differential inverse kinematics and one PID a joint.

Nothing in here knows of FMI. `Controller` is updated once a period through preallocated
buffers.
"""

from controller.controller import INPUTS, OUTPUTS, Controller
from controller.gains import PRESETS, Gains, preset

__all__ = ["INPUTS", "OUTPUTS", "PRESETS", "Controller", "Gains", "preset"]
