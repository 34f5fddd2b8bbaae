"""The picture of analyses, overlaid: open loops, sensitivities, responses, margins."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import shorten
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ...show.pictures.panels import COLOURS, DPI, GREY
from ...show.pictures.plot import own_style
from .margins import Analysis, frequencies, steps

if TYPE_CHECKING:
    from ...show.pictures.canvas import ShownFigure

WANTED_PHASE_DEG, WANTED_DELAY_MS = 45.0, 3.0
WIDTH: Final = 1.0  # of the last joint's line; those before are wider, and seen beneath it
WIDER: Final = 0.55
GAINS: Final = ("kp", "ki", "kd", "ik_gain")  # of our own law
SHOWN: Final = 5  # parameters of another
LETTERS: Final = 24  # of a case's name beneath its bars


def draw_analyses(cases: Mapping[str, Analysis]) -> ShownFigure:
    """Return a figure of analyses by name: one by joint, several in a colour each."""
    with own_style():
        from ...show.pictures.canvas import ShownFigure  # noqa: PLC0415 - slow to import

        figure = ShownFigure(figsize=(17, 8.6), dpi=DPI, facecolor="white")
        axes = figure.subplots(2, 3)
        figure.subplots_adjust(
            left=0.045, right=0.96, bottom=0.09, top=0.865, hspace=0.3, wspace=0.2
        )
        for number, (name, analysis) in enumerate(cases.items()):
            _draw(analysis, axes, "" if len(cases) == 1 else name, COLOURS[number % len(COLOURS)])
        _finish(axes)
        _margins(cases, axes[1, 2])
        first = next(iter(cases.values()))
        title = " and ".join(dict.fromkeys(each.scenario for each in cases.values()))
        title = f"{title.replace('_', ' ')}: control loops at t = {first.at:g} s"
        plain: Any = {"va": "top", "parse_math": False}  # names come from users
        figure.text(0.015, 0.975, title, fontsize=16, fontweight="bold", **plain)
        figure.text(0.015, 0.938, _details(cases), fontsize=10, color=GREY, **plain)
    return figure


def _details(cases: Mapping[str, Analysis]) -> str:
    """Period, coupling, gains (of our law, or the first parameters of another), why no margins."""
    if len(cases) > 1:
        return " · ".join(cases)
    (analysis,) = cases.values()
    margins, parameters = analysis.margins, analysis.parameters
    names = [name for name in parameters if name != "period"][:SHOWN]
    names = list(GAINS) if parameters.keys() >= set(GAINS) else names
    gains = [f"{name} {_short(parameters[name])}" for name in names]
    about = [f"period {margins.period * 1e3:g} ms", margins.coupling, *gains, margins.reason]
    return " · ".join(filter(None, about))


def _short(value: Any) -> str:
    values = list(dict.fromkeys(value if isinstance(value, tuple) else (value,)))
    return ", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in values)


def _draw(analysis: Analysis, axes: Any, name: str, colour: str) -> None:
    """Draw one analysis: each loop in its own colour, or if it has a name, all in that of it."""
    import control  # noqa: PLC0415 - brings matplotlib and scipy

    omega, sensitivity = frequencies(analysis.responses), analysis.responses.sensitivity
    moves = steps(analysis.responses)
    times = 1e3 * analysis.period * np.arange(len(moves))
    for i, move in enumerate(moves.T):
        wider = 0.0 if name else WIDER * (len(moves.T) - 1 - i)
        style = {"color": colour if name else COLOURS[i % len(COLOURS)], "linewidth": WIDTH + wider}
        label = "_" if name and i else name or analysis.inputs[i]
        axes[0, 2].plot(times, move, label=label, **style)
        if analysis.margins.stable:
            answer = 1.0 / sensitivity.loop(i).at(omega)[:, 0, 0] - 1.0
            loop = control.frd(answer, omega)
            control.bode_plot(loop, ax=axes[:, :1], Hz=True, dB=True, show_legend=False, **style)
            control.nichols_plot(loop, ax=axes[0, 1], grid=False, show_legend=False, **style)
    if analysis.margins.stable:
        values = control.frd(sensitivity.at(omega).transpose(1, 2, 0), omega)
        control.singular_values_plot(
            control.singular_values_response(values), ax=axes[1, 1], Hz=True, dB=True,
            show_legend=False, color=colour,
        )  # fmt: skip


def _finish(axes: Any) -> None:
    titles = ("Gain of each open loop, with the others closed", "Nichols: + is the limit",
              "Each joint after a step of 1 at its own input",
              "Phase: its distance to -180 deg at 0 dB is the margin",
              "Singular values of the sensitivity of all loops")  # fmt: skip
    for each, title in zip(axes.flat, titles, strict=False):
        each.set_title(title)
    for each in (axes[0, 0], axes[1, 0], axes[1, 1]):
        each.xaxis.set_major_formatter("{x:g}")
    axes[0, 0].axhline(0, color=GREY, lw=0.8)
    axes[1, 0].axhline(-180, color=GREY, lw=0.8)
    axes[0, 2].set(xlabel="time [ms]", ylabel="position per unit of the input")
    axes[0, 2].set_xlim(0.0)
    axes[0, 2].legend()


def _margins(cases: Mapping[str, Analysis], axes: Any) -> None:
    place = np.arange(len(cases))
    axes.set_xlim(-0.8, len(cases) - 0.2)
    axes.set_xticks(place, [shorten(name, LETTERS) for name in cases], fontsize="small")
    axes.set_title("Margins of all loops at once (none: 0); dashed: target")
    for side, shift, colour, key, wanted, label in (
        (
            axes,
            -0.15,
            COLOURS[0],
            "disk_phase_deg",
            WANTED_PHASE_DEG,
            "phase within disk [deg]",
        ),
        (axes.twinx(), 0.15, COLOURS[1], "delay_margin_ms", WANTED_DELAY_MS, "delay margin [ms]"),
    ):
        values = [getattr(each.margins, key) for each in cases.values()]
        side.bar(place + shift, np.where(np.isfinite(values), values, 0.0), 0.3, color=colour)
        side.axhline(wanted, color=colour, ls="--", lw=0.8)
        side.set_ylabel(label, color=colour)
        side.grid(visible=False)
