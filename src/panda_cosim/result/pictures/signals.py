"""Panels of recorded signals: chosen ones of some runs, for a paper, or all those of a run."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ...assets.fields import Array
from ...fmus.errors import InputError, located
from ...fmus.interface.parameters import literal
from ...fmus.interface.tables import INTERFACES
from ...result.judging.signals import columns_of, evaluate, unit_of
from ...result.recording.reader import by_rows, run_names, shapes_of
from ...task.criteria import names_of, read_signal
from ...task.fields import Quantity
from ..thinning import NOISE
from .motion import check_signals
from .panels import COLOURS, INK, trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ...result.recording import Recording
    from .canvas import ShownFigure

MOST_NAMED: Final = 12  # curves of a panel with a legend
DASHES: Final = ((), (5.0, 1.5), (1.2, 1.2), (6.0, 1.5, 1.2, 1.5))  # of runs [line widths]
AXES: Final = {7: [f"joint {i}" for i in range(1, 8)], 4: [*"wxyz"], 3: [*"xyz"]}  # of our signals
OURS: Final = {v.description for interface in INTERFACES.values() for v in interface.variables}
SHORT: Final = {"tracking": "|plant.hand_xpos - controller.pos_cmd|"}
# A figure for a paper.
WIDTH: Final = "88mm"  # a column of most journals
HEIGHT: Final = 1.4  # of a panel [inch]
PRINTED_DPI: Final = 300
PRINTED: Final = {"font.size": 8, "axes.titlesize": 8, "axes.labelsize": 8, "legend.fontsize": 7,
                  "lines.linewidth": 1.0}  # fmt: skip


@dataclass(frozen=True)
class Panel:
    """What a panel shows of one run: curves of one unit."""

    recording: Recording
    title: str
    unit: str
    names: Sequence[str]  # of the curves; "" if there is one
    read: Callable[[], Iterable[Array]]  # the values of each (n,), one after the other


def all_panels(recording: Recording) -> Iterator[Panel]:
    """Yield a panel for each signal and unit of a recording."""
    names = (name for name in recording.columns if name != "time")
    for signal, columns in groupby(names, lambda name: name.partition("[")[0]):
        yield from _by_unit(recording, signal, list(columns))


def moves(panel: Panel) -> bool:
    """Whether there is more to see than rounding noise around 0."""
    return any(not (np.abs(values) < NOISE).all() for values in panel.read())


def chosen_panels(recording: Recording, text: str) -> list[Panel]:
    """Return the panels of signals, separated by commas, in the words of criteria.

    `plant.qpos`, `plant.hand_xpos[3]`, `plant.lift.pos` (a model's element), `a - b`, `|a|`,
    `|a - b|`, and `tracking`: the distance between hand and command.

    Raises:
        InputError: A signal is not recorded, or does not fit the other.
    """
    check_signals(recording, ())
    with located(f"{recording.path}: --signals"):
        named = re.split(r",(?![^\[]*\])", text)  # at no comma between indices
        return [panel for name in named for panel in _chosen(recording, name.strip())]


def _chosen(recording: Recording, name: str) -> Iterable[Panel]:
    units = recording.units | {a: recording.units[n] for a, n in recording.addresses.items()}
    shapes, signal = shapes_of(tuple(recording.columns)), read_signal(SHORT.get(name, name))
    recorded = names_of(signal)
    columns = columns_of(recorded[0], shapes, units)
    if isinstance(signal, str):
        return _by_unit(recording, name, columns)
    names = [""] if signal[0] == "norm" else _names(recording, columns)
    values = partial(by_rows, recording, partial(evaluate, signal), *recorded)
    return [Panel(recording, name, unit_of(signal, shapes, units), names, lambda: values().T)]


def _by_unit(recording: Recording, title: str, columns: Sequence[str]) -> Iterator[Panel]:
    recorded = [recording.addresses.get(column, column) for column in columns]
    for unit, group in groupby(recorded, lambda column: recording.units.get(column, "")):
        same = list(group)
        name = same[0] if len(same) == 1 < len(columns) else title
        read = partial(map, recording.__getitem__, same)
        yield Panel(recording, name, unit, _names(recording, same), read)


def _names(recording: Recording, columns: Sequence[str]) -> list[str]:
    """Name curves by joint or axis, by the model's elements, or by index."""
    if recording.descriptions.get(columns[0]) in OURS and len(columns) in AXES:
        return AXES[len(columns)]
    addresses = {column: name for name, column in recording.addresses.items()}
    return [addresses.get(column, column).partition(".")[2] for column in columns]


def draw_chosen(runs: Sequence[Recording], text: str, width: str | None = None) -> ShownFigure:
    """Draw chosen signals of runs, one over the other, for a paper."""
    example = 'such as "plant.hand_xpos[3], tracking"'
    if not text:
        raise InputError(f"--signals: is missing, which several runs and --width need; {example}")
    millimetres = literal(str(width or WIDTH).removesuffix("mm"))
    inches = Quantity(30.0, 1000.0, "mm").check("--width", millimetres) / 25.4
    each = [chosen_panels(recording, text) for recording in runs]
    if len({tuple((panel.title, panel.unit) for panel in panels) for panels in each}) > 1:
        raise InputError("--signals: the runs have other units; must be the same in all of them")
    size = (inches, HEIGHT * len(each[0]) + 0.4)
    return draw_panels([*zip(*each, strict=True)], run_names(runs), 1, size, PRINTED_DPI)


def draw_panels(
    panels: Sequence[Sequence[Panel]],  # each of all runs
    runs: Sequence[str],
    across: int,
    size: tuple[float, float],  # [inch]
    dpi: float,
) -> ShownFigure:
    """Draw panels side by side, with legends of their curves and of the runs."""
    from .canvas import ShownFigure  # noqa: PLC0415 - slow to import

    figure = ShownFigure(figsize=size, dpi=dpi, layout="constrained")
    grid = figure.subplots(-(-len(panels) // across), across, sharex=True, squeeze=False).ravel()
    # Runs differ in colour, too, unless colours tell joints or axes apart.
    by_run = all(len(panel.names) == 1 for each in panels for panel in each)
    for axes, each in zip(grid, panels, strict=False):
        _draw(axes, each, by_run=by_run)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    for axes in grid[: len(panels)][-across:]:  # the lowest in each column
        axes.set(xlabel="time [s]")
        axes.tick_params(labelbottom=True)
    if len(runs) > 1:
        ink = {} if by_run else {"color": INK}
        styles = [_style(run, 0, by_run=by_run) | ink for run in range(len(runs))]
        lines = [grid[0].plot([], [], **style)[0] for style in styles]
        figure.legend(lines, runs, loc="outside upper left", ncols=2, handlelength=2.6)
    return figure


def _draw(axes: Axes, panels: Sequence[Panel], *, by_run: bool) -> None:
    """Draw a panel of all runs."""
    unit, names = panels[0].unit, panels[0].names
    axes.set(title=panels[0].title, ylabel="" if unit in ("", "1") else f"[{unit}]")
    for run, panel in enumerate(panels):
        for i, values in enumerate(panel.read()):
            trace(axes, panel.recording.time, values, **_style(run, i, by_run=by_run))
    if 1 < len(names) <= MOST_NAMED:
        axes.legend(axes.lines[: len(names)], names, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _style(run: int, curve: int, *, by_run: bool) -> dict[str, Any]:
    """Return the style of a curve of a run: colours by run, or else by curve."""
    colour = COLOURS[(run if by_run else curve) % len(COLOURS)]
    return {"color": colour, "dashes": DASHES[run % len(DASHES)]}
