"""The controller: differential inverse kinematics and one PID per joint.

Nothing in here knows of FMI. `Controller` owns the buffers and picks the law; the laws are
`reference_law` (the default) and `tutorial_law`.
"""

from .controller import LAWS, Controller
from .gains import PRESETS, Gains, preset
from .signals import INPUTS, OUTPUTS

__all__ = ["INPUTS", "LAWS", "OUTPUTS", "PRESETS", "Controller", "Gains", "preset"]
