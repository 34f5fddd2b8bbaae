"""Output for people: results on standard output, progress and messages on standard error."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.segment import Segment
from rich.text import Text

from ..fmus.errors import printable

if TYPE_CHECKING:
    from rich.table import Table

Item: TypeAlias = "str | Text | Table"  # that is shown
PLAIN_WIDTH = 160  # characters per line in a file or a pipe
WIDEST = 10_000  # characters of a table's row
FOLDED = 12  # characters to which a column that may wrap is narrowed at most
COLUMN_GAP = 3  # characters between two columns
LINE_INTERVAL = 5.0  # [s] between two lines of progress in a file


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
    console = QuietConsole(stderr=stderr, highlight=False, emoji=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = PLAIN_WIDTH
    return console


def show(item: Item, style: str | None = None, *, most: int = WIDEST) -> None:
    """Print a result: text without wrapping, or a table; nothing is cut off.

    With `most`, text is wrapped, too, and a table as narrow, if what may not wrap is.
    """
    console = _console(stderr=False)
    console.width = min(console.width, most)
    if isinstance(item, str | Text):
        console.print(item, style=style, markup=False, soft_wrap=most == WIDEST)
    else:  # a narrower terminal breaks the lines
        console.width = max(console.width, _least_width(console, item))
        console.print(item)


def show_result(content: object, items: Iterable[Item], *, json: bool, most: int = WIDEST) -> None:
    """Print a result: its content as JSON, or else the texts and tables that people read."""
    if json:
        show_json(content)
        return
    for item in items:
        show(item, most=most)


def _least_width(console: Console, shown: Table) -> int:
    """Width that a table needs: rich would cut off what may not wrap."""
    options, total = console.options.update(width=WIDEST), 0
    for column in shown.columns:
        cells = (column.header, *column.cells)
        longest = max(console.measure(cell, options=options).maximum for cell in cells)
        total += (longest if column.no_wrap else min(longest, FOLDED)) + COLUMN_GAP
    return total


def show_json(result: object) -> None:
    """Print a result as JSON; numbers that are not finite become null."""
    from pydantic_core import to_jsonable_python  # noqa: PLC0415 - slow, and no help needs it

    plain = to_jsonable_python(result, fallback=str, inf_nan_mode="null")
    show(dumps(plain, indent=2, allow_nan=False))


def show_file(path: Path, *, open_page: bool = False) -> None:
    """Print the name and size of a file that was written, and open it in the browser."""
    size = path.stat().st_size
    show(f"{path}  " + (f"{size / 1e6:.2f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"))
    if open_page:
        import webbrowser  # noqa: PLC0415 - slow, and no help needs it

        webbrowser.open(path.resolve().as_uri())


def tell(text: str, style: str | None = "dim") -> None:
    """Print a line about the work to standard error."""
    _console(stderr=True).print(text, style=style, markup=False, soft_wrap=True)


def warn(text: str) -> None:
    """Print a warning as one line on standard error."""
    _headed("Warning", "bold yellow", text)


def complain(text: str) -> None:
    """Print an error as one line on standard error."""
    _headed("Error", "bold red", text)


def _headed(head: str, style: str, text: str) -> None:
    line = " ".join(text.split())
    _console(stderr=True).print(Text.assemble((f"{head}:", style), f" {line}"), soft_wrap=True)


def _cell(content: object) -> Text:
    """Return a table's cell; what comes from elsewhere is neither markup nor control characters."""
    return content if isinstance(content, Text) else Text(printable(str(content)))


def table(
    columns: Sequence[str],
    rows: Iterable[Iterable[object]] = (),
    *,
    right: Sequence[str] = (),
    title: str = "",
) -> Table:
    """Return a table; a column whose heading ends in * may wrap. Texts are shown as they are."""
    from rich.table import Table  # noqa: PLC0415 - a run imports it while its FMUs step

    result = Table(
        box=box.SIMPLE_HEAD,
        title=escape(title),
        title_justify="left",
        title_style="italic",
        show_edge=False,
        pad_edge=False,
    )
    for column in columns:
        name = column.removesuffix("*")
        result.add_column(
            Text("\n".join(map(printable, name.split("\n")))),
            justify="right" if name in right else "left",
            no_wrap=name == column,
            overflow="fold",
        )
    for row in rows:
        result.add_row(*map(_cell, row))
    return result


class Update:
    """Shows progress as lines, one every few seconds."""

    def __init__(self, console: Console, label: str) -> None:
        self._console, self._label = console, label
        self._printed = time.monotonic()
        self._first: tuple[float, int] | None = None  # when progress began [s], and at what count
        self.say(f"{label} ...")

    def say(self, text: str, style: str | None = "dim") -> None:
        """Print a line, above the bar if there is one."""
        self._console.print(text, style=style, markup=False, soft_wrap=True)

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` is done, unless the last line is recent."""
        now = time.monotonic()
        if self._first is None:
            self._first = now, done  # earlier work, such as a build, is not part of the estimate
        began, before = self._first
        if before < done < total and now - self._printed >= LINE_INTERVAL:
            self._printed = now
            left = (now - began) * (total - done) / (done - before)
            self.say(f"{self._label}: {done / total:.0%}, about {left:.0f} s left")


class _Bar(Update):
    """Draws a bar."""

    def __init__(self, bar: Any, label: str) -> None:
        self._console, self._bar, self._task = bar.console, bar, bar.add_task(label, total=None)

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` is done."""
        self._bar.update(self._task, completed=done, total=total, refresh=True)


@contextmanager
def progress(label: str) -> Iterator[Update]:
    """Show progress: as a bar with the time left, or as plain lines if output goes to a file."""
    console = _console(stderr=True)
    if not console.is_terminal:
        yield Update(console, label)
        return
    from rich.progress import Progress  # noqa: PLC0415 - slow, and no help needs it

    # A refreshing thread would disturb real-time pacing.
    with Progress(console=console, auto_refresh=False) as bar:
        yield _Bar(bar, label)
