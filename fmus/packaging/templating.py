"""The templates of what is generated as text: model descriptions and documentation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

TEMPLATES: Final = Path(__file__).with_name("templates")


def render(name: str, filters: Mapping[str, Callable[..., Any]], **context: Any) -> bytes:
    """Fill in a template; texts are escaped as XML and HTML want it.

    Args:
        name: File in `templates/`.
        filters: Functions that it applies to values.
        **context: What it names.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 - 50 ms

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        keep_trailing_newline=True,
    )
    environment.filters |= filters
    return environment.get_template(name).render(**context).encode()
