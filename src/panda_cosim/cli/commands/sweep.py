"""`panda-cosim sweep`, with `report`, `show`, `promote` and `compare`."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, Literal

from rich.text import Text

from ...fmus.atomic import check_replaceable
from ...fmus.errors import CosimError, InputError
from ...result.judging.criterion import line as criterion_line
from ...result.judging.criterion import miss_text
from ...result.judging.verdict import Verdict
from ...result.judging.verdicts import FAILED, MISSED, SUCCESS
from ...run.folder import default_folder, keep_scenario, refuse_existing
from ...run.prepare import prepare
from ...study.compare.reference import REFERENCE_FILE
from ...study.sweep.again import promote_row, show_row
from ...study.sweep.convergence import Convergence, convergence
from ...study.sweep.definition import SAMPLED, Distribution, Sweep, load_sweep, sweep_of
from ...study.sweep.fit import fit
from ...study.sweep.paired import Paired, pair
from ...study.sweep.report import REPORT_FILE, write_report
from ...study.sweep.results import missing, share_bounds
from ...study.sweep.row import STATUSES, UNJUDGED, Row
from ...study.sweep.store import Store
from ...study.sweep.sweeping import SweepResult, check_sweep
from ...study.sweep.sweeping import sweep as run_sweep
from ...task.files import as_argument
from ..common import (
    ENGINES,
    JSON,
    MAP,
    OPEN_PAGE,
    OVERWRITE,
    ROW,
    SWEEP,
    announce_build,
    end,
)
from ..console import Item, progress, show, show_file, show_result, table, tell, warn
from ..forms import argument, option
from ..outcome import write_case

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rich.table import Table

FLIPS = 10  # flipped rows that are shown, of each kind


def command(  # noqa: PLR0913 - one for each option
    sweep: str = argument("SWEEP.toml"),
    out: Path | None = option("--out -o DIR"),
    vary: list[str] | None = option("--vary KEY=LOW:HIGH:STEPS"),
    jobs: int | None = option("--jobs -j N", min=1),
    dask: str | None = option("--dask ADDRESS"),
    time_limit: float | None = option("--time-limit SECONDS"),
    min_success: float | None = option("--min-success SHARE"),
    confidence: float | None = option("--confidence LEVEL"),
    mujoco: str = ENGINES,
    junit: Path | None = option("--junit FILE"),
    log: Path | None = option("--fit LOG"),
    names: Path | None = MAP,
    json: bool = JSON,
) -> None:
    """Run a scenario many times with varied values, on all cores or a cluster.

    The results are a table, DIR/results/part-*.parquet, with one row per run; the row of a failed
    run holds the reason. The same command, with `--out DIR`, resumes a stopped sweep, unless the
    definition, the FMUs, the code or versions have changed. Further commands: `sweep report DIR`
    writes a page about the results, `sweep show DIR ROW` shows a row's run in 3D beside the
    unchanged scenario, and `sweep promote DIR ROW NEW` makes a scenario of a row.

    With `--fit`, each value is told with its interval of 95 %, with the RMS that is left in each
    signal, and which values the log does not tell apart; the fitted scenario is written.

    ```
    panda-cosim sweep random_box --out box
    panda-cosim sweep pick_and_place --vary plant.block_mass=0.05:2:100
    panda-cosim sweep report box
    panda-cosim sweep random_box --min-success 0.99 --confidence 0.95
    panda-cosim sweep push --vary plant.payload=0:1:2 --fit robot.csv --map names.toml
    ```

    Args:
        sweep: A sweep's TOML file, or the name of a shipped one: anywhere, behind_wall, calibrated,
            iso9283 or random_box. With --vary, a scenario.
        out: Folder for the results; a stopped sweep in it is resumed. Default: a new one in runs/.
        vary: Vary a key of `run --set` on a grid; also KEY=V1,V2. May be repeated.
        jobs: Number of processes. Default: one per core.
        dask: Run on this Dask cluster, such as tcp://host:8786, or on one that is started on this
            machine: local.
        time_limit: Wall time after which a run is stopped.
        min_success: Required success rate, such as 0.95: the share of successes in all rows or,
            with --confidence, its lower bound. Exit code 3 if it is missed. In the file:
            min_success.
        confidence: With --min-success, compare the one-sided lower bound by Clopper and Pearson at
            this confidence, such as 0.95. For random rows. In the file: confidence.
        junit: With --min-success, write the verdict as JUnit XML, for CI.
        log: Run no sweep, but find the values within the ranges that bring a run closest to a log:
            .csv, .parquet or .mcap. With --out, the fitted scenario's folder.
    """
    definition = _definition(sweep, vary, mujoco, min_success=min_success, confidence=confidence)
    if jobs is not None and dask not in (None, "local"):
        cannot = "cannot be combined with --dask ADDRESS, since the cluster has its own workers"
        raise InputError(f"--jobs: {cannot}")
    if junit is not None and not definition.min_success:
        raise InputError("--junit: needs --min-success, without which there is no verdict")
    if log is not None:
        _fit(definition, log, names, out, json=json)
        return
    check_replaceable(junit)
    check_sweep(definition, out)  # before anything is built
    announce_build()
    folder = out or default_folder("sweep")
    began = time.perf_counter()

    def write_verdict(verdict: Verdict, detail: str) -> None:
        write_case(junit, "sweep", Path(sweep).stem, time.perf_counter() - began, verdict, detail)

    try:
        with progress("Running the sweep") as update:
            done = run_sweep(
                definition, folder, jobs=jobs, dask=dask, time_limit=time_limit, remark=warn,
                progress=update,
            )  # fmt: skip
    except BaseException as error:  # also Ctrl-C and SIGTERM
        _tell_stopped(error, folder, "" if out else f" with --out {quote(str(folder))}")
        if isinstance(error, CosimError):
            write_verdict(FAILED, str(error))
        raise
    orders = [*convergence(Store(done.folder))]
    content = {"folder": done.folder, "counts": done.counts, "min_success": done.gate,
               "convergence": orders}  # fmt: skip
    show_result(content, _counted(done, definition, orders), json=json)
    if done.gate is not None:
        write_verdict(SUCCESS if done.gate.ok else MISSED, miss_text(done.gate))
        end(missed=not done.gate.ok)


def _fit(definition: Sweep, log: Path, names: Path | None, out: Path | None, *, json: bool) -> None:
    """Fit a scenario to a log, write it and tell what was found."""
    folder = out or Path(f"{Path(definition.scenario[0]).name}_fitted")
    refuse_existing(folder)
    announce_build()
    tell(f"Fitting {', '.join(definition.vary)} ...")
    found = fit(definition, log, names)
    prepared = prepare(found.scenario)
    keep_scenario(prepared.scenario, prepared.assembly, folder)
    for text in found.alike:
        warn(text)
    rows = [(key, f"{it.value:.6g}", f"{it.low:.6g} to {it.high:.6g}")
            for key, it in found.estimates.items()]  # fmt: skip
    left = [(name, f"{rms:.3g}") for name, rms in found.noise.items()]
    items = (table(("key*", "fitted", "95 %"), rows, right=("fitted", "95 %")),
             table(("signal*", "RMS left"), left, right=("RMS left",)),
             f"{folder}\nNext: panda-cosim run {as_argument(folder)}")  # fmt: skip
    parts = ("estimates", "alike", "noise")
    content = {"folder": folder, **{name: getattr(found, name) for name in parts}}
    show_result(content, items, json=json)


def _definition(sweep: str, vary: list[str] | None, mujoco: str, **asked: float | None) -> Sweep:
    """Return what is to be run: a file or `--vary`, with what other options change in it."""
    definition = sweep_of(sweep, vary) if vary else load_sweep(sweep)
    engines = {"mujoco": Distribution("values", values=tuple(mujoco.split(",")))} if mujoco else {}
    given: Any = {name: value for name, value in asked.items() if value is not None}
    return replace(definition, vary={**definition.vary, **engines}, **given)


def _tell_stopped(error: BaseException, folder: Path, more: str) -> None:
    if Store(folder).parts() and not isinstance(error, InputError):
        tell(f"Stopped; the rows so far are kept. The same command{more} resumes it.")


def _counted(done: SweepResult, definition: Sweep, orders: Sequence[Convergence]) -> Iterator[Item]:
    total, good = sum(done.counts.values()), done.counts.get("success", 0)
    counts = [(status, done.counts[status]) for status in STATUSES if done.counts.get(status)]
    rows = [(status, number, f"{number / total:.1%}") for status, number in counts]
    yield table(("status", "rows", "share"), rows, right=("rows", "share"))
    yield from _rates(done, definition, total, good)
    if orders:
        yield _convergence_table(orders)
    if done.gate is not None:
        yield Text(criterion_line(done.gate), "bold green" if done.gate.ok else "bold red")
    yield f"{done.folder}/results/  {total} rows"
    yield Text(f"Next: panda-cosim sweep report {quote(str(done.folder))}", "dim")


def _rates(done: SweepResult, definition: Sweep, total: int, good: int) -> Iterator[str]:
    """Yield what the counts of rows, and of successes, mean."""
    if unjudged := sum(done.counts.get(status, 0) for status in UNJUDGED):
        yield f"{unjudged} of {total} rows did not finish or were not judged, and count as failures"
    if definition.design in SAMPLED:
        low, high = share_bounds(good, total)
        yield f"success rate: {low:.2%} to {high:.2%} (95 %, Clopper-Pearson)"
    if good and (beyond := Store(done.folder).beyond_limits()) is not None:
        yield f"{beyond} of the {good} successes exceeded a limit of the robot"


def _convergence_table(found: Sequence[Convergence]) -> Table:
    """Return a table with the order of convergence of each criterion's margin."""
    columns = ("margin", "smallest step", "order", "step 0")
    rows = (
        (it.criterion, *("-" if n is None else f"{n:.6g}" for n in (it.finest, it.order, it.limit)))
        for it in found
    )
    return table(columns, rows, right=columns[1:])


def report(
    folder: Path = SWEEP,
    out: Path | None = option("--out -o FILE.html"),
    open_page: bool = OPEN_PAGE,
    overwrite: bool = OVERWRITE,
) -> None:
    """Write an HTML page about the results of a sweep. The sweep may still be running.

    It shows the success rate with its confidence bounds, margins by value, sensitivity, where runs
    fail, and the worst rows with the commands that repeat them.

    Args:
        out: Page to write. Default: in DIR.
    """
    check_replaceable(out if out is not None else folder / REPORT_FILE, overwrite=overwrite)
    _warn_if_changed(folder)
    path = write_report(folder, out)
    if lacking := missing(Store(folder)):
        warn(lacking)
    show_file(path, open_page=open_page)


def show_one(folder: Path = SWEEP, index: int = ROW, open_page: bool = OPEN_PAGE) -> None:
    """Run one row, and show it in 3D beside the unchanged scenario."""
    _warn_if_changed(folder)
    show_file(show_row(folder, index), open_page=open_page)


def promote(
    folder: Path = SWEEP,
    index: int = ROW,
    new: Path = argument("NEW"),
    expect: Literal["failure"] | None = option("--expect failure"),
) -> None:
    """Make a scenario of one row, for `panda-cosim regress`.

    A row with success gets a reference. A row without is a red test: `regress` fails until its
    criteria hold. With `--expect failure` it is a known limit, and `regress` passes while it fails.

    ```
    panda-cosim sweep promote box 17 my-scenarios/too-heavy --expect failure
    ```

    Args:
        new: Folder to create.
        expect: The row misses a criterion, and that is a known limit: the scenario expects it.
            Default: what the swept scenario expects.
    """
    _warn_if_changed(folder)
    paths = promote_row(folder, index, new, known_limit=expect is not None)
    for path in paths:
        show(str(path))
    if expect is not None:
        show("A known limit: regress passes as long as it fails as in the reference.")
    elif any(path.name == REFERENCE_FILE for path in paths):
        show("A regression test: regress passes as long as it is as in the reference.")
    else:
        show("A red test: regress fails until the criteria have the expected verdict.")


def _warn_if_changed(folder: Path) -> None:
    for remark in Store(folder).changed_scenarios():
        warn(remark)


def compare(
    first: Path = argument("A"),
    second: Path = argument("B"),
    not_worse: float | None = option("--not-worse SHARE", min=0.0, max=1.0),
    json: bool = JSON,
) -> None:
    """Compare two sweeps pair by pair: a law, a gain or a version against another.

    Rows are paired by the values that vary; what is constant within each sweep is the treatment.
    Flipped rows come with the commands that repeat them. Whether success changes is judged by
    McNemar's exact test; intervals are of 95 %, by bootstrap over the pairs.

    Exit code 3: the whole interval of the change of success is below 0 or, with `--not-worse 0.02`,
    its lower end is below -0.02.

    ```
    panda-cosim sweep compare runs/before runs/after --not-worse 0.02
    ```

    Args:
        first: Folder of the sweep before.
        second: Folder of the sweep after: of the same values.
        not_worse: By how much the success rate may sink. Default: it must not surely sink.
    """
    found = pair(first, second)
    show_result(_described(found), _paired(found), json=json)
    end(missed=found.is_worse(not_worse))


def _described(found: Paired) -> dict[str, object]:
    flips = {
        name: [(a["index"], b["index"]) for a, b in found.flipped(lost=lost)]
        for name, lost in (("lost", True), ("gained", False))
    }
    names = ("keys", "treatment", "unpaired", "rates", "success", "p_value", "margins")
    return {"pairs": len(found.pairs), **{n: getattr(found, n) for n in names}, **flips}


def _paired(found: Paired) -> Iterator[Item]:
    """Yield the treatment, the rates, the margins and the flipped rows."""
    yield from (f"treatment: {line}" for line in found.treatment)
    (before, after), change = found.rates, found.success
    yield (
        f"{len(found.pairs)} pairs: success {before:.1%} -> {after:.1%}, {change.mean:+.1%} "
        f"({change.low:+.1%} to {change.high:+.1%}), McNemar's p = {found.p_value:.3g}"
    )
    if change.low == change.high == 0.0:  # resamples of zeros are zeros, however few
        yield f"no pair flips; up to {found.unseen:.1%} of flips either way remain possible"
    if any(found.unpaired):
        yield "{} and {} rows have no partner".format(*found.unpaired)
    rows = [(name or "smallest", f"{it.mean:+.3g}", f"{it.low:+.3g} to {it.high:+.3g}")
            for name, it in found.margins.items()]  # fmt: skip
    yield table(("margin*", "change", "95 %"), rows)
    yield from _flips("lost", found.flipped(lost=True), 1)
    yield from _flips("gained", found.flipped(lost=False), 0)


def _flips(word: str, pairs: Sequence[tuple[Row, Row]], bad: int) -> Iterator[str]:
    """Yield a line for each of some pairs, of which one row, the first or second, is no success."""
    for row, other in pairs[:FLIPS]:
        failed = (row, other)[bad]
        why = failed["missed"] or failed["error"] or failed["status"]
        yield f"{word}: rows {row['index']}, {other['index']}: {why}: {other['command']}"
