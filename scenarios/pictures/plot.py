"""One page of curves of a run, drawn from its recording alone."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ...controller.plotting import own_style
from ...fmus.atomic import MARK, replacing
from ...fmus.errors import InputError
from .motion import Signals, describe_run
from .panels import COLOURS, DPI, GREY, PANELS, SHADE, STYLE, Curves, read_curves, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..recording import Recording

SIZE: Final = (13.0, 12.8)  # [inch]
CARET_DOWN: Final = 11  # matplotlib's marker that points down from its position
# Of the page of a run whose signals are not those of the task:
MOST: Final = 24  # signals on a page
ACROSS: Final = 3
POINTS: Final = 4000  # of a curve


def plot_run(recording: Signals, path: str | Path) -> Path:
    """Write a PNG with the curves of a run: hand, error, gripper, block, joints and limits."""
    path = Path(path)
    figure = draw_run(recording)
    with own_style(STYLE), replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI, metadata={"Comment": MARK})
    return path


def draw_run(recording: Signals) -> Figure:
    """Return the figure of a run, for a notebook or a format other than PNG."""
    curves = read_curves(recording)
    with own_style(STYLE):
        # Without pyplot, which keeps every figure and may need a screen.
        from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import

        figure = Figure(figsize=SIZE, facecolor="white")
        grid = figure.subplots(5, 2, sharex=True)
        figure.subplots_adjust(
            left=0.06, right=0.975, bottom=0.043, top=0.907, hspace=0.27, wspace=0.15
        )
        for column, panels in enumerate(PANELS):
            for row, panel in enumerate(panels):
                panel(grid[row, column], curves)
                _mark_time(grid[row, column], curves)
            grid[-1, column].set_xlabel("time [s]")
        _name_waypoints(grid[0, 0], curves)
        _write_title(figure, recording)
    return figure


def _name_waypoints(axes: Axes, curves: Curves) -> None:
    """Write the names of the waypoints at their marks."""
    begin, end = float(curves.time[0]), float(curves.time[-1])
    for time, name in zip(curves.waypoints, curves.names, strict=False):
        if name and begin <= time <= end:
            axes.text(
                time, 0.97, name, color=GREY, fontsize=6, rotation=90, ha="right", va="top",
                transform=axes.get_xaxis_transform(), parse_math=False,
            )  # fmt: skip


def _mark_time(axes: Axes, curves: Curves) -> None:
    """Shade the spans in which the block is held, and mark the waypoints."""
    begin, end = float(curves.time[0]), float(curves.time[-1])
    for hold in curves.holds:
        span = curves.time[[hold.grasp, min(hold.end, len(curves.time) - 1)]]
        axes.axvspan(*span, color=SHADE, linewidth=0, zorder=0)
    inside = curves.waypoints[(curves.waypoints >= begin) & (curves.waypoints <= end)]
    axes.plot(
        inside,
        np.ones(len(inside)),
        color=GREY,
        marker=CARET_DOWN,
        markersize=4,
        linestyle="none",
        clip_on=False,
        transform=axes.get_xaxis_transform(),
    )
    axes.set_xlim(begin, max(end, begin + 1e-3))
    axes.tick_params(length=3)


def _write_title(figure: Figure, recording: Signals) -> None:
    """Write what ran above all panels."""
    title, details = describe_run(recording)
    # Names come from users: a pair of $ in them is not a formula.
    plain: dict[str, Any] = {"va": "top", "parse_math": False}
    figure.text(0.02, 0.979, title, fontsize=16, fontweight="bold", **plain)
    figure.text(0.02, 0.953, details, fontsize=10, color=GREY, **plain)
    note = "shaded: the fingers hold the block    ▾ waypoint of the table"
    figure.text(0.975, 0.953, note, fontsize=9, color=GREY, va="top", ha="right")


def plot_signals(recording: Recording, path: Path) -> Path:
    """Write a PNG with a panel for each signal of any run, at most `MOST` of them."""
    if not recording.rows:
        raise InputError("the recording has no rows; nothing can be plotted")
    panels = _panels(recording)
    shown = panels[:MOST]
    down = max(-(-len(shown) // ACROSS), 1)
    with own_style(STYLE | {"text.parse_math": False}):
        from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import

        figure = Figure(figsize=(13.0, 1.2 + 2.2 * down), layout="constrained")
        axes = figure.subplots(down, ACROSS, sharex=True, squeeze=False).ravel()
        for axis, (name, columns) in zip(axes, shown, strict=False):
            _panel(axis, recording, name, columns)
        for axis in axes[len(shown) :]:
            axis.set_visible(False)
        title = str(recording.metadata.get("scenario") or recording.metadata.get("system") or "")
        more = f" ({len(panels) - MOST} more signals are recorded)" if len(panels) > MOST else ""
        figure.suptitle(f"{title}{more}", fontweight="bold")
        with replacing(path) as temporary:
            figure.savefig(temporary, format="png", dpi=DPI, metadata={"Comment": MARK})
    return path


def _panels(recording: Recording) -> list[tuple[str, list[str]]]:
    """Signals and their columns, in the order of the recording, without the time."""
    columns = [c for c in recording.columns if c != "time"]
    groups = groupby(columns, lambda c: (c.partition("[")[0], recording.units.get(c, "")))
    return [(name, list(members)) for (name, _), members in groups]


def _panel(axis: Axes, recording: Recording, name: str, columns: list[str]) -> None:
    for i, column in enumerate(columns):
        values = recording[column]
        rows = thin(values, POINTS)
        axis.plot(
            recording.time[rows], values[rows], color=COLOURS[i % len(COLOURS)], linewidth=1.0
        )
    unit = recording.units.get(columns[0], "")
    axis.set_title(name, fontsize=9)
    axis.set_ylabel(unit if unit not in ("", "1") else "", color=GREY)
    axis.set_xlabel("t [s]", color=GREY)
