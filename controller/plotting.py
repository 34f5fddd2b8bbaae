"""matplotlib's default style, whatever a user's matplotlibrc says."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any


def own_style(style: Mapping[Any, Any]) -> AbstractContextManager[None]:
    """Draw and save figures in matplotlib's default style, changed by `style` alone."""
    from matplotlib.style import context  # noqa: PLC0415 - slow to import

    return context(dict(style), after_reset=True)
