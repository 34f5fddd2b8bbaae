"""One page of curves of a run, drawn from its recording alone."""

from __future__ import annotations

from contextlib import AbstractContextManager
from itertools import groupby
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Final

import numpy as np

from ...fmus.atomic import MARK, replacing
from ...fmus.errors import InputError
from ...result.judging.summary import Summary
from ...result.judging.verdicts import NO_CRITERIA
from ..thinning import drawn_rows
from .motion import SHAPES, describe_run
from .panels import COLOURS, DPI, GREY, SHADE, STYLE, Curves, panels_of, read_curves

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ...result.recording import Recording

SIZE: Final = (13.0, 12.8)  # [inch]
LENGTH: Final = 80  # of the purpose, and of what was missed
VERDICTS: Final = {"good": "#0f7a54", "plain": GREY, "bad": "#c4243a"}  # by level
CARET_DOWN: Final = 11  # matplotlib's marker that points down from its position
# Of the page of a run whose signals are not those of the task:
MOST: Final = 24  # signals on a page
ACROSS: Final = 3
POINTS: Final = 4000  # of a curve


def plot_recording(recording: Recording, path: str | Path, summary: Summary | None = None) -> Path:
    """Write a PNG with the curves of a run of the task, or with the signals of any other run."""
    path, is_task = Path(path), all(name in recording for name in SHAPES)
    with own_style():
        figure = draw_run(recording, summary) if is_task else draw_signals(recording)
        save(figure, path)
    return path


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, with the mark by which later runs may replace it."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI, metadata={"Comment": MARK},
                       pil_kwargs={"optimize": True})  # fmt: skip


def own_style() -> AbstractContextManager[None]:
    """Draw and save figures in matplotlib's default style, changed by ours alone."""
    from matplotlib.style import context  # noqa: PLC0415 - slow to import

    return context(STYLE, after_reset=True)


def draw_run(recording: Recording, summary: Summary | None = None) -> Figure:
    """Return the figure of a run, for a notebook or a format other than PNG."""
    curves = read_curves(recording)
    with own_style():
        # Without pyplot, which keeps every figure and may need a screen.
        from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import

        figure = Figure(figsize=SIZE, facecolor="white")
        grid = figure.subplots(5, 2, sharex=True)
        figure.subplots_adjust(
            left=0.06, right=0.975, bottom=0.043, top=0.907, hspace=0.27, wspace=0.15
        )
        for column, panels in enumerate(panels_of(recording)):
            for axes, (title, label, draw) in zip(grid[:, column], panels, strict=True):
                axes.set_title(title)
                axes.set_ylabel(label)
                draw(axes, curves)
                _mark_time(axes, curves)
            grid[-1, column].set_xlabel("time [s]")
        _name_waypoints(grid[0, 0], curves)
        title, details = describe_run(recording)
        purpose = shorten(str(recording.metadata.get("purpose") or ""), LENGTH, placeholder=" ...")
        details = " · ".join(filter(None, (purpose, details)))
        figure.text(0.02, 0.979, title, fontsize=16, fontweight="bold", va="top")
        figure.text(0.02, 0.953, details, fontsize=10, color=GREY, va="top")
        if summary is not None and summary.verdict is not NO_CRITERIA:
            words = shorten(summary.headline, LENGTH, placeholder=" ...")
            colour = VERDICTS[summary.verdict.level]
            figure.text(0.975, 0.979, words, fontsize=11, color=colour, va="top", ha="right")
        note = "shaded: the fingers hold the block    ▾ waypoint of the table"
        figure.text(0.975, 0.953, note, fontsize=9, color=GREY, va="top", ha="right")
    return figure


def _name_waypoints(axes: Axes, curves: Curves) -> None:
    """Write the names of the waypoints at their marks; those of close ones side by side."""
    begin, end = float(curves.time[0]), float(curves.time[-1])
    size = 6  # points
    line = 1.2 * size / 72 / (axes.bbox.width / axes.figure.dpi) * (end - begin)  # s
    right = -np.inf
    for time, name in zip(curves.waypoints, curves.names, strict=False):
        if name and begin <= time <= end:
            right = max(time, right + line)
            axes.text(
                right, 0.97, name, color=GREY, fontsize=size, rotation=90, ha="right", va="top",
                transform=axes.get_xaxis_transform(),
            )  # fmt: skip


def _mark_time(axes: Axes, curves: Curves) -> None:
    """Shade the spans in which the block is held, and mark the waypoints."""
    begin, end = float(curves.time[0]), float(curves.time[-1])
    for hold in curves.holds:
        span = curves.time[[hold.grasp, min(hold.end, len(curves.time) - 1)]]
        axes.axvspan(*span, color=SHADE, linewidth=0, zorder=0)
    inside = curves.waypoints[(curves.waypoints >= begin) & (curves.waypoints <= end)]
    axes.plot(
        inside, np.ones(len(inside)), color=GREY, marker=CARET_DOWN, markersize=4,
        linestyle="none", clip_on=False, transform=axes.get_xaxis_transform(),
    )  # fmt: skip
    axes.set_xlim(begin, max(end, begin + 1e-3))
    axes.tick_params(length=3)


def draw_signals(recording: Recording) -> Figure:
    """Return the figure of any run, a panel for each signal, at most `MOST` of them."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import

    if not recording.rows:
        raise InputError("the recording has no rows; nothing can be plotted")
    units = recording.units
    names = (name for name in recording.columns if name != "time")
    signals = groupby(names, lambda name: (name.partition("[")[0], units.get(name, "")))
    panels = [(signal, unit, list(columns)) for (signal, unit), columns in signals]
    down = max(-(-len(panels[:MOST]) // ACROSS), 1)
    figure = Figure(figsize=(13.0, 1.2 + 2.2 * down), layout="constrained")
    grid = figure.subplots(down, ACROSS, sharex=True, squeeze=False).ravel()
    for axes, (signal, unit, columns) in zip(grid, panels, strict=False):
        axes.set_title(signal, fontsize=9)
        axes.set_ylabel("" if unit == "1" else unit, color=GREY)
        axes.set_xlabel("t [s]", color=GREY)
        for i, column in enumerate(columns):
            values = recording[column]
            rows, colour = drawn_rows([values], POINTS), COLOURS[i % len(COLOURS)]
            axes.plot(recording.time[rows], values[rows], color=colour, linewidth=1.0)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    title = str(recording.metadata.get("scenario") or recording.metadata.get("system") or "")
    more = f" ({len(panels) - MOST} more signals are recorded)" if len(panels) > MOST else ""
    figure.suptitle(f"{title}{more}", fontweight="bold")
    return figure
