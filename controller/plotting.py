"""matplotlib as it comes: no matplotlibrc, of the working directory for instance, changes it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, chdir, contextmanager, nullcontext
from pathlib import Path
from typing import Any


def without_matplotlibrc() -> AbstractContextManager[None]:
    """Return where to import matplotlib, or what imports it: it reads a matplotlibrc there."""
    return chdir(Path(__file__).parent) if Path("matplotlibrc").exists() else nullcontext()


@contextmanager
def own_style(style: Mapping[Any, Any]) -> Iterator[None]:
    """Draw and save figures in matplotlib's default style, changed by `style` alone."""
    with without_matplotlibrc():
        import matplotlib as mpl  # noqa: PLC0415 - slow to import
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(style)
        yield
