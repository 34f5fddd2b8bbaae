"""One page of curves of a run, drawn from its recording alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from textwrap import shorten
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ...fmus.atomic import MARK, replacing
from ...result.judging.summary import Summary
from ...result.judging.verdicts import NO_CRITERIA
from ...task.fields import check_choice
from .motion import SHAPES, check_signals, describe_run
from .panels import BAD, DPI, GOOD, GREY, SHADE, STYLE, Curves, panels_of, read_curves
from .signals import PRINTED, all_panels, draw_chosen, draw_panels, moves

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ...result.recording import Recording
    from .canvas import ShownFigure

SIZE: Final = (13.0, 12.8)  # [inch]
LENGTH: Final = 80  # of the purpose, and of what was missed
VERDICTS: Final = {"good": GOOD, "plain": GREY, "bad": BAD}  # by level
CARET_DOWN: Final = 11  # matplotlib's marker that points down from its position
# Of the page of a run whose signals are not those of the task:
MOST: Final = 24  # signals on a page
ACROSS: Final = 3
# What a file of each format holds beside the figure: the mark by which later runs may replace it,
# and no date, so that the same run gives the same file.
FORMATS: Final[dict[str, dict[str, Any]]] = {
    ".png": {"metadata": {"Comment": MARK}, "pil_kwargs": {"optimize": True}},
    ".pdf": {"metadata": {"Subject": MARK, "CreationDate": None}},
    ".svg": {"metadata": {"Description": MARK, "Date": None}},
}


def draw(
    runs: Sequence[Recording],
    summary: Summary | None = None,
    signals: str = "",
    width: str | None = None,
) -> ShownFigure:
    """Return the page of a run, or a figure of chosen signals of one run or several.

    Raises:
        InputError: Several runs or a width without signals, or see `draw_chosen`.
    """
    if signals or width is not None or len(runs) != 1:
        with own_style(PRINTED):
            return draw_chosen(runs, signals, width)
    (recording,) = runs
    is_task = all(name in recording for name in SHAPES)
    return draw_run(recording, summary) if is_task else draw_signals(recording, summary)


def save(figure: ShownFigure, path: Path) -> None:
    """Write a figure in the format of the file's name: .png, .pdf or .svg."""
    kind = check_choice(f"{path}: format", path.suffix.lower(), FORMATS)
    with own_style(), replacing(path) as temporary:
        figure.savefig(temporary, format=kind[1:], dpi="figure", **FORMATS[kind])


def own_style(more: Mapping[str, float] = MappingProxyType({})) -> AbstractContextManager[None]:
    """Draw and save figures in matplotlib's default style, changed by ours alone."""
    from matplotlib.style import context  # noqa: PLC0415 - slow to import

    return context([STYLE, dict(more)], after_reset=True)


def draw_run(recording: Recording, summary: Summary | None = None) -> ShownFigure:
    """Return the figure of a run of the task."""
    curves = read_curves(recording)
    with own_style():
        from .canvas import ShownFigure  # noqa: PLC0415 - slow to import

        figure = ShownFigure(figsize=SIZE, dpi=DPI, facecolor="white")
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
        _write_verdict(figure, summary, 0.979)
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


def draw_signals(recording: Recording, summary: Summary | None = None) -> ShownFigure:
    """Return the figure of any run, a panel for each signal that moves, at most `MOST` of them."""
    check_signals(recording, ())
    every = [*all_panels(recording)]
    moving = [*filter(moves, every)]
    panels = moving[:MOST] or every[:1]
    size = (SIZE[0], 1.2 + 2.2 * -(-len(panels) // ACROSS))
    with own_style():
        figure = draw_panels([[panel] for panel in panels], [], ACROSS, size, DPI)
        figure.suptitle(" · ".join(describe_run(recording)), x=0.02, ha="left", fontweight="bold")
        _write_verdict(figure, summary, 0.99)
        rest, still = len(moving[MOST:]), len(every) - len(moving)
        notes = {"further signals": rest, "signals that stay at 0": still}
        text = "    ".join(f"{what}: {count}" for what, count in notes.items() if count)
        figure.supxlabel(text, fontsize=9, color=GREY)
    return figure


def _write_verdict(figure: ShownFigure, summary: Summary | None, top: float) -> None:
    """Write the verdict at the right, if there are criteria."""
    if summary is not None and summary.verdict is not NO_CRITERIA:
        words = shorten(summary.headline, LENGTH, placeholder=" ...")
        colour = VERDICTS[summary.verdict.level]
        figure.text(0.975, top, words, fontsize=11, color=colour, va="top", ha="right")
