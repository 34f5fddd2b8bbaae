"""Fills the templates of the pages; all text is escaped, and none is longer than a page bears."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Final

from ...fmus.messages import shown

FOLDER: Final = Path(__file__).parent
STYLE: Final = "report_style.css"
DASH: Final = "\u2013"  # en dash for an empty cell


def fill(
    template: str,
    content: Mapping[str, Any],
    filters: Iterable[Callable[..., object]] = (),
) -> str:
    """Return a page.

    Args:
        template: Name of the template's file.
        content: Its variables, besides the style sheet.
        filters: Further filters, known by their functions' names.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 - slow

    environment = Environment(
        loader=FileSystemLoader(FOLDER), autoescape=True, undefined=StrictUndefined, finalize=shown
    )
    environment.filters.update({each.__name__: each for each in (shown, *filters)})
    style = (FOLDER / STYLE).read_text(encoding="utf-8")
    return environment.get_template(template).render(content, style=style)


def numbers(values: Sequence[object]) -> list[str]:
    """Format numbers with four digits, or with as many as it takes to tell them apart."""
    texts = [number(value) for value in values]
    for digits in range(5, 18):
        seen = zip(values, texts, strict=True)
        if all(a == b or s != t for (a, s), (b, t) in combinations(seen, 2)):
            break
        texts = [number(value, digits=digits) for value in values]
    return texts


def number(value: object, sign: str = "", digits: int = 4) -> str:
    """Format a number with four digits; return anything else unchanged."""
    if value is None:
        return DASH
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return f"{value:{sign}.{digits}g}"
