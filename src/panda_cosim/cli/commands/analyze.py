"""`panda-cosim analyze`."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from textwrap import fill
from threading import Thread

import numpy as np
from pydantic_core import to_json

from ...fmus.atomic import MARK, check_replaceable, replacing, write_whole
from ...fmus.master.step import SWITCHED
from ...study.analysis.margins import Analysis, Margins, analyze
from ...study.analysis.plot import plot_analysis
from ...task.files import marked_json
from ...task.scenario import Scenario
from ...task.values import Values
from ..console import show, show_json, table, tell, warn
from ..forms import option
from ..options import (
    CONTROLLER,
    JSON,
    OVERWRITE,
    PLANT,
    SCENARIO_OR_DEFAULT,
    SETTINGS,
    find_scenario,
    values_of,
)

PERIODS = (0.001, 0.002, 0.005, 0.010)  # [s] of our own controller
_TABLE = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
_COLUMNS: Mapping[str, str] = tomllib.loads(_TABLE)["columns"]
LEFT_OUT = "larger signals, at which limits are met or contacts change; noise; other poses"
NUMBERS_FILE, PLOT_FILE, MODEL_FILE = "analysis.json", "loops.png", "analysis.npz"


def command(  # noqa: PLR0913 - one for each option
    scenario: str = SCENARIO_OR_DEFAULT,
    at: str = option("--at TIME", "start"),
    loop: str = option("--loop INPUT", ""),
    out: Path = option("--out -o DIR", Path("runs/analysis")),
    assignments: list[str] | None = SETTINGS,
    controller: str | None = CONTROLLER,
    plant: str | None = PLANT,
    json: bool = JSON,
    overwrite: bool = OVERWRITE,
) -> None:
    """Measure the control loops: margins, Bode plots, a state-space model.

    Takes any scenario whose FMUs can save and restore their state (canGetAndSetFMUState). Small
    pulses are added to each servo target, or torque, at one instant of the run, which continues.
    First come the delay and the gain that all loops bear alike, then the disk margin, by which each
    may vary in its own way, at the same time; then those of each joint, while the others stay as
    they are. The folder gets loops.png, analysis.json, and the model in analysis.npz.

    ```
    panda-cosim analyze
    panda-cosim analyze payload --at grasp --out runs/analysis
    panda-cosim analyze --set mismatch.delay=0.003 --set controller.kp=12
    panda-cosim analyze --controller my_law.py:MyLaw --set scene=motors --at 2.3
    ```

    Args:
        at: Instant of the run: seconds, or an event, as grasp or 'release + 0.5'.
        loop: Input at which the loops are opened. Default: those of the plant that an FMU feeds.
        out: Folder for the results.
    """
    chosen = find_scenario(scenario).changed(values_of(assignments, controller, plant))
    files = [out / name for name in (NUMBERS_FILE, PLOT_FILE, MODEL_FILE)]
    check_replaceable(*files, overwrite=overwrite)
    tell("Measuring the loops ...")
    Thread(target=import_module, args=("control",), daemon=True).start()  # 1 s, while FMUs step
    first = analyze(chosen, at, loop=loop)
    variants = [first.margins]
    for values in _variants(chosen, first):
        variants.append(analyze(chosen.changed(values), first.at, loop=loop).margins)
    model = {n: np.asarray(value).tolist() for n, value in first.matrices.items()}
    content = {
        "scenario": first.scenario, "folder": out, "at": first.at, "left_out": LEFT_OUT,
        "remarks": first.remarks, "variants": variants, "model": model,
    }  # fmt: skip
    write_whole(files[0], marked_json(to_json(content, inf_nan_mode="null").decode()))
    with replacing(files[1]) as path:
        plot_analysis(first, variants, path, MARK)
    with replacing(files[2]) as path:
        np.savez(path, note=np.bytes_(MARK), allow_pickle=False, **first.matrices)
    if json:
        show_json(content)
        return
    show(f"{first.scenario} at t = {first.at:g} s; loops opened at")
    show(fill(", ".join(first.inputs), 79) + "\n")
    for variant in variants:
        _show_variant(variant)
    for remark in first.remarks:
        warn(remark)
    show(fill(f"Not in these margins: {LEFT_OUT}.", 79) + "\n")
    show("\n".join(map(str, files)))


def _variants(scenario: Scenario, first: Analysis) -> Iterator[Values]:
    """Yield values for other periods of our own controller, and for the other coupling."""
    if not scenario.is_system and "controller" not in scenario.fmus:
        for period in PERIODS:
            if not math.isclose(period, first.period):
                yield {"controller.period": period}
    yield from ({"coupling": each} for each in SWITCHED if each != first.margins.coupling)


def _show_variant(margins: Margins) -> None:
    """Show what one period and coupling bears: all loops alike, each in its own way, one alone."""
    head = f"period {margins.period * 1e3:g} ms, {margins.coupling}"
    if margins.reason:
        show(fill(f"{head}: {margins.reason}", 79) + "\n")
        return
    show(f"{head}: stable")
    gains = f"{_cell(margins.gain_up_db)} dB up, {_cell(margins.gain_down_db)} dB down"
    show(f"Delay margin, common to all loops: {margins.delay_margin_ms:.2f} ms")
    show(f"Gain margin, common to all loops: {gains}")
    gain, phase = f"{margins.disk_gain_db:.1f} dB", f"{margins.disk_phase_deg:.0f} deg"
    disk = f"disk margin {margins.disk_margin:.2f}"
    show(f"Each in its own way, at once: {disk}, any gains within {gain}")
    show(f"or any phases within {phase}\n")
    rows = [[_cell(getattr(loop, key)) for key in _COLUMNS.values()] for loop in margins.loops]
    title = "One loop, while the others stay as they are"
    show(table(tuple(_COLUMNS), rows, right=tuple(_COLUMNS), title=title))
    show("")


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
