"""Shows a run in a notebook: its verdict as a table, its pictures, its video."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ...fmus.messages import TEXT_LENGTH, legible
from ..judging.criterion import Criterion, bound_text, margin_text, quantity

if TYPE_CHECKING:
    from .run import Run

SHEET_FILE: Final = "contact_sheet.png"
_HEAD = "<tr><th>criterion</th><th>measured</th><th>required</th><th>margin</th><th></th></tr>"


@dataclass(frozen=True)
class ShownFile:
    """A file that a notebook shows as the last value of a cell.

    Attributes:
        path: The file.
    """

    path: Path

    def __fspath__(self) -> str:
        """Return the file's path, for `open` and the like."""
        return str(self.path)


class Picture(ShownFile):
    """A picture (PNG)."""

    def _repr_png_(self) -> bytes:
        return self.path.read_bytes()


class Video(ShownFile):
    """A video (MP4)."""

    def _repr_html_(self) -> str:
        content = base64.b64encode(self.path.read_bytes()).decode("ascii")
        return f'<video controls loop src="data:video/mp4;base64,{content}"></video>'


def run_html(run: Run) -> str:
    """Return a run's verdict as a table, and its contact sheet if one was drawn."""
    summary = run.summary
    words = "success" if summary.success else "no success"
    if not summary.complete:
        words = f"incomplete: {summary.reason}"
    title = f"<p><b>{_text(summary.scenario)}</b>: {_text(words)}</p>"
    rows = "".join(map(_row, summary.criteria))
    table = f"<table>{_HEAD}{rows}</table>" if rows else ""
    return f"{title}{table}{_sheet(run.folder / SHEET_FILE)}"


def _row(criterion: Criterion) -> str:
    cells = (
        criterion.name,
        criterion.reason or quantity(criterion.value, criterion.unit),
        bound_text(criterion),
        margin_text(criterion),
        criterion.word,
    )
    return f"<tr>{''.join(f'<td>{_text(cell)}</td>' for cell in cells)}</tr>"


def _text(text: str) -> str:
    return escape(legible(text, TEXT_LENGTH))


def _sheet(path: Path) -> str:
    if not path.is_file():
        return ""
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img alt="contact sheet" style="max-width:100%" src="data:image/png;base64,{content}">'


__all__ = ["Picture", "Video", "run_html"]
