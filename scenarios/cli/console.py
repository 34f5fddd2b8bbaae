"""What a person sees in a terminal: results on standard output, progress on standard error."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from typing import Any, Protocol

from rich import box
from rich import progress as rich_progress
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text


class Update(Protocol):
    """Takes how much is done, and how much there is."""

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` is done."""

    def say(self, text: str, style: str | None = "dim") -> None:
        """Print a line above what is drawn."""


PLAIN_WIDTH = 160  # characters of a line where output goes to a file or a pipe
LINE_INTERVAL = 5.0  # [s] between two plain lines of progress
DRAW_INTERVAL = 0.1  # [s] between two drawings of a progress bar


class QuietConsole(Console):
    """A console that goes on without output when its reader has gone, as `head` does."""

    def on_broken_pipe(self) -> None:
        """Send all further output nowhere; the work and its exit code stay."""
        stream = sys.stderr if self.stderr else sys.stdout
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _console(*, stderr: bool) -> Console:
    """Return a console on what standard output or error is now."""
    console = QuietConsole(stderr=stderr, highlight=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = PLAIN_WIDTH
    return console


def show(item: Any, style: str | None = None) -> None:
    """Print a result: text as it is, on one line however long, or a rich object."""
    if isinstance(item, str):
        _console(stderr=False).print(item, style=style, markup=False, soft_wrap=True)
    else:
        _console(stderr=False).print(item)


def show_json(result: object) -> None:
    """Print a result as JSON; a number that is not finite is null."""
    show(json.dumps(_plain(result), indent=2, allow_nan=False))


def _plain(value: Any) -> Any:
    """Return a value as JSON holds it."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def tell(text: str, style: str | None = "dim") -> None:
    """Print what is going on, to standard error."""
    _console(stderr=True).print(text, style=style, markup=False, soft_wrap=True)


def warn(text: str) -> None:
    """Print a warning, in one line on standard error."""
    _headed("Warning", "bold yellow", text)


def complain(text: str) -> None:
    """Print an error, in one line on standard error."""
    _headed("Error", "bold red", text)


def _headed(head: str, style: str, text: str) -> None:
    line = "".join(c if c.isprintable() else " " for c in " ".join(text.split()))
    _console(stderr=True).print(Text.assemble((f"{head}:", style), f" {line}"), soft_wrap=True)


def table(columns: Sequence[str], *, right: Sequence[str] = (), title: str | None = None) -> Table:
    """Return an empty table.

    Args:
        columns: Headings; one that ends in `*` may be wrapped, the others not.
        right: Headings of the columns that are set flush right.
        title: Above it.
    """
    made = Table(
        box=box.SIMPLE_HEAD,
        title=title,
        title_justify="left",
        title_style="italic",
        show_edge=False,
        pad_edge=False,
    )
    for column in columns:
        name = column.removesuffix("*")
        made.add_column(
            escape(name),
            justify="right" if name in right else "left",
            no_wrap=name == column,
            overflow="fold",
        )
    return made


@contextmanager
def progress(label: str) -> Iterator[Update]:
    """Show how far a piece of work is: a bar with the time left, or plain lines for a file.

    Args:
        label: What is done.

    Yields:
        A function to call with what is done and what there is.
    """
    console = _console(stderr=True)
    if not console.is_terminal:
        yield _Lines(label)
        return
    bar = rich_progress.Progress(
        rich_progress.TextColumn("{task.description}"),
        rich_progress.BarColumn(),
        rich_progress.TaskProgressColumn(),
        _TimeLeft(),
        console=console,
        auto_refresh=False,  # a thread of its own would disturb real-time pacing
    )
    with bar:
        yield _Bar(bar, label)


class _TimeLeft(rich_progress.ProgressColumn):
    """Shows the time left, and at the end the time that it took."""

    def render(self, task: rich_progress.Task) -> Text:
        """Return the text behind the bar."""
        if task.finished:
            return Text(f"{task.finished_time or 0.0:.1f} s")
        left = task.time_remaining
        return Text("" if left is None else f"{left:.0f} s left")


class _Bar:
    """Draws a bar, no more often than the eye can follow."""

    def __init__(self, bar: Any, label: str) -> None:
        self._bar = bar
        self._task = bar.add_task(label, total=None)
        self._drawn = 0.0
        bar.refresh()

    def say(self, text: str, style: str | None = "dim") -> None:
        """Print a line above the bar."""
        self._bar.console.print(text, style=style, markup=False, soft_wrap=True)

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` is done."""
        self._bar.update(self._task, completed=done, total=total)
        if done >= total or time.monotonic() - self._drawn >= DRAW_INTERVAL:
            self._drawn = time.monotonic()
            self._bar.refresh()


class _Lines:
    """Prints a line every few seconds."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._printed = time.monotonic()
        self._first: tuple[float, int] | None = None  # when progress began [s], and at what count
        tell(f"{label} ...")

    def say(self, text: str, style: str | None = "dim") -> None:
        """Print a line."""
        tell(text, style)

    def __call__(self, done: int, total: int) -> None:
        """Print how much is done, unless the last line is recent."""
        now = time.monotonic()
        if self._first is None:
            self._first = now, done  # what came before, such as a build, says nothing about speed
        began, before = self._first
        share = f"{done / total:.0%}" if total else "0%"
        if before < done < total and share != "0%" and now - self._printed >= LINE_INTERVAL:
            self._printed = now
            left = (now - began) * (total - done) / (done - before)
            tell(f"{self._label}: {share}, about {left:.0f} s left")
