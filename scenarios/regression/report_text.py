"""Small pieces of the report's HTML."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Final

from .compare import Deviation
from .guards import measure, short

DASH: Final = "&ndash;"  # where there is nothing
DECADES: Final = 4.0  # of tolerance, from a hundredth to a hundred times, along a bar


def number(value: object, *, signed: bool = False) -> str:
    """Write a number with four digits, anything else as it is."""
    if value is None:
        return DASH
    if isinstance(value, bool) or not isinstance(value, int | float):
        return escape(str(value))
    return f"{value:{'+' if signed else ''}.4g}"


def bar(share: float) -> str:
    """Draw a share of the tolerance as a bar on a logarithmic scale; the mark is 1."""
    text = "&infin;" if math.isinf(share) else short(share) if share >= 1e-3 else "0"
    width = 1.0 if math.isinf(share) else (math.log10(max(share, 1e-9)) + 2.0) / DECADES
    state = "bad" if share > 1.0 else "good"
    length = f"{100 * min(max(width, 0.0), 1.0):.0f}%"
    drawn = f'<span class="bar {state}" style="--w:{length}"><i></i></span>'
    return f"{drawn}<b class=num>{text}&times;</b>"


def share_text(deviation: Deviation) -> str:
    """Say how far a column is from its reference."""
    if math.isinf(deviation.share):
        return f"not finite at {deviation.time:.3f} s"
    return (
        f"{escape(measure(deviation.distance, deviation.unit))} at {deviation.time:.3f} s, "
        f"{short(deviation.share)} times its tolerance"
    )


def cells(*values: str) -> str:
    """Return a table's row; all cells but the first are numbers."""
    first, *rest = values
    return f"<tr><td>{first}</td>{''.join(f'<td class=num>{v}</td>' for v in rest)}</tr>"


def rows_table(head: Sequence[str], rows: Sequence[str]) -> str:
    """Return a table that scrolls sideways where it is too wide."""
    first, *rest = head
    heads = f"<th>{first}</th>{''.join(f'<th class=num>{text}</th>' for text in rest)}"
    body = "".join(rows)
    return f"<div class=scroll><table><tr>{heads}</tr>{body}</table></div>"


def details(title: str, content: str) -> str:
    """Return a part that is folded."""
    return f"<details class=more><summary>{escape(title)}</summary>{content}</details>"


__all__ = ["DASH", "bar", "cells", "details", "number", "rows_table", "share_text"]
