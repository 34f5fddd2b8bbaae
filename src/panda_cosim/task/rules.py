"""Which keys of a scenario exclude or need each other: one table, also of the reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from ..assets import TORQUE_DRIVEN
from ..fmus.errors import InputError

Scenario = Any  # that of scenario.py, which imports this module
# Keys that act on the project's plant and controller, or on FMUs that are made of models.
OF_HAND: Final = ("interpolation", "timing", "timing_share", "align")  # on its commands
OF_ARM: Final = ("scene", "robot", "gains", *OF_HAND, "push")
OF_MODELS: Final = ("mujoco", "input_scale")
AT_TOP: Final = (
    ("plant", "scene"), ("plant", "robot"), ("controller", "gains"), ("controller", "robot"),
)  # fmt: skip


def check_combinations(scenario: Scenario) -> None:
    """Refuse a scenario that breaks a rule; the first one counts."""
    for text, broken in RULES.items():
        if found := broken(scenario):
            raise InputError(text.format(scenario, found))


def _given(scenario: Any, keys: tuple[str, ...]) -> str:
    """Return the first of some keys that differs from its default, or ""."""
    return next((key for key in keys if getattr(scenario, key) != getattr(type(scenario), key)), "")


def _below_top(s: Scenario) -> str:
    return next((f"[{name}] {key}" for name, key in AT_TOP if key in s.sections[name]), "")


def _has_impedance(s: Scenario) -> object:
    return s.controller.get("impedance", s.gains == "impedance")


def _is_ours(s: Scenario) -> bool:
    return not s.is_system and "controller" not in s.fmus


def _has_idle_torque(s: Scenario) -> bool:
    torques = [name for name in s.inputs if name.partition("[")[0] == "plant.torque"]
    return bool(torques) and not (s.is_system or s.is_torque_driven or "plant" in s.fmus)


# By message, in which {0} is the scenario and {1} what was found, the condition that breaks it.
RULES: Final[Mapping[str, Callable[[Scenario], object]]] = {
    "trajectory.csv: must be there, unless there is system, [fmus] or route": lambda s: (
        s.table is None and not (s.system or s.fmus or s.route)
    ),
    "system: cannot be combined with [fmus] and [connect]; must be one of them": lambda s: (
        s.system and (s.fmus or s.connect)
    ),
    "{1}: acts only on a scenario with a trajectory.csv; must be left out here, as a system has "
    "none": lambda s: s.is_system and _given(s, OF_ARM),
    "{1}: acts only on a trajectory.csv or a route; must be left out here": lambda s: (
        not s.is_commanded and _given(s, OF_HAND)
    ),
    "{1}: must be left out with system, which has its own FMUs": lambda s: (
        s.system and _given(s, OF_MODELS)
    ),
    'coupling: value "iterated"; must be another one with [steps], or with a '
    "trajectory.csv": lambda s: s.coupling == "iterated" and (s.steps or not s.is_system),
    "mismatch: only valid with the project's own plant": lambda s: (
        s.mismatch.values and s.is_system
    ),
    "{1}: must stand at the top, before all sections": _below_top,
    "scene: value {0.scene!r}; must come with a controller that gives torques, such as "
    'gains = "impedance", or [fmus] controller = "my_law.py:MyLaw"': lambda s: (
        s.is_torque_driven and _is_ours(s) and not _has_impedance(s)
    ),
    'robot: value {0.robot!r}; must be "fr3" with the FMU franka': lambda s: (
        s.fmus.get("controller") == "franka" and s.robot != "fr3"
    ),
    f'gains: value {{0.gains!r}}; must come with scene = "{TORQUE_DRIVEN}"': lambda s: (
        _has_impedance(s) and _is_ours(s) and not s.is_torque_driven
    ),
    f'[inputs] plant.torque: acts only with scene = "{TORQUE_DRIVEN}"': _has_idle_torque,
    "[controller] reaction: value {0.controller[reaction]!r} moves servos; with impedance, it "
    'must be "none"': lambda s: (
        _has_impedance(s) and s.controller.get("reaction", "none") != "none"
    ),
    'until: is in the table; must have interpolation "quintic" or "linear", and timing '
    '"table"': lambda s: (s.interpolation == "spline" or s.timing != "table") and s.untils,
    'grip_force: the gripper of scene "tutorial" is too weak for it; must be left out of the '
    "table": lambda s: s.scene == "tutorial" and any(row.grip_force for row in s.rows),
    "route: value {0.route!r}; must come with [success] block_position, and with the project's "
    "own controller": lambda s: (
        s.route and (not s.success.block_position or s.system or "controller" in s.fmus)
    ),
    'q1 to q7: must be left out of the table with gains = "tutorial" or timing = '
    '"optimal"': lambda s: s.has_posture and (s.gains == "tutorial" or s.timing == "optimal"),
    'expect_reason: must say why expect is "failure", and only then be set': lambda s: (
        (s.expect == "failure") != bool(s.expect_reason)
    ),
}
