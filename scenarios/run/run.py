"""Runs a scenario: a session to its end."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from ..scenario.scenario import Scenario, load_scenario
from .options import Options
from .prepare import Prepared, prepare
from .result import Run
from .session import Session
from .stopping import stopping_on_signals


def run_scenario(
    scenario: Scenario | str | Path,
    out: Path | str | None = None,
    options: Options | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    stop: threading.Event | None = None,
) -> Run:
    """Run a scenario and keep the results in a folder.

    Args:
        scenario: A scenario, a shipped one's name, or a folder.
        out: New folder for the run; None: one named by scenario and time, in `runs`.
        options: How to run it.
        progress: Called with the completed and the total steps, a few times a second.
        stop: Set in another thread, it stops the run after the step under way.

    Returns:
        The run.

    Raises:
        InputError: Something given cannot be used; nothing is written then.
        SimulationError: An FMU failed; what was recorded is kept, marked incomplete.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    return run_prepared(prepare(scenario, options), out, progress=progress, stop=stop)


def run_prepared(
    prepared: Prepared,
    out: Path | str | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    stop: threading.Event | None = None,
) -> Run:
    """Run what `prepare` has returned, see `run_scenario`."""
    with stopping_on_signals(stop) as request, Session.of(prepared, out) as session:
        session.advance(session.ticks, request, progress)
        return session.close(request.text, number=request.signal)
