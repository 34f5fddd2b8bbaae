"""The page of differences: one section for each run against its reference, or against other runs.

One HTML file with its style, script, curves and pictures. Names, purposes, units and messages come
from users; the template escapes all of them, and shows none that is longer than a page bears.
"""

from __future__ import annotations

import math
import secrets
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from ...fmus.messages import shown
from .formats import multiple

FOLDER: Final = Path(__file__).parent
TEMPLATE, STYLE = "page_template.html", "page_style.css"
DECADES: Final = 4.0  # of tolerance, from a hundredth to a hundred times, along a bar
NO_VIEW: Final = {"sources": "", "style": "", "elements": ""}

T = TypeVar("T")
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
    curve: dict[str, Any]  # of `curves.curve`


@dataclass(frozen=True)
class Part:
    """What stands under one heading of a section."""

    title: str
    tables: Sequence[Table] = ()  # those without rows are left out
    note: str = ""
    figures: Sequence[Figure] = ()
    picture: dict[str, Any] | None = None  # width and height [px], JPEG in base64
    view: dict[str, Any] | None = None  # `runs` for PandaView.show, `at` [s], `words` or `missing`


@dataclass(frozen=True)
class Section:
    """One run against its reference, or runs against the first of them."""

    name: str
    state: str  # good, warn, bad or ""
    parts: Sequence[Part] = ()
    word: str = ""  # of the verdict
    purpose: str = ""
    problems: Sequence[str] = ()
    reason: str = ""
    seconds: float = 0.0
    worst: float | None = None  # deviation / tolerance


@dataclass(frozen=True)
class Page:
    """The page: its sections, and what stands above them."""

    title: str
    state: str
    about: str
    key: Sequence[tuple[str, str]]  # class and words of each kind of line
    sections: Sequence[Section]
    view: Mapping[str, str]  # `Views.page_parts`, or NO_VIEW
    settings: Sequence[str] = ()  # changed for these runs
    listed: bool = False  # whether a table of verdicts comes first


def render(page: Page) -> str:
    """Return the page as HTML."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 - slow

    environment = Environment(
        loader=FileSystemLoader(FOLDER), autoescape=True, undefined=StrictUndefined, finalize=shown
    )
    environment.filters |= {each.__name__: each for each in (shown, bar_length, short_share)}
    return environment.get_template(TEMPLATE).render(
        page=page,
        style=(FOLDER / STYLE).read_text(encoding="utf-8"),
        nonce=secrets.token_urlsafe(),  # of the only script that the page may run
    )


def bar_length(share: float) -> int:
    """Return the bar length [%] of a share of the tolerance, logarithmic with 1 in the middle."""
    length = (math.log10(min(max(share, 1e-9), 1e9)) + DECADES / 2) / DECADES
    return round(100 * min(max(length, 0.0), 1.0))


def short_share(share: float) -> str:
    """Format a share of the tolerance."""
    return "∞" if math.isinf(share) else multiple(share) if share >= 1e-3 else "0"


def varied(rows: Iterable[T], name: Callable[[T], str], alike: int) -> list[T]:
    """Keep at most `alike` elements of each signal, so that other signals are seen."""
    counts: Counter[str] = Counter()
    kept = []
    for row in rows:
        signal = name(row).partition("[")[0]
        counts[signal] += 1
        if counts[signal] <= alike:
            kept.append(row)
    return kept
