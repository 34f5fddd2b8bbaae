"""Runs a session again from its journal, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from ..fmus.errors import located
from ..task.fields import Whole
from ..task.scenario import Scenario
from ..task.typed import typed
from .finished import Run
from .folder import SCENARIO_FOLDER
from .journal import Adjustments, End, Journal
from .options import Options
from .prepare import Prepared
from .session import Session


@typed
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
    session = Session(scenario, out, options)
    _check_actions(journal, session.prepared)  # before anything is run
    with session:
        session.warnings += [
            f"{name}: another FMU than the session's; the values may differ"
            for name, fmu in session.head.fmus.items()
            if journal.head.fmus.get(name) != fmu
        ]
        for action in journal.actions:
            session.step(action.tick - session.tick, progress)
            if isinstance(action.act, End):
                session.warnings += _apart(journal.head.seen, session)
                return session.close(action.act.reason or None)
            session.act(action.act)
        session.step(session.ticks - session.tick, progress)
        return session.close()


def _apart(seen: Mapping[str, float], session: Session) -> list[str]:
    """Say how far from here a page was at its end, whose engine is another one."""
    now, about = session.numbers(), {c.name: c.unit for c in session.prepared.assembly.recorded()}
    apart = [(abs(now[name] - value), about[name], name) for name, value in seen.items()]
    words = "t = {:.3f} s: the page, of another engine, was {:.1e} {} from here in {} at most"
    return [words.format(session.time, *max(apart))] if apart else []


def read_session(place: str | Path, options: Options) -> tuple[Scenario, Options]:
    """Read the scenario of a session, and complete the options of the run."""
    journal = Journal.read(place)
    scenario = Scenario.read(journal.path.parent / SCENARIO_FOLDER)
    scenario = replace(scenario, name=journal.head.scenario)
    return scenario, replace(options, kind=journal.head.kind)


def _check_actions(journal: Journal, prepared: Prepared) -> None:
    """Check that all actions can be taken, one after the other."""
    adjustments, last = Adjustments(prepared), prepared.scenario.ticks
    for number, action in enumerate(journal.actions, start=2):
        with located(f"{journal.path}: line {number}"):
            Whole(0, last).check("tick", action.tick)
            adjustments.take(action)
