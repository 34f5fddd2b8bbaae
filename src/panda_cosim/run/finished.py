"""A finished run: its files, its verdict, and its pictures, which a notebook shows."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ..fmus.errors import TEXT_LENGTH, legible
from ..result.judging.criterion import cells
from ..result.judging.summary import Summary
from ..result.judging.verdict import Verdict
from ..result.judging.verdicts import STOPPED
from ..result.recording import Recording
from ..task.typed import typed

if TYPE_CHECKING:
    from ..result.pictures.canvas import ShownFigure
    from ..result.view.page import Inline
    from ..result.view.run import Shown

PLOT_FILE: Final = "plot.png"
FIGURE_FILE: Final = "figure.png"
SHEET_FILE: Final = "contact_sheet.png"
VIDEO_FILE: Final = "video.mp4"


@dataclass(frozen=True)
class ShownFile:
    """A file that a notebook shows as the last value of a cell; `open` takes it, too."""

    path: Path

    def __fspath__(self) -> str:
        """Return the file's path."""
        return str(self.path)


class Picture(ShownFile):
    """A picture (PNG)."""

    def _repr_png_(self) -> bytes:
        return self.path.read_bytes()


class Video(ShownFile):
    """A video (MP4)."""

    def _repr_html_(self) -> str:
        return f'<video controls loop src="{_data_url(self.path, "video/mp4")}"></video>'


@typed
@dataclass(frozen=True)
class Run:
    """A finished run, complete or not.

    Attributes:
        folder: The folder with its files.
        summary: Metrics and verdict.
        signal: Number of the signal that stopped it, or 0.
        warnings: Messages of the FMUs.
        in_memory: The recording, if it is short or was not kept in the folder.
    """

    folder: Path
    summary: Summary
    signal: int = 0
    warnings: tuple[str, ...] = ()
    in_memory: Recording | None = None

    @property
    def verdict(self) -> Verdict:
        """What it came to."""
        return STOPPED if self.signal else self.summary.verdict

    @property
    def exit_code(self) -> int:
        """Exit code of the command that ran it."""
        return self.verdict.exit_code + self.signal

    @property
    def recording(self) -> Recording:
        """The recording."""
        return Recording.open(self.folder) if self.in_memory is None else self.in_memory

    def plot(
        self,
        path: Path | str | None = None,
        *,
        signals: str = "",
        against: Sequence[Run] = (),
        width: str | None = None,
    ) -> ShownFigure:
        """Draw the page of curves, or chosen signals; returns the matplotlib figure.

            run.plot("fig.pdf", signals="plant.hand_xpos[3], tracking", against=[other])

        Args:
            path: File to write, .png, .pdf or .svg; None: the page is written to `plot.png` in the
                run's folder, and a figure of signals is only returned.
            signals: Signals in the words of criteria, separated by commas: `plant.qpos[1]`,
                `a - b`, `|a - b|`, or `tracking`, the distance between hand and command. Each has
                a panel. "": the page.
            against: Runs whose signals are drawn over this one's.
            width: Width of the figure of signals, such as "88mm", which it is by default.

        Raises:
            InputError: A signal is not recorded, or a file cannot be written.
        """
        from ..result.pictures.plot import draw, save  # noqa: PLC0415 - matplotlib takes its time

        runs = [run.recording for run in (self, *against)]
        figure = draw(runs, self.summary, signals, width)
        if path is not None or not signals:
            save(figure, Path(path or self.folder / PLOT_FILE))
        return figure

    def render(self, path: Path | str | None = None, *, camera: str = "overview") -> Video:
        """Draw the video; a notebook shows it.

        Args:
            path: Where to; None: `video.mp4` in the run's folder.
            camera: Name of a camera of the scene.
        """
        from ..result.pictures.video import render_video  # noqa: PLC0415 - slow to import

        return Video(render_video(self.recording, path or self.folder / VIDEO_FILE, camera=camera))

    def sheet(self, path: Path | str | None = None) -> Picture:
        """Draw the contact sheet; a notebook shows it, also with the run's table.

        Args:
            path: Where to; None: `contact_sheet.png` in the run's folder.
        """
        from ..result.pictures.sheet import contact_sheet  # noqa: PLC0415 - slow to import

        return Picture(contact_sheet(self.recording, path or self.folder / SHEET_FILE))

    def _repr_html_(self) -> str:
        """Return the verdict as a table, and the contact sheet if one was drawn."""
        summary, sheet = self.summary, self.folder / SHEET_FILE
        title = f"{summary.scenario}: {summary.brief}"
        heads = ("criterion", "measured", "required", "margin", "")
        table = html([title], heads, [cells(criterion) for criterion in summary.criteria])
        if not sheet.is_file():
            return table
        url = _data_url(sheet, "image/png")
        return f'{table}<img alt="contact sheet" style="max-width:100%" src="{url}">'

    def shown(self, name: str | None = None) -> Shown:
        """Return the run for the view.

        Args:
            name: Its name on the page; None: the folder's.
        """
        from ..result.view.page import show_source  # noqa: PLC0415 - slow to import

        name = name or self.folder.resolve().name
        return show_source(self.recording, name, summary=self.summary)

    def view(self, against: Run | None = None, *, height: int = 640) -> Inline:
        """Show the run in 3D: in a notebook the result is the page, inline.

        Args:
            against: Another run, shown as a ghost.
            height: Of the page in the notebook [px].
        """
        from ..result.view.page import Inline, view_page  # noqa: PLC0415 - slow to import

        runs = [self.shown("run"), against.shown("other run")] if against else [self.shown()]
        return Inline(view_page(runs), height)


def html(
    lines: Iterable[str], heads: Sequence[str] = (), rows: Sequence[Sequence[str]] = ()
) -> str:
    """Return paragraphs, and a table if it has rows, as a notebook shows them."""
    above = "".join(f"<p>{_text(line)}</p>" for line in lines)
    cells = [("th", heads), *(("td", row) for row in rows)]
    table = "".join(
        f"<tr>{''.join(f'<{tag}>{_text(text)}</{tag}>' for text in texts)}</tr>"
        for tag, texts in cells
    )
    return above + (f"<table>{table}</table>" if rows else "")


def _text(text: str) -> str:
    from html import escape  # noqa: PLC0415 - only a notebook needs it

    return escape(legible(text, TEXT_LENGTH))


def _data_url(path: Path, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
