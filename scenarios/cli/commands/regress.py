"""`panda-cosim regress`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from ....fmus.errors import InputError
from ....fmus.packaging.build import cache_folder
from ....fmus.packaging.scratch import scratch_folder
from ...pictures.gl import RenderError
from ...recording import Recording
from ...regression.junit import write_junit
from ...regression.kept_runs import KeptRuns
from ...regression.regress import Outcome, Suite, exit_code, find_scenarios, run_suite
from ...regression.report import write_report
from ...regression.update import candidate, changes
from ..console import progress, show, table, warn
from ..drawing import draw_sheet
from ..options import Assignments, overrides

STYLES = {"same": "green", "differs": "bold red", "failed": "bold red", "no reference": "yellow"}


def command(  # noqa: PLR0913 - one for each option
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENARIO]...",
            help="Names of shipped scenarios, or folders; none: all of them.",
            show_default=False,
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", min=1, help="Runs at the same time; by default one a core."),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="DIR",
            help="Write report.html and junit.xml there, and keep the runs that are not the same.",
        ),
    ] = None,
    update: Annotated[
        bool,
        typer.Option("--update", help="Make what came out the new references; says what changes."),
    ] = False,
    assignments: Assignments = None,
    exact: Annotated[
        bool, typer.Option("--exact", help="Ask for the same bits: same machine, same versions.")
    ] = False,
    folder: Annotated[
        Path | None,
        typer.Option("--scenarios", metavar="DIR", help="A folder of scenarios of your own."),
    ] = None,
    pictures: Annotated[
        bool, typer.Option("--pictures", help="Draw contact sheets for the report, too.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Overwrite without asking.")] = False,
) -> None:
    """Run scenarios and compare each with its reference.

    Each run has a process of its own. A reference is `reference.parquet` beside the scenario; how
    near a run must be to it stands in the scenario's section [regression]. `--set` asks whether a
    change would be noticed. Exit codes: 0 all as before, 1 a difference, 2 bad input.

    ```
    panda-cosim regress
    panda-cosim regress push jacobi --set controller.kp=7.6 --report report
    panda-cosim regress --scenarios my-scenarios --update
    ```
    """
    if update and (assignments or exact):
        raise InputError(
            "--update: makes references of the scenarios as they are; must stand alone"
        )
    chosen = find_scenarios(scenarios or (), folder)
    suite = Suite(chosen, overrides(assignments), exact, jobs or _cores())
    if report is not None:
        KeptRuns(report / "runs").check(scenario.name for scenario in chosen)
    with _run_folder(report) as runs:
        outcomes = _run(suite, runs)
        if report is not None:
            if pictures:
                _draw_sheets(outcomes)
            _write_report(suite, outcomes, report)
        try:
            if update:
                return _update(outcomes, yes=yes)
        finally:
            if report is not None:
                KeptRuns(report / "runs").replace(o.run for o in outcomes if not o.ok)
    _show_result(outcomes)
    raise typer.Exit(exit_code(outcomes))


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _run_folder(report: Path | None) -> Iterator[Path]:
    """Give a folder for the runs that is gone afterwards: beside the report's, to move them there.

    What a killed process left there is removed.

    Raises:
        InputError: The folder cannot be written to.
    """
    parent = report or cache_folder()
    with ExitStack() as stack:
        try:
            folder = stack.enter_context(scratch_folder(parent, ".regress-"))
        except OSError as error:
            raise InputError(f"{parent}: cannot be written to: {error.strerror}") from error
        yield folder


def _run(suite: Suite, folder: Path) -> list[Outcome]:
    """Run with a line for each scenario that is done, and a bar for all."""
    ticks = {s.name: s.ticks for s in suite.scenarios}
    done, total = 0, sum(ticks.values())
    with progress(f"Running {len(ticks)} scenario{'s' if len(ticks) > 1 else ''}") as advance:

        def on_outcome(outcome: Outcome) -> None:
            nonlocal done
            done += ticks[outcome.scenario.name]
            advance.say(_line(outcome), STYLES[outcome.verdict])
            advance(done, total)

        advance(0, total)
        return run_suite(suite, folder, on_outcome)


def _line(outcome: Outcome) -> str:
    worst = outcome.comparison.worst if outcome.comparison else None
    share = f"{worst.share:8.2g} of tolerance" if worst else ""
    return f"{outcome.scenario.name:<22} {outcome.verdict:<12} {outcome.seconds:5.1f} s {share}"


def _show_result(outcomes: list[Outcome]) -> None:
    """Print the verdicts, and what is wrong."""
    wrong = [outcome for outcome in outcomes if not outcome.ok]
    if wrong:
        verdicts = table(("Scenario", "Verdict", "Why*"))
        for outcome in wrong:
            style = STYLES[outcome.verdict]
            verdicts.add_row(
                outcome.scenario.name, f"[{style}]{outcome.verdict}", escape(outcome.reason)
            )
        show(verdicts)
    count = len(outcomes) - len(wrong)
    style = "bold red" if wrong else "bold green"
    show(f"{count} of {len(outcomes)} scenarios as their references", style)


def _draw_sheets(outcomes: list[Outcome]) -> None:
    """Draw what the report then holds; where nothing can be drawn, it goes without."""
    try:
        for outcome in outcomes:
            if outcome.verdict != "failed":
                draw_sheet(Recording.open(outcome.run), outcome.run)
    except RenderError as error:
        warn(str(error))


def _write_report(suite: Suite, outcomes: list[Outcome], folder: Path) -> None:
    write_report(outcomes, folder / "report.html", suite.overrides)
    write_junit(outcomes, folder / "junit.xml")
    show(f"{folder / 'report.html'}\n{folder / 'junit.xml'}")


def _update(outcomes: list[Outcome], *, yes: bool) -> None:
    """Say what changes, and overwrite the references."""
    new = []
    for outcome in outcomes:
        reference = candidate(outcome)
        lines = changes(outcome, reference)
        for line in lines or ["is unchanged"]:
            show(f"{outcome.scenario.name}: {line}", None if lines else "dim")
        if lines:
            new.append((outcome.reference_path, reference))
    replaced = sum(path.exists() for path, _ in new)
    if replaced and not yes:
        _confirm(f"Overwrite {replaced} of {len(outcomes)} references?")
    for path, reference in new:
        reference.write(path)
        show(f"{path}  {path.stat().st_size / 1e3:.0f} kB")


def _confirm(question: str) -> None:
    """Ask, and end the command if the answer is no.

    Raises:
        InputError: There is nobody to ask.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        raise InputError(
            f"--update: nothing was overwritten: {question} must be answered with --yes, as "
            "standard input is not a terminal"
        )
    if not typer.confirm(question):
        warn("nothing was overwritten")
        raise typer.Exit(1)
