"""`panda-cosim analyze`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from ....controller.design import STEP_TIME, analyze
from ....controller.design_plot import plot_analysis
from ...files import replacing
from ..console import show, show_json, table, tell
from ..options import Json

_COLUMNS = {  # heading and unit: attribute of a loop
    "joint": "joint",
    "gain\nmargin\n[dB]": "gain_margin_db",
    "phase\nmargin\n[deg]": "phase_margin_deg",
    "delay\nmargin\n[ms]": "delay_margin_ms",
    "crossover\n[Hz]": "crossover_hz",
    "bandwidth\n[Hz]": "bandwidth_hz",
    "step\npeak": "peak_ratio",
    "settling\n[ms]": "settling_ms",
}


def command(
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for the plots and numbers.")
    ] = Path("runs/analysis"),
    json: Json = False,
) -> None:
    """Linearise the control loop: margins, bandwidth, Bode plots.

    Each joint's loop is opened at its servo target, with the other six loops closed. Step
    responses and Bode plots are drawn to loops.png.

    ```
    panda-cosim analyze
    panda-cosim analyze --out runs/analysis
    ```
    """
    tell("Linearising plant and controller ...")
    result = analyze()
    with replacing(out / "analysis.json") as path:
        path.write_text(result.to_json() + "\n", encoding="utf-8")
    with replacing(out / "loops.png") as path:
        plot_analysis(result, path)
    if json:
        show_json({"folder": out, "variants": result.variants})
        return
    for variant in result.variants:
        show(_loops_table(variant))
        show("")
    show(f"{out / 'analysis.json'}\n{out / 'loops.png'}")


def _loops_table(variant: Any) -> Table:
    """Return a table with one row per joint, for one period and coupling."""
    state = "stable" if variant.stable else "UNSTABLE"
    title = f"period {variant.period * 1e3:g} ms, {variant.coupling}: {state}"
    made = table(tuple(_COLUMNS), right=tuple(_COLUMNS), title=title)
    for loop in variant.loops:
        made.add_row(*(_cell(key, getattr(loop, key)) for key in _COLUMNS.values()))
    return made


def _cell(key: str, value: float) -> str:
    if key == "settling_ms" and math.isinf(value):
        return f"> {STEP_TIME * 1e3:g}"
    return f"{value:.4g}"
