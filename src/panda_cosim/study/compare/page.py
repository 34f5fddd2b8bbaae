"""The page of differences: one section for each run against its reference, or against other runs.

One HTML file with its style, code, curves and runs in 3D. Names, purposes, units and messages come
from users; the template escapes all of them, and shows none that is longer than a page bears.
"""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from ...assets.fields import Array
from ...fmus.errors import TEXT_LENGTH, legible, shown
from ...result.thinning import drawn_rows
from ...task.tolerances import signal_of
from .wording import multiple

if TYPE_CHECKING:
    from .against_reference import Deviation
    from .differences import SignalRow
    from .outcome import Outcome

T = TypeVar("T", "Deviation", "SignalRow")

TEMPLATE: Final = Path(__file__).with_name("page_template.html")
DECADES: Final = 4.0  # of tolerance, from a hundredth to a hundred times, along a bar

POINTS: Final = 2400  # of a curve
POINTS_INSIDE: Final = 700  # of one that stays inside its tube
Cell = str | float  # a number is a share of a tolerance, shown as a bar


@dataclass(frozen=True)
class Table:
    """A table whose first column holds names."""

    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    folded: str = ""  # what stands there until it is unfolded; "": it is open


@dataclass(frozen=True)
class Figure:
    """A column's curves in all runs."""

    name: str
    text: str  # how far they are apart
    meaning: str
    curve: dict[str, object]  # see `curve`


@dataclass(frozen=True)
class Part:
    """What stands under one heading of a section."""

    title: str
    tables: Sequence[Table] = ()  # those without rows are left out
    note: str = ""  # "None." if there is nothing else
    figures: Sequence[Figure] = ()
    view: dict[str, object] | None = None  # `runs` for PandaView.show, and `at` [s]


@dataclass(frozen=True)
class Section:
    """One run against its reference, or runs against the first of them."""

    name: str
    state: str  # good, warn, bad or ""
    parts: Sequence[Part]
    outcome: Outcome | None = None  # of the run, if it has a reference or criteria of its own


@dataclass(frozen=True)
class Page:
    """The page: its sections, and what stands above them."""

    title: str
    state: str
    about: str
    key: Sequence[tuple[str, str]]  # class and words of each kind of line
    sections: Sequence[Section]
    settings: Sequence[str] = ()  # changed for these runs
    runs: str = ""  # in 3D: their elements, see `Views`


def render(page: Page) -> str:
    """Return the page as HTML."""
    from ...result.view.page import document, rendered  # noqa: PLC0415 - slow to import

    body = rendered(
        TEMPLATE, page=page, shown=shown, bar_length=bar_length, short_share=short_share
    )
    code = ["differences", "view"] if page.runs else ["differences"]
    title = f"{legible(page.title, TEXT_LENGTH)} \N{EN DASH} panda-cosim"
    return document(title, body, page.runs, code)


def bar_length(share: float) -> int:
    """Return the bar length [%] of a share of the tolerance, logarithmic with 1 in the middle."""
    length = (math.log10(min(max(share, 1e-9), 1e9)) + DECADES / 2) / DECADES
    return round(100 * min(max(length, 0.0), 1.0))


def short_share(share: float) -> str:
    """Format a share of the tolerance."""
    return "∞" if math.isinf(share) else multiple(share) if share >= 1e-3 else "0"


def varied(rows: Iterable[T], alike: int) -> list[T]:
    """Keep at most `alike` elements of each signal, so that other signals are seen."""
    counts, kept = Counter[str](), []
    for row in rows:
        counts[signal := signal_of(row.name)] += 1
        if counts[signal] <= alike:
            kept.append(row)
    return kept


def curve(  # noqa: PLR0913 - all that a figure shows
    unit: str,
    runs: Mapping[str, Array],
    time: Array,
    worst: float,
    tube: tuple[Array, Array] | None = None,
    tolerance: float | None = None,
    points: int = POINTS,
) -> dict[str, object]:
    """Return a column's curve for the page's code, `Curve` in curve.ts."""
    # Numbers are float32. All but the baseline are stored as differences from it, where it has a
    # value, so that a narrow tube around a large value keeps its digits.
    baseline, *others = runs.values()
    origin = np.nan_to_num(baseline, posinf=0.0, neginf=0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        differences = [values - origin for values in others]
        kept = drawn_rows([baseline, *differences], points, int(np.argmin(np.abs(time - worst))))
        return {
            "unit": "" if unit == "1" else legible(unit, TEXT_LENGTH),
            "names": [legible(name, TEXT_LENGTH) for name in runs],
            "tolerance": tolerance,
            "worst": worst,
            "time": _steps(time[kept]),
            "baseline": _encode(baseline[kept]),
            "runs": [_encode(values[kept]) for values in differences],
            "tube": tube and [_encode((edge - origin)[kept]) for edge in tube],
        }


def _steps(time: Array) -> list[tuple[int, int]]:
    """Return the steps between instants [us], from 0 to the first on, each with its count."""
    steps = np.diff(np.rint(time * 1e6).astype(np.int64), prepend=0)
    first = np.flatnonzero(np.diff(steps, prepend=~steps[0]))  # of equal ones in a row
    counts = np.diff(first, append=len(steps))
    return list(zip(steps[first].tolist(), counts.tolist(), strict=True))


def _encode(values: Array) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")
