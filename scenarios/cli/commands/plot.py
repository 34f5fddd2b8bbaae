"""`panda-cosim plot`."""

from __future__ import annotations

from ...recording import Recording
from ..console import show
from ..drawing import draw_plot
from ..options import OutFolder, RunFolder


def command(run: RunFolder, out: OutFolder = None) -> None:
    """Plot a run's signals on one page.

    The page is plot.png, drawn from the recording.

    ```
    panda-cosim plot runs/first
    ```
    """
    recording = Recording.open(run, in_order=True)
    show(str(draw_plot(recording, out if out is not None else recording.path.parent)))
