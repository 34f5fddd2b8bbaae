"""Checks the actions of a journal, all of them before anything is run."""

from __future__ import annotations

from ...fmus.errors import InputError
from ...fmus.messages import did_you_mean, excerpt
from .adjustments import Adjustments
from .journal import END, Action, Journal

# What each action needs; a moved waypoint takes the fields of a row, an end may have a reason.
_ARGUMENTS: dict[str, tuple[str, ...]] = {
    "set": ("name", "value"), "release": ("name",), "move_waypoint": ("row",),
    "set_coupling": ("coupling",), END: (),
}  # fmt: skip


def check_actions(journal: Journal, adjustments: Adjustments, ticks: int, step: float) -> None:
    """Check that all actions can be taken, one after the other.

    Args:
        journal: The journal.
        adjustments: What can be changed in the run, as it is at t = 0.
        ticks: Steps to the scenario's end.
        step: Step size [s].

    Raises:
        InputError: One cannot; its line is named.
    """
    for number, action in enumerate(journal.actions, start=2):
        place = f"{journal.path}: line {number}"
        if action.tick > ticks:
            raise InputError(f"{place}: tick {excerpt(action.tick)}; must be at most {ticks}")
        try:
            _check(action, adjustments, action.tick * step)
        except InputError as error:
            raise InputError(f"{place}: {error}") from None


def _check(action: Action, adjustments: Adjustments, now: float) -> None:
    """Check an action by its name and arguments, and take it as far as no FMU is needed."""
    if action.name not in _ARGUMENTS:
        raise InputError(
            f"action {excerpt(action.name)}; valid: {', '.join(_ARGUMENTS)}"
            f"{did_you_mean(action.name, _ARGUMENTS)}"
        )
    needed = _ARGUMENTS[action.name]
    given = dict(action.arguments)
    if missing := [name for name in needed if name not in given]:
        raise InputError(f"{action.name}: {missing[0]} is missing; must be as `Session` writes it")
    values = [given.pop(name) for name in needed]
    match action.name:
        case "set":
            adjustments.note(adjustments.set(*values))
        case "release":
            adjustments.release(*values)
        case "set_coupling":
            adjustments.check_coupling(*values)
        case "move_waypoint":
            adjustments.move_waypoint(values[0], given, now)
            given = {}
        case _:
            _check_reason(given.pop("reason", ""))
    if given:
        raise InputError(f"{action.name}: {excerpt(min(given))}; must be as `Session` writes it")


def _check_reason(reason: object) -> None:
    if not isinstance(reason, str):
        raise InputError(f"end: reason {excerpt(reason)}; must be text")


__all__ = ["check_actions"]
