"""Runs a session again from its journal, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...fmus.errors import InputError
from ...fmus.messages import did_you_mean, excerpt
from ..scenario.scenario import Scenario
from .adjustments import Adjustments
from .folders import SCENARIO_FOLDER
from .journal import END, Action, Journal
from .options import Options
from .result import Run
from .session import Session

# What each action needs; a moved waypoint takes the fields of a row, an end may have a reason.
_ARGUMENTS: dict[str, tuple[str, ...]] = {
    "set": ("name", "value"), "release": ("name",), "move_waypoint": ("row",),
    "set_coupling": ("coupling",), END: (),
}  # fmt: skip


def replay(
    place: str | Path,
    out: str | Path | None = None,
    options: Options | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Run:
    """Run a session again.

    A session that failed or was killed is run to its scenario's end, or to the same failure.

    Args:
        place: Its `session.jsonl` or its folder; the scenario lies beside it.
        out: New folder for the run; None: one named by scenario and time, in `runs`.
        options: How to run it; the journal takes precedence.
        progress: Called with the completed and the total steps.

    Raises:
        InputError: The journal cannot be used.
        SimulationError: An FMU fails; what was recorded is kept.
    """
    journal = Journal.read(place)
    scenario, options = _session_of(journal, options or Options())
    session = Session(scenario, out, options)
    adjustments = session.adjustments_at_start()
    check_actions(journal, adjustments, session.ticks, scenario.step)  # before anything is run
    with session:
        session.warnings += _changed_fmus(journal.head["fmus"], session.head["fmus"])
        for action in journal.actions:
            session.step(action.tick - session.tick, progress)
            if action.name == END:
                return session.close(action.arguments.get("reason"))
            getattr(session, action.name)(**action.arguments)
        session.step(session.ticks - session.tick, progress)
        return session.close()


def read_session(place: str | Path, options: Options) -> tuple[Scenario, Options]:
    """Read the scenario of a session, and complete the options of the run."""
    return _session_of(Journal.read(place), options)


def _session_of(journal: Journal, options: Options) -> tuple[Scenario, Options]:
    scenario = Scenario.read(journal.path.parent / SCENARIO_FOLDER)
    scenario = replace(scenario, name=journal.head["scenario"])
    return scenario, replace(options, kind=journal.head["kind"])


def _changed_fmus(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    return [
        f"{name}: another FMU than the session's; the values may differ"
        for name in now
        if then.get(name) != now[name]
    ]


def check_actions(journal: Journal, adjustments: Adjustments, ticks: int, step: float) -> None:
    """Check that all actions can be taken, one after the other."""
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
