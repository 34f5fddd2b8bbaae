"""The controller: differential inverse kinematics and one PID a joint.

Nothing in here knows of FMI. `Controller` is updated once a period through preallocated
buffers.
"""

from .controller import Controller
from .gains import PRESETS, Gains, preset
from .signals import INPUTS, OUTPUTS

__all__ = ["INPUTS", "OUTPUTS", "PRESETS", "Controller", "Gains", "preset"]
