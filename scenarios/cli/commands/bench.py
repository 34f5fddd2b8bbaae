"""`panda-cosim bench`."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from pathlib import Path

import typer
from rich.table import Table

from ....fmus.atomic import check_replaceable, replacing
from ....fmus.errors import InputError
from ....fmus.sources.targets import Kind
from ...benchmark import FIGURES, LABELS, RATIOS, BenchResult, Line, append, bench, compared, read
from ...files import marked_json
from ...pictures.plot import plot_history
from ..console import show, table, tell
from ..options import KIND, OVERWRITE, option

WORSE = 3  # exit code
GROWTH = Path(__file__).parents[3] / ".ci" / "growth.py"


def command(
    kind: Kind = KIND,
    all_: bool = option(
        "--all", "Measure sweeps, large systems and long runs, too; in a checkout.", False
    ),
    json: Path | None = option("--json FILE", "Also write the numbers to this file."),
    history: Path | None = option(
        "--history FILE",
        "Append the ratios to this file, plot it, and compare them with its last ten.",
    ),
    overwrite: bool = OVERWRITE,
) -> None:
    """Measure what a co-simulation step costs.

    Compares our master's step with MuJoCo alone, stepping the scene as it is drawn and the model
    that the FMU steps, and with a plain FMPy loop over the same FMUs. Takes a minute or two; with
    --all, half an hour and 10 GB in the temporary folder.

    With --history, a ratio that is more than 5 % worse than the median of the last ten runs on this
    machine ends the command with exit code 3.

    ```
    panda-cosim bench
    panda-cosim bench --kind python --json bench.json
    panda-cosim bench --history bench.jsonl
    ```
    """
    plot = history and history.with_name(f"{history.name}.png")
    check_replaceable(*filter(None, (json, plot)), overwrite=overwrite)
    if history is not None:
        read(history)  # refuses another file
    if all_ and not GROWTH.is_file():
        raise InputError(f"--all: {GROWTH} is missing; must be run in a checkout of the project")
    measure = runpy.run_path(str(GROWTH))["figures"] if all_ else None
    tell("Measuring; do not use the machine meanwhile ...")
    result = bench(kind=kind, measure=measure)
    for item in tables(result):
        show(item)
    if json is not None:
        with replacing(json) as path:
            path.write_text(marked_json(result.to_json()), encoding="utf-8")
        show(str(json))
    if history is not None and plot is not None:
        lines = append(history, result, kind)
        show(str(plot_history(lines, plot)))
        show_changes(lines)


def show_changes(lines: list[Line]) -> None:
    """Show the newest ratios beside those before, and exit if one is worse."""
    columns = ("now", "median before")
    rows = [
        (name, f"{now:.2f}", f"{before:.2f}", "[bold red]worse" if worse else "ok")
        if before is not None
        else (name, f"{now:.2f}", "too few runs", "not compared")
        for name, (now, before, worse) in compared(lines).items()
    ]
    show(table(("ratio*", *columns, ""), rows, right=columns))
    if any(worse for _, _, worse in compared(lines).values()):
        raise typer.Exit(WORSE)


def tables(result: BenchResult) -> Iterator[Table | str]:
    """Yield what is shown of a result."""
    columns = ("median", "quartiles")
    steps = [(LABELS[way], *cost.texts(1)) for way, cost in result.steps.items()]
    title = f"Cost of a step of {result.scenario} \\[us]"
    yield table(("way*", *columns), steps, right=columns, title=title)
    yield f"(c) runs at {result.real_time_factor:.1f} times real time\n"
    ratios = [(name, *r.texts(2), RATIOS[name][2]) for name, r in result.ratios.items()]
    yield table(
        ("ratio", *columns, "goal*"), ratios, right=columns, title="Ratios, measured in turns"
    )
    commands = [(what, f"{seconds:.2f} s") for what, seconds in result.start_up.items()]
    yield table(("command*", "best of 3"), commands, right=("best of 3",), title="Whole commands")
    if result.figures:
        rows = [(FIGURES[n][0], f"{v:.4g}", FIGURES[n][1]) for n, v in result.figures.items()]
        yield table(("figure*", "measured", "goal*"), rows, right=("measured",), title="Growth")
    yield ", ".join(f"{key} {value}" for key, value in result.machine.items())
