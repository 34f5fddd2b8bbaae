"""Commands that prove: `analyze` the control loop, `bench` the speed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..files import replacing
from .console import show, table, tell

if TYPE_CHECKING:
    from rich.table import Table

_COLUMNS = {  # heading: attribute of a loop
    "joint": "joint",
    "gain margin [dB]": "gain_margin_db",
    "phase margin [deg]": "phase_margin_deg",
    "delay margin [ms]": "delay_margin_ms",
    "crossover [Hz]": "crossover_hz",
    "bandwidth [Hz]": "bandwidth_hz",
    "peak of step": "peak_ratio",
    "settling [ms]": "settling_ms",
}


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""
    app.command()(analyze)
    app.command()(bench)


def analyze(
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for the plots and numbers.")
    ] = Path("runs/analysis"),
) -> None:
    """Linearise the control loop: margins, bandwidth, step responses, Bode plots.

    Each joint's loop is broken at its servo target with the others closed.

    ```
    panda-cosim analyze --out runs/analysis
    ```
    """
    tell("Linearising plant and controller ...")
    from ...controller.design import analyze as analyze_loops  # noqa: PLC0415 - after --help
    from ...controller.design_plot import plot_analysis  # noqa: PLC0415

    result = analyze_loops()
    for variant in result.variants:
        show(_loops_table(variant))
        show("")
    with replacing(out / "analysis.json") as path:
        path.write_text(result.to_json() + "\n", encoding="utf-8")
    with replacing(out / "loops.png") as path:
        plot_analysis(result, path)
    show(f"{out / 'analysis.json'}\n{out / 'loops.png'}")


def _loops_table(variant: Any) -> Table:
    """Return a table with one row a joint, for one period and coupling."""
    state = "stable" if variant.stable else "UNSTABLE"
    title = f"period {variant.period * 1e3:g} ms, {variant.coupling}: {state}"
    made = table(tuple(_COLUMNS), right=tuple(_COLUMNS), title=title)
    for loop in variant.loops:
        made.add_row(*(_shown(key, getattr(loop, key)) for key in _COLUMNS.values()))
    return made


def _shown(key: str, value: float) -> str:
    if key == "settling_ms" and math.isinf(value):
        from ...controller.design import STEP_TIME  # noqa: PLC0415 - after --help

        return f"> {STEP_TIME * 1e3:g}"
    return f"{value:.4g}"


def bench(
    json: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Also write the numbers there.")
    ] = None,
) -> None:
    """Measure what a co-simulation step costs, beside the physics and a plain FMPy loop.

    ```
    panda-cosim bench --json bench.json
    ```
    """
    tell("Measuring; leave the machine alone for a minute or two ...")
    from ..benchmark.bench import bench as measure  # noqa: PLC0415 - after --help
    from ..benchmark.bench_table import tables  # noqa: PLC0415

    result = measure()
    show(tables(result))
    if json is not None:
        with replacing(json) as path:
            path.write_text(result.to_json() + "\n", encoding="utf-8")
        show(str(json))
