"""Fills the templates of model descriptions and documentation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from ..messages import shown

TEMPLATES: Final = Path(__file__).with_name("templates")


def render(name: str, filters: Mapping[str, Callable[..., Any]], **context: Any) -> bytes:
    """Fill in a template; text is escaped for XML and HTML.

    Args:
        name: File in `templates/`.
        filters: Functions that the template applies to values.
        **context: The template's variables.
    """
    from jinja2 import (  # noqa: PLC0415 - takes 50 ms
        Environment,
        FileSystemLoader,
        StrictUndefined,
    )

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_escaped,
        keep_trailing_newline=True,
    )
    environment.filters |= {"shown": _escaped, **filters}
    return environment.get_template(name).render(**context).encode()


def _escaped(value: object) -> object:
    """Escape characters that XML cannot hold, such as those in names of an MJCF file."""
    return shown(value, limit=None)
