"""Output for people: results on standard output, progress and messages on standard error."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from typing import Any, Protocol

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.markup import escape
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from ...fmus.messages import printable


class Update(Protocol):
    """Function that shows progress."""

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` is done."""

    def say(self, text: str, style: str | None = "dim") -> None:
        """Print a line above the progress."""


PLAIN_WIDTH = 160  # characters per line in a file or a pipe
WIDEST = 10_000  # characters of a table's row
FOLDED = 12  # characters to which a column that may wrap is narrowed at most
COLUMN_GAP = 3  # characters between two columns
LINE_INTERVAL = 5.0  # [s] between two lines of progress in a file
LONGEST = 4000  # characters of an error
DRAW_INTERVAL = 0.1  # [s] between two updates of a progress bar


class QuietConsole(Console):
    """A console that shows foreign text as text.

    Control characters, which a terminal would act on, are shown as escapes. Once its reader, such
    as `head`, has ended, it continues without output.
    """

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Render text; control characters of rich's own stay."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                lines = map(printable, segment.text.split("\n"))
                yield Segment("\n".join(lines), segment.style)

    def on_broken_pipe(self) -> None:
        """Discard all further output; the work goes on, and its exit code stays."""
        stream = sys.stderr if self.stderr else sys.stdout
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _console(*, stderr: bool) -> Console:
    """Return a console on the present standard output or error."""
    console = QuietConsole(stderr=stderr, highlight=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = PLAIN_WIDTH
    return console


def show(item: Any, style: str | None = None) -> None:
    """Print a result: text without wrapping, or a rich object; nothing is cut off."""
    console = _console(stderr=False)
    if isinstance(item, str):
        console.print(item, style=style, markup=False, soft_wrap=True)
        return
    if isinstance(item, Group):
        for part in item.renderables:
            show(part)
        return
    if isinstance(item, Table):  # in a narrower terminal, which then breaks the lines
        console.width = max(console.width, _least_width(console, item))
    console.print(item)


def _least_width(console: Console, shown: Table) -> int:
    """Width that a table needs: rich would cut off what may not wrap."""
    options, total = console.options.update(width=WIDEST), 0
    for column in shown.columns:
        cells = [console.measure(cell, options=options) for cell in (column.header, *column.cells)]
        longest, word = (max(getattr(c, side) for c in cells) for side in ("maximum", "minimum"))
        narrowed = min(longest, FOLDED) if column.overflow == "fold" else word
        total += (longest if column.no_wrap else narrowed) + COLUMN_GAP
    return total


def show_json(result: object) -> None:
    """Print a result as JSON; numbers that are not finite become null."""
    show(json.dumps(_plain(result), indent=2, allow_nan=False))


def _plain(value: Any) -> Any:
    """Return a value in a form for JSON."""
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
    """Print a line about the work to standard error."""
    _console(stderr=True).print(text, style=style, markup=False, soft_wrap=True)


def warn(text: str) -> None:
    """Print a warning as one line on standard error."""
    _headed("Warning", "bold yellow", text)


def complain(text: str) -> None:
    """Print an error as one line on standard error; of an endless one, its two ends."""
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
    _headed("Error", "bold red", text)


def _headed(head: str, style: str, text: str) -> None:
    line = " ".join(text.split())
    _console(stderr=True).print(Text.assemble((f"{head}:", style), f" {line}"), soft_wrap=True)


def as_cell(text: str) -> str:
    """Return foreign text for a cell of a table: it is neither markup nor control characters."""
    return escape(printable(text))


def table(columns: Sequence[str], *, right: Sequence[str] = (), title: str | None = None) -> Table:
    """Return an empty table."""
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
            "\n".join(map(as_cell, name.split("\n"))),
            justify="right" if name in right else "left",
            no_wrap=name == column,
            overflow="fold",
        )
    return made


@contextmanager
def progress(label: str) -> Iterator[Update]:
    """Show progress: as a bar with the time left, or as plain lines if output goes to a file."""
    console = _console(stderr=True)
    if not console.is_terminal:
        yield _Lines(label)
        return
    from rich import progress as rich_progress  # noqa: PLC0415 - slow, and no help needs it

    class TimeLeft(rich_progress.ProgressColumn):
        """Shows the time left, and at the end the time taken."""

        def render(self, task: rich_progress.Task) -> Text:
            """Return the text after the bar."""
            if task.finished:
                return Text(f"{task.finished_time or 0.0:.1f} s")
            left = task.time_remaining
            return Text("" if left is None else f"{left:.0f} s left")

    bar = rich_progress.Progress(
        rich_progress.TextColumn("{task.description}"),
        rich_progress.BarColumn(),
        rich_progress.TaskProgressColumn(),
        TimeLeft(),
        console=console,
        auto_refresh=False,  # a refreshing thread would disturb real-time pacing
    )
    with bar:
        yield _Bar(bar, label)


class _Bar:
    """Draws a bar, at most ten times a second."""

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
            self._first = now, done  # earlier work, such as a build, is not part of the estimate
        began, before = self._first
        share = f"{done / total:.0%}" if total else "0%"
        if before < done < total and share != "0%" and now - self._printed >= LINE_INTERVAL:
            self._printed = now
            left = (now - began) * (total - done) / (done - before)
            tell(f"{self._label}: {share}, about {left:.0f} s left")
