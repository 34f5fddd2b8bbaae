"""The controller: differential inverse kinematics and one PID a joint.

Nothing in here knows of FMI. `Controller` is updated once a period through preallocated
buffers.
"""

from controller.controller import Controller
from controller.gains import PRESETS, Gains, preset
from controller.signals import INPUTS, OUTPUTS

__all__ = ["INPUTS", "OUTPUTS", "PRESETS", "Controller", "Gains", "preset"]
