"""The picture of analyses, overlaid: open loops, sensitivities, responses, margins."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from textwrap import shorten
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ...result.pictures.panels import COLOURS, DPI, GREY
from ...result.pictures.plot import own_style
from .margins import TABLES, Measured, frequencies, steps

if TYPE_CHECKING:
    from ...result.pictures.canvas import ShownFigure

WIDTH: Final = 1.0  # of the last joint's line; those before are wider, and seen beneath it
WIDER: Final = 0.55
LETTERS: Final = 24  # of a case's name beneath its bars


def draw_analyses(cases: Mapping[str, Measured]) -> ShownFigure:
    """Return a figure of analyses by name: one by joint, several in a colour each."""
    with own_style():
        from ...result.pictures.canvas import ShownFigure  # noqa: PLC0415 - slow to import

        figure = ShownFigure(figsize=(17, 8.6), dpi=DPI, facecolor="white")
        axes = figure.subplots(2, 3)
        figure.subplots_adjust(0.045, 0.09, 0.96, 0.865, hspace=0.3, wspace=0.2)
        for number, (name, analysis) in enumerate(cases.items()):
            _draw(analysis, axes, "" if len(cases) == 1 else name, COLOURS[number % len(COLOURS)])
        _finish(axes)
        _margins(cases, axes[1, 2])
        first = next(iter(cases.values()))
        title = " and ".join(dict.fromkeys(each.scenario for each in cases.values()))
        title = f"{title.replace('_', ' ')}: control loops at t = {first.at:g} s"
        plain: Any = {"va": "top", "parse_math": False}  # names come from users
        figure.text(0.015, 0.975, title, fontsize=16, fontweight="bold", **plain)
        details = (
            cases if len(cases) > 1 else first.margins.lines[:1]
        )  # with its period and coupling
        figure.text(0.015, 0.938, " · ".join(details), fontsize=10, color=GREY, **plain)
    return figure


def _draw(analysis: Measured, axes: Any, name: str, colour: str) -> None:
    """Draw one analysis: each loop in its own colour, or if it has a name, all in that of it."""
    import control  # noqa: PLC0415 - brings matplotlib and scipy

    omega, sensitivity = frequencies(analysis.responses), analysis.responses.sensitivity
    moves = steps(analysis.responses)
    times = 1e3 * analysis.period * np.arange(len(moves))
    labels = (name, *"_" * len(moves)) if name else analysis.inputs
    colours = cycle([colour] if name else COLOURS)
    for i, (move, label, own) in enumerate(zip(moves.T, labels, colours, strict=False)):
        wider = 0.0 if name else WIDER * (len(moves.T) - 1 - i)
        style = {"color": own, "linewidth": WIDTH + wider}
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
    for each, title in zip(axes.flat, TABLES["titles"], strict=True):
        each.set_title(title)
    for each in (axes[0, 0], axes[1, 0], axes[1, 1]):
        each.xaxis.set_major_formatter("{x:g}")
    axes[0, 0].axhline(0, color=GREY, lw=0.8)
    axes[1, 0].axhline(-180, color=GREY, lw=0.8)
    axes[0, 2].set(xlabel="time [ms]", ylabel="position per unit of the input")
    axes[0, 2].set_xlim(0.0)
    axes[0, 2].legend()


def _margins(cases: Mapping[str, Measured], axes: Any) -> None:
    place = np.arange(len(cases))
    axes.set_xlim(-0.8, len(cases) - 0.2)
    axes.set_xticks(place, [shorten(name, LETTERS) for name in cases], fontsize="small")
    sides = zip((axes, axes.twinx()), (-0.15, 0.15), COLOURS, TABLES["targets"], strict=False)
    for side, shift, colour, target in sides:
        values = [getattr(each.margins, target["key"]) for each in cases.values()]
        side.bar(place + shift, np.where(np.isfinite(values), values, 0.0), 0.3, color=colour)
        side.axhline(target["wanted"], color=colour, ls="--", lw=0.8)
        side.set_ylabel(target["label"], color=colour)
        side.grid(visible=False)
