"""The picture of an analysis: open loops, step responses, margins."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from .design import STEP_TIME, Analysis, frequencies
from .plotting import own_style

WANTED_PHASE_DEG, WANTED_DELAY_MS = 45.0, 3.0
DPI = 110


def plot_analysis(analysis: Analysis, path: Path, comment: str = "") -> None:
    """Draw an analysis as a PNG file that carries a comment."""
    with own_style({}):
        from matplotlib.figure import Figure  # noqa: PLC0415 - after its defaults are set

        figure = Figure(figsize=(13, 8), layout="constrained")
        axes = figure.subplots(2, 2)
        _bode(analysis, axes[0, 0], axes[1, 0])
        _steps(analysis, axes[0, 1])
        _margins(analysis, axes[1, 1])
        figure.savefig(path, dpi=DPI, format="png", metadata={"Comment": comment})


def _bode(analysis: Analysis, gain: Any, phase: Any) -> None:
    system = analysis.systems[0]
    omega = frequencies(system.period)
    hertz = omega / (2 * math.pi)
    for joint in range(7):
        answer = system.response(joint, omega)
        gain.semilogx(hertz, 20 * np.log10(np.abs(answer)), label=f"joint {joint + 1}")
        phase.semilogx(hertz, np.degrees(np.unwrap(np.angle(answer))))
    gain.axhline(0, color="0.6", lw=0.8)
    phase.axhline(-180, color="0.6", lw=0.8)
    gain.set(title="Open loops, each with the other six closed", ylabel="gain [dB]")
    phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
    gain.legend(fontsize="small", ncols=2)
    for axes in (gain, phase):
        axes.grid(True, which="both", lw=0.3)


def _steps(analysis: Analysis, axes: Any) -> None:
    system = analysis.systems[0]
    ticks = round(STEP_TIME / system.period)
    if not analysis.variants[0].stable:
        axes.text(0.5, 0.5, "unstable", ha="center", va="center", transform=axes.transAxes)
    for joint in range(7) if analysis.variants[0].stable else ():
        axes.plot(1e3 * system.period * np.arange(ticks), 1e3 * system.step(joint, ticks))
    axes.set(
        title="A servo target steps by 1 mrad",
        xlabel="time [ms]",
        ylabel="joint moves [urad]",
    )
    axes.grid(True, lw=0.3)


def _margins(analysis: Analysis, axes: Any) -> None:
    names = [f"{1e3 * v.period:g} ms\n{v.coupling}" for v in analysis.variants]
    place = np.arange(len(names))
    phases = [min((x.phase_margin_deg for x in v.loops), default=0.0) for v in analysis.variants]
    delays = [min((x.delay_margin_ms for x in v.loops), default=0.0) for v in analysis.variants]
    axes.bar(place - 0.2, phases, 0.4, color="tab:blue")
    axes.axhline(WANTED_PHASE_DEG, color="tab:blue", ls="--", lw=0.8)
    axes.set_xticks(place, names, fontsize="small")
    axes.set_ylabel("phase margin [deg]", color="tab:blue")
    axes.set_title("Smallest margins of the seven loops; dashed: required; unstable: 0")
    right = axes.twinx()
    right.bar(place + 0.2, delays, 0.4, color="tab:orange")
    right.axhline(WANTED_DELAY_MS, color="tab:orange", ls="--", lw=0.8)
    right.set_ylabel("delay margin [ms]", color="tab:orange")
