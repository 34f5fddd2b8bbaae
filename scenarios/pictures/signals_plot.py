"""One page of curves of any run: all signals, one panel each."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from ...controller.plotting import own_style
from ...fmus.atomic import MARK, replacing
from ...fmus.errors import InputError
from .plot_style import COLOURS, DPI, GREY, STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..recording import Recording

MOST: Final = 24  # signals on a page
ACROSS: Final = 3
POINTS: Final = 4000  # points of a curve; more are thinned to the extremes of each stretch


def plot_signals(recording: Recording, path: Path) -> Path:
    """Write a PNG with a panel for each signal of a run, at most `MOST` of them.

    Args:
        recording: The run.
        path: The file to write.

    Raises:
        InputError: The recording has no rows, or the file cannot be written.
    """
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
        time, values = _thinned(recording.time, np.asarray(recording[column], dtype=float))
        axis.plot(time, values, color=COLOURS[i % len(COLOURS)], linewidth=1.0)
    unit = recording.units.get(columns[0], "")
    axis.set_title(name, fontsize=9)
    axis.set_ylabel(unit if unit not in ("", "1") else "", color=GREY)
    axis.set_xlabel("t [s]", color=GREY)


def _thinned(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Keep the minimum and maximum of each stretch."""
    if len(time) <= POINTS:
        return time, values
    size = -(-2 * len(time) // POINTS)
    whole = len(time) // size * size
    parts = values[:whole].reshape(-1, size)
    first = np.arange(0, whole, size)
    rows = np.sort(np.concatenate((first + parts.argmin(1), first + parts.argmax(1))))
    rows = np.concatenate((rows, [len(time) - 1]))
    return time[rows], values[rows]


__all__ = ["plot_signals"]
