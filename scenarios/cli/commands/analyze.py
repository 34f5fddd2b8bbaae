"""`panda-cosim analyze`."""

from __future__ import annotations

import math
from pathlib import Path
from textwrap import fill
from typing import Any

from ....controller.design import PERIODS, STEP_TIME, Analysis, Variant, analyze
from ....controller.design_plot import plot_analysis
from ....controller.gains import Gains
from ....fmus.atomic import MARK, check_replaceable, replacing
from ....fmus.errors import InputError
from ....fmus.interface.parameters import grouped
from ....fmus.interface.sensors import SENSORS
from ....fmus.interface.tables import INTERFACES
from ...fields import field_names
from ...files import marked_json
from ...run.options import with_options
from ...run.start import start_values
from ...scenario.mismatch import Mismatch, default_of
from ..console import show, show_json, table, tell
from ..options import (
    JSON,
    OVERWRITE,
    SCENARIO_OR_DEFAULT,
    SETTINGS,
    assigned,
    find_scenario,
    option,
)

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
_ALWAYS_LEFT_OUT = "elastic joints, noise, saturation, contact, nonlinearity away from `home`"
NUMBERS_FILE, PLOT_FILE = "analysis.json", "loops.png"
_SCENE = "tabletop"  # of the linear model
_SEEN = ("preset", "seed", "servo_scale", "delay")  # keys of [mismatch] that the analysis takes

Values = dict[str, dict[str, Any]]  # parameters by instance and name


def command(
    scenario: str = SCENARIO_OR_DEFAULT,
    out: Path = option("--out -o DIR", "Folder for the plots and numbers.", Path("runs/analysis")),
    assignments: list[str] | None = SETTINGS,
    json: bool = JSON,
    overwrite: bool = OVERWRITE,
) -> None:
    """Linearise the control loop: margins, bandwidth, Bode plots.

    Uses the gains, servo_scale and delay of the readings that the scenario sets. For the margins of
    a joint, its loop is opened at its servo target, with the other six closed. The disk margin lets
    all seven loops vary at once. Step responses and Bode plots are drawn to loops.png.

    ```
    panda-cosim analyze
    panda-cosim analyze worn_joints --out runs/analysis
    panda-cosim analyze --set mismatch.delay=0.003 --set controller.kp=12
    ```
    """
    chosen = find_scenario(scenario)
    if chosen.is_system or chosen.fmus or chosen.connect:
        raise InputError(
            f"scenario {chosen.name!r}: has FMUs or connections of its own; must have only the "
            "project's plant and controller"
        )
    chosen = with_options(*assigned(chosen, assignments))
    numbers, plot = out / NUMBERS_FILE, out / PLOT_FILE
    check_replaceable(numbers, plot, overwrite=overwrite)
    tell("Linearising plant and controller ...")
    tables = {**INTERFACES, "sensors": SENSORS}
    values: Values = {"sensors": {}}
    for name, flat in start_values(chosen).items():
        values[name] = grouped(tables[name], flat)
    result = _analyzed(values)
    with replacing(numbers) as path:
        path.write_text(marked_json(result.to_json()), encoding="utf-8")
    with replacing(plot) as path:
        plot_analysis(result, path, MARK)
    left_out = _left_out(values)
    if json:
        content = {"scenario": chosen.name, "folder": out, "left_out": left_out}
        show_json({**content, "variants": result.variants})
        return
    for variant in result.variants:
        _show_variant(variant)
    show(fill(f"Not in these margins: {left_out}.", 79) + "\n")
    show(f"{numbers}\n{plot}")


def _analyzed(values: Values) -> Analysis:
    """Analyse the loop of these parameters, first with the controller's own period."""
    gains = dict(values["controller"])
    period = gains.pop("period")
    periods = (period, *(p for p in PERIODS if p != period))
    servo_scale, delay = values["plant"]["servo_scale"], values["sensors"].get("delay")
    return analyze(Gains(**gains), periods, servo_scale, delay)


def _left_out(values: Values) -> str:
    """Name what the linear model leaves out, including parameters of this scenario."""
    now = values["plant"] | values["sensors"]
    names = (name for name in field_names(Mismatch) if name not in _SEEN)
    own = [name for name in names if now.get(name, default_of(name)) != default_of(name)]
    if now["scene"] != _SCENE:
        own.append(f"scene {now['scene']!r} ({_SCENE!r} is taken)")
    return _ALWAYS_LEFT_OUT + (f"; of this scenario: {', '.join(own)}" if own else "")


def _show_variant(variant: Variant) -> None:
    """Show the joints' table and the disk margin of one period and coupling."""
    head = f"period {variant.period * 1e3:g} ms, {variant.coupling}"
    if not variant.stable:
        show(f"{head}: UNSTABLE, a pole of modulus {variant.pole_modulus:.4f}\n")
        return
    rows = [[_cell(key, getattr(loop, key)) for key in _COLUMNS.values()] for loop in variant.loops]
    show(table(tuple(_COLUMNS), rows, right=tuple(_COLUMNS), title=f"{head}: stable"))
    show(
        f"All joints at once: disk margin {variant.disk_margin:.2f}, any gains within "
        f"{variant.disk_gain_db:.1f} dB\nor any phases within {variant.disk_phase_deg:.0f} deg\n"
    )


def _cell(key: str, value: float) -> str:
    if key == "settling_ms" and math.isinf(value):
        return f"> {STEP_TIME * 1e3:g}"
    return f"{value:.4g}"
