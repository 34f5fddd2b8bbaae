"""Runs a session again from its journal, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..definition.scenario import Scenario
from .folders import SCENARIO_FOLDER
from .journal import END, Journal
from .journal_check import check_actions
from .options import Options
from .result import Run
from .session import Session


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
    """Read the scenario of a session, and complete the options of the run.

    Args:
        place: The session's journal or folder.
        options: How to run it; the journal sets the kind of FMUs.

    Raises:
        InputError: The journal or the scenario is missing or cannot be used.
    """
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


__all__ = ["read_session", "replay"]
