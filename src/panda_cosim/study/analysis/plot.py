"""The picture of an analysis: open loops, step responses, margins."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from ...show.pictures.panels import COLOURS, DPI, GREY
from ...show.pictures.plot import own_style
from .margins import Analysis, Margins, frequencies, steps

WANTED_PHASE_DEG, WANTED_DELAY_MS = 45.0, 3.0
GAINS: Final = ("kp", "ki", "kd", "ik_gain")  # of our own law
SHOWN: Final = 5  # parameters of another


def plot_analysis(
    analysis: Analysis, variants: Sequence[Margins], path: Path, comment: str = ""
) -> None:
    """Draw an analysis, and the margins of its variants, as a PNG file that carries a comment."""
    with own_style():
        from matplotlib.figure import Figure  # noqa: PLC0415 - after its defaults are set

        figure = Figure(figsize=(13, 8.6), facecolor="white")
        axes = figure.subplots(2, 2)
        figure.subplots_adjust(left=0.06, right=0.945, bottom=0.09, top=0.865, hspace=0.3)
        _bode(analysis, axes[0, 0], axes[1, 0])
        _steps(analysis, axes[0, 1])
        _margins(variants, axes[1, 1])
        title = f"{analysis.scenario.replace('_', ' ')}: control loops at t = {analysis.at:g} s"
        plain: Any = {"va": "top", "parse_math": False}  # names come from users
        figure.text(0.02, 0.975, title, fontsize=16, fontweight="bold", **plain)
        figure.text(0.02, 0.938, _details(analysis), fontsize=10, color=GREY, **plain)
        figure.savefig(path, dpi=DPI, format="png", metadata={"Comment": comment})


def _details(analysis: Analysis) -> str:
    """Period, coupling, gains (of our law, or the first parameters of another), why no margins."""
    margins, parameters = analysis.margins, analysis.parameters
    names = [name for name in parameters if name != "period"][:SHOWN]
    names = list(GAINS) if parameters.keys() >= set(GAINS) else names
    gains = [f"{name} {_short(parameters[name])}" for name in names]
    about = [f"period {margins.period * 1e3:g} ms", margins.coupling, *gains, margins.reason]
    return " · ".join(filter(None, about))


def _short(value: Any) -> str:
    values = list(dict.fromkeys(value if isinstance(value, tuple) else (value,)))
    return ", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in values)


def _bode(analysis: Analysis, gain: Any, phase: Any) -> None:
    omega = frequencies(analysis.responses)
    hertz = omega / (2 * math.pi)
    for i, loop in enumerate(analysis.margins.loops):
        answer = 1.0 / analysis.responses.sensitivity.loop(i).at(omega)[:, 0, 0] - 1.0
        style: dict[str, object] = {"color": COLOURS[i % len(COLOURS)]}
        gain.semilogx(hertz, 20 * np.log10(np.abs(answer)), label=f"joint {loop.joint}", **style)
        phase.semilogx(hertz, np.degrees(np.unwrap(np.angle(answer))), **style)
    gain.axhline(0, color=GREY, lw=0.8)
    phase.axhline(-180, color=GREY, lw=0.8)
    gain.set(title="Gain of each open loop, with the others closed", ylabel="gain [dB]")
    phase.set(
        title="Phase: its distance to -180 deg at 0 dB is the margin",
        xlabel="frequency [Hz]",
        ylabel="phase [deg]",
    )
    if analysis.margins.loops:
        gain.legend(ncols=2)


def _steps(analysis: Analysis, axes: Any) -> None:
    axes.set(
        title="Each joint after a step of 1 at its own input",
        xlabel="time [ms]",
        ylabel="position per unit of the input",
    )
    if not analysis.margins.stable:
        return
    moves = steps(analysis.responses)
    times = 1e3 * analysis.period * np.arange(len(moves))
    for i, move in enumerate(moves.T):
        axes.plot(times, move, color=COLOURS[i % len(COLOURS)])
    axes.set_xlim(0.0)


def _margins(variants: Sequence[Margins], axes: Any) -> None:
    names = [f"{1e3 * v.period:g} ms\n{v.coupling}" for v in variants]
    place = np.arange(len(names))
    axes.set_xticks(place, names, fontsize="small")
    axes.set_title("Margins of all loops at once (none: 0); dashed: target")
    for side, shift, colour, key, wanted, label in (
        (axes, -0.2, COLOURS[0], "disk_phase_deg", WANTED_PHASE_DEG, "phase within the disk [deg]"),
        (axes.twinx(), 0.2, COLOURS[1], "delay_margin_ms", WANTED_DELAY_MS, "delay margin [ms]"),
    ):
        values = [getattr(variant, key) for variant in variants]
        side.bar(place + shift, np.where(np.isfinite(values), values, 0.0), 0.4, color=colour)
        side.axhline(wanted, color=colour, ls="--", lw=0.8)
        side.set_ylabel(label, color=colour)
        side.grid(visible=False)
