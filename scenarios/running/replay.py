"""Runs a session again from its journal, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...fmus.errors import InputError
from ...fmus.messages import did_you_mean, excerpt
from ..definition.scenario import Scenario
from .folders import SCENARIO_FOLDER
from .journal import END, Action, Journal
from .options import Options
from .run import Run
from .session import Session

ACTIONS = ("set", "release", "move_waypoint", "set_coupling")


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
    scenario, options = read_session(place, options or Options())
    with Session(scenario, out, options) as session:
        session.warnings += _changed_fmus(journal.head["fmus"], session.head["fmus"])
        for number, action in enumerate(journal.actions, start=2):
            where = f"{journal.path}: line {number}"
            if action.tick > session.ticks:
                raise InputError(f"{where}: tick {action.tick}; must be at most {session.ticks}")
            session.step(action.tick - session.tick, progress)
            if action.name == END:
                return session.close(action.arguments.get("reason"))
            _do(session, where, action)
        session.step(session.ticks - session.tick, progress)
        return session.close()


def read_session(place: str | Path, options: Options) -> tuple[Scenario, Options]:
    """Read the scenario of a session, and complete the options of the run.

    Args:
        place: The session's journal or folder.
        options: How to run it; the journal sets the kind of FMUs.

    Raises:
        InputError: The journal or the scenario is missing or cannot be used.
    """
    journal = Journal.read(place)
    scenario = Scenario.read(journal.path.parent / SCENARIO_FOLDER)
    scenario = replace(scenario, name=journal.head["scenario"])
    return scenario, replace(options, kind=journal.head["kind"])


def _do(session: Session, where: str, action: Action) -> None:
    if action.name not in ACTIONS:
        raise InputError(
            f"{where}: action {excerpt(action.name)}; valid: {', '.join((*ACTIONS, END))}"
            f"{did_you_mean(action.name, ACTIONS)}"
        )
    try:
        getattr(session, action.name)(**action.arguments)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    except TypeError:  # arguments that are missing or too many
        raise InputError(
            f"{where}: {action.name} with {excerpt(', '.join(action.arguments))}; must be as "
            "`Session` writes it"
        ) from None


def _changed_fmus(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    return [
        f"{name}: another FMU than the session's; the values may differ"
        for name in now
        if then.get(name) != now[name]
    ]


__all__ = ["read_session", "replay"]
