"""`panda-cosim regress`."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from itertools import chain
from operator import attrgetter
from pathlib import Path

import typer
from rich.text import Text

from ...fmus.atomic import cache_folder, check_replaceable, replacing, temporary_folder
from ...fmus.errors import CosimError, InputError
from ...fmus.sources.targets import Kind
from ...result.recording import Recording
from ...run.folder import default_folder
from ...study.compare.engines import variants
from ...study.compare.history import read_history, with_history
from ...study.compare.junit import write_junit
from ...study.compare.kept_runs import check_kept_runs, replace_kept_runs
from ...study.compare.outcome import Member, Outcome, exit_code, headline
from ...study.compare.qualify import NO_EFFECT, score, write_findings
from ...study.compare.qualify import qualify as find
from ...study.compare.reference import Reference
from ...study.compare.regress import (
    Suite,
    candidate,
    changes,
    find_scenarios,
    run_suite,
    with_values,
)
from ...study.compare.repeats import rows_of
from ...study.compare.report import write_report
from ...study.compare.wording import multiple
from ...study.sweep.suite import SuiteSweep, find_sweeps, stray_sweeps
from ...study.work import cores
from ...task.scenario import Scenario
from ..common import (
    ENGINES,
    JSON,
    KIND,
    OVERWRITE,
    SETTINGS,
    SSV,
    announce_python,
    end,
    values_of,
)
from ..console import Item, progress, show, show_file, show_result, table, warn
from ..forms import argument, flag, option
from ..outcome import STYLES

REPORT_FILE, JUNIT_FILE = "report.html", "junit.xml"


def command(  # noqa: PLR0913 - one for each option
    scenarios: list[str] | None = argument("[SCENARIO]...", None),
    jobs: int | None = option("--jobs -j", min=1),
    report: Path | None = option("--report DIR"),
    update: bool = flag("--update"),
    assignments: list[str] | None = SETTINGS,
    ssv: Path | None = SSV,
    exact: bool = flag("--exact"),
    folder: Path | None = option("--scenarios DIR"),
    sweeps: bool = option("--sweeps/--no-sweeps", True),
    overwrite: bool = OVERWRITE,
    kind: Kind = KIND,
    mujoco: str = ENGINES,
    yes: bool = flag("--yes -y"),
    qualify: float | None = option("--qualify SHARE", min=1e-6, max=10.0),
    min_score: float = option("--min-score", 0.0, min=0.0, max=1.0),
    noise: bool = flag("--noise"),
    repeat: int = option("--repeat N", 1, min=1, max=1000),
    history: Path | None = option("--history FILE"),
    json: bool = JSON,
) -> None:
    """Run scenarios and compare each with its reference.

    Each scenario runs in a process of its own. Its reference is reference.parquet in its folder;
    the section [regression] of its scenario.toml sets the tolerances. A scenario without a
    reference is judged by its criteria. With `--set`, you see whether a change is detected.

    Exit code 0: every run matches its reference, or without one has the expected verdict. 1: a run
    differs, fails or misses its criteria. 2: bad input, or a scenario has neither reference nor
    criteria.

    A sweep.toml in a scenario's folder is judged by the success rate that it requires.

    With `--kind`, scenarios run with FMUs of that kind, and without sweeps.

    With `--mujoco`, scenarios also run with other versions of MuJoCo, and without sweeps. A table
    says of each whether it is equal to the installed one, differs by rounding, or has changed, from
    which tick on, which unwanted contacts are new or gone, which geoms touch at other ticks, and
    which signal leaves its tube first.

    With `--repeat 3`, each scenario runs three times, and without sweeps. One whose runs differ in
    verdict or recording is flaky, which fails.

    With `--history FILE`, a line of JSON for each case is appended to a file. One whose verdict or
    recording has changed, while neither code nor scenario has, is marked as flaky.

    With `--qualify 0.05`, each parameter of each scenario is changed by 5 %, and a table says what
    notices it first: a signal or a criterion. Parameters that are 0 get a step of their own.
    Changes after which the same bits are recorded do not count. Exit code 3: fewer are noticed than
    `--min-score` asks for.

    ```
    panda-cosim regress
    panda-cosim regress push jacobi --set controller.kp=7.6 --report report
    panda-cosim regress --scenarios my-scenarios --update
    panda-cosim regress push --update --noise
    panda-cosim regress --kind pythonfmu
    panda-cosim regress pick_and_place --qualify 0.05 --min-score 0.8
    panda-cosim regress push --mujoco 3.10.0,3.17.0 --report report
    panda-cosim regress --repeat 3 --history nights.jsonl --report report
    ```

    Args:
        scenarios: Names of shipped scenarios, or folders. Default: all shipped scenarios.
        jobs: Number of runs at a time. Default: one per core.
        report: Write report.html and junit.xml there, and keep the runs that differ.
        update: Record the results as new references. Lists the changes, also in a page, and asks
            first.
        exact: Require the same bits. Use it only on the same machine, with the same versions.
        folder: Folder with scenarios of your own, at any depth, instead of the shipped.
        sweeps: Run the sweeps of the scenarios, too: sweep.toml beside them.
        yes: With --update: do not ask.
        qualify: Change each parameter by a share, one at a time, and say which changes are noticed.
        min_score: With --qualify: the least share of changes to notice.
        noise: With --update: a run with rounded inputs gives the widths of the references' tubes.
        repeat: Number of runs of each scenario, which must not differ.
        history: Append what each case came to, and show it over nights in the report.
    """
    engines = tuple(dict.fromkeys(filter(None, mujoco.split(","))))
    given, values = find_scenarios(scenarios or (), folder), values_of(assignments)
    past = read_history(history)
    groups = [variants(each, engines, repeat, noise=noise) for each in given]
    runs = list(with_values(chain(*groups), values, ssv))
    suite = Suite(runs, exact, jobs or cores(), kind)
    files = [report / name for name in (REPORT_FILE, JUNIT_FILE)] if report else []
    check_replaceable(*files, overwrite=overwrite)
    if qualify is not None:
        return _qualify(suite, qualify, min_score, files, json=json)
    # A reference, for instance, is made of a scenario alone.
    is_whole = sweeps and not any((update, engines, kind != "auto", repeat > 1))
    swept = _swept(given, values or ssv, folder) if is_whole else []
    if report:
        check_kept_runs(report / "runs", (each.name for each in (*runs, *swept)))
    announce_python(kind)
    with ExitStack() as stack:
        place = stack.enter_context(temporary_folder(report or cache_folder()))  # on one disk
        nights = stack.enter_context(replacing(history)) if history else None
        rows = rows_of(groups, _run(suite, place), apart=noise or bool(engines))
        outcomes = [*chain(*rows), *(_sweep(each, place, suite.jobs) for each in swept)]
        if nights:
            outcomes = with_history(outcomes, nights, past, f"{exact} {kind}")
        if report:
            write_report(outcomes, report / REPORT_FILE, values)
            write_junit(outcomes, report / JUNIT_FILE)
            stack.callback(replace_kept_runs, report / "runs", outcomes)  # once references are made
        if update:
            return _update(outcomes, files, yes=yes)
    items = chain(map(str, files), _shown(outcomes), _conditions(outcomes))
    items = chain(items, _of_engines(engines, rows))
    show_result({"scenarios": [*map(_described, outcomes)]}, items, json=json)
    raise typer.Exit(exit_code(outcomes))


def _qualify(
    suite: Suite, share: float, least: float, files: Sequence[Path], *, json: bool
) -> None:
    """Say which changes of parameters a suite notices; exit code 3 if too few."""
    with temporary_folder(cache_folder()) as place, progress("Changing parameters") as advance:
        done = itertools.count(1)
        findings = find(suite, place, share, lambda _, total: advance(next(done), total))
    if all(each.state == NO_EFFECT for each in findings):
        raise InputError(f"--qualify {share:g}: none of {len(findings)} changes has an effect")
    found = score(findings)
    if files:
        write_findings(findings, *files)
    listed = [{**asdict(each), "state": each.state} for each in findings]
    by_state = sorted(findings, key=attrgetter("state"))
    rows = map(attrgetter("key", "change", "state", "where"), by_state)
    items = (table(("Parameter", "change", "state", "by what first, where*"), rows),
             f"{found:.0%} of the changes that have an effect are noticed")  # fmt: skip
    show_result({"score": found, "changes": listed}, items, json=json)
    end(missed=found < least)


def _run(suite: Suite, folder: Path) -> list[Outcome]:
    """Run, with a line per scenario and a progress bar for all."""
    ticks = {each.name: getattr(each, "ticks", 0) for each in suite.scenarios}
    done, total = 0, sum(ticks.values())
    with progress(f"Running {len(ticks)} scenario{'s' if len(ticks) > 1 else ''}") as advance:

        def on_outcome(outcome: Outcome) -> None:
            nonlocal done
            done += ticks[outcome.name]
            advance.say(_line(outcome), STYLES[outcome.meaning.level])
            advance(done, total)

        advance(0, total)
        return run_suite(suite, folder, on_outcome)


def _swept(scenarios: Iterable[Member], changed: object, folder: Path | None) -> list[SuiteSweep]:
    """Return the sweeps of the scenarios, and name those in the folder that are of none."""
    for text in stray_sweeps(folder) if folder is not None else ():
        warn(text)
    swept = find_sweeps(scenarios)
    if swept and changed:
        raise InputError(
            f"--set or --ssv: cannot be combined with {swept[0].file}; add --no-sweeps"
        )
    return swept


def _sweep(swept: SuiteSweep, folder: Path, jobs: int) -> Outcome:
    """Run a sweep of the suite, with a progress bar of its own."""
    with progress(f"Running {swept.file}") as advance:
        outcome = swept.judge(folder / swept.name, jobs, advance)
        advance.say(_line(outcome), STYLES[outcome.meaning.level])
    return outcome


def _line(outcome: Outcome) -> str:
    worst = outcome.worst
    share = f"{multiple(worst.share):>8} x tolerance" if worst else ""
    if outcome.comparison is not None:
        share += f", {outcome.comparison.count}"
        share += ", criteria or parameters differ" if outcome.ok and outcome.cause else ""
    return f"{outcome.name:<22} {outcome.verdict:<12} {outcome.seconds:5.1f} s {share}"


def _described(outcome: Outcome) -> dict[str, object]:
    """Return what `--json` prints for a scenario; `share` is deviation / tolerance, bad above 1."""
    names = ("name", "verdict", "cause", "reason", "seconds", "criteria", "difference", "flaky")
    of_comparison = ("worst", "first", "compared", "constant_fits")
    compared = {name: getattr(outcome.comparison, name, None) for name in of_comparison}
    return {name: getattr(outcome, name) for name in names} | compared


def _shown(outcomes: list[Outcome]) -> Iterator[Item]:
    """Yield what differs, and how many match."""
    wrong = [(o.name, Text(o.verdict, STYLES[o.meaning.level]), o.reason)
             for o in outcomes if not o.ok]  # fmt: skip
    if wrong:
        yield table(("Scenario", "Verdict", "Why*"), wrong)
    yield from (f"{outcome.name}: {outcome.flaky}" for outcome in outcomes if outcome.flaky)
    yield Text(headline(outcomes), "bold red" if exit_code(outcomes) else "bold green")


def _conditions(outcomes: list[Outcome]) -> Iterator[str]:
    """Yield which MuJoCo was compared with which, and what no reference has judged."""
    pairs = [o.comparison.engines for o in outcomes if o.comparison]
    if pairs:
        used, made = (", ".join(sorted(set(each))) for each in zip(*pairs, strict=True))
        yield f"MuJoCo of the runs: {used}; of the references: {made}"
    judged = [o.name for o in outcomes
              if o.verdict in ("holds", "missed") and isinstance(o.scenario, Scenario)]  # fmt: skip
    if judged:
        yield f"Without a reference, judged by their criteria alone: {', '.join(judged)}"


def _of_engines(engines: Sequence[str], rows: list[list[Outcome]]) -> Iterator[Item]:
    """Yield what each MuJoCo changes."""
    if engines:
        cells = ([row[0].name, *map(_of_engine, row)] for row in rows)
        yield table(("Scenario", "own", *engines), cells)


def _of_engine(outcome: Outcome) -> str:
    """Say what a MuJoCo changes, and which signal leaves its tube first."""
    first = outcome.comparison.first if outcome.comparison else None
    left = f"{first.name} leaves its tube at {first.first:.3f} s" if first else ""
    return "; ".join(filter(None, (outcome.verdict, outcome.difference, left, outcome.cause)))


def _update(outcomes: list[Outcome], reports: list[Path], *, yes: bool) -> None:
    """Show what changes, and overwrite the references."""
    for file in reports:
        show(str(file))
    changed, refused = _changed(outcomes)
    replaced = sum(outcome.reference_path.exists() for outcome, _ in changed)
    if replaced and not yes:
        question = f"Overwrite {replaced} of {len(outcomes)} references?"
        _ask(question, [outcome for outcome, _ in changed])
    for outcome, reference in changed:
        reference.write(outcome.reference_path, Recording.open(outcome.run))
        show_file(outcome.reference_path)
    if refused:
        raise typer.Exit(CosimError.exit_code)


def _changed(outcomes: list[Outcome]) -> tuple[list[tuple[Outcome, Reference]], int]:
    """Show what changes; return new references that differ, and how many cannot be one."""
    changed, refused = [], 0
    for outcome in outcomes:
        try:
            reference = candidate(outcome)
        except InputError as error:
            warn(f"{outcome.name}: {error}")
            refused += outcome.verdict != "skipped"
            continue
        lines = changes(outcome, reference)
        for line in lines or ["is unchanged"]:
            show(f"{outcome.name}: {line}", None if lines else "dim")
        if lines:
            changed.append((outcome, reference))
    return changed, refused


def _ask(question: str, changed: list[Outcome]) -> None:
    """Ask whether references are to be overwritten, with a page of what changes; or end."""
    if sys.stdin is None or not sys.stdin.isatty():
        raise InputError(f"--update: {question} Without a terminal, --yes says so")
    page = default_folder("update") / REPORT_FILE
    write_report(changed, page, {})
    show_file(page)  # with the differences from the references, before they are gone
    if not typer.confirm(question):
        raise CosimError("nothing was overwritten")
