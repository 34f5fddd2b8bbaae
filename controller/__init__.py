"""The controller: differential inverse kinematics and one PID per joint.

Nothing in here knows of FMI. `controller.Controller` owns the buffers and picks the law; the laws
are `reference_law` (the default), `tutorial_law` and `impedance`.
"""
