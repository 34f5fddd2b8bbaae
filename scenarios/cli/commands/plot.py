"""`panda-cosim plot`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ....fmus.atomic import check_replaceable
from ...recording import Recording
from ..console import show
from ..options import Overwrite, RunFolder
from ..outcome import PLOT_FILE, draw_plot


def command(
    run: RunFolder,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE.png|DIR",
            help=f"File to write, or the folder for {PLOT_FILE}. Default: the run's folder.",
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Plot a run's signals on one page.

    The page is plot.png, drawn from the recording.

    ```
    panda-cosim plot runs/first
    ```
    """
    recording = Recording.open(run, in_order=True)
    path = out if out is not None else recording.path.parent
    if path.suffix.lower() != ".png" or path.is_dir():
        path /= PLOT_FILE
    check_replaceable(path, overwrite=overwrite)
    show(str(draw_plot(recording, path)))
