"""`panda-cosim replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...run.options import Options
from ...run.replay import read_session, replay
from ...run.result import Run
from ..console import Update
from ..options import (
    Isolate,
    Json,
    Junit,
    OutRun,
    Plot,
    StepTimeout,
    Video,
    View,
)
from ..outcome import Output, conclude, simulate


def command(  # noqa: PLR0913 - one for each option
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN",
            help="Folder of the run, or the journal session.jsonl in it.",
            show_default=False,
        ),
    ],
    out: OutRun = None,
    video: Video = True,
    plot: Plot = None,
    view: View = True,
    isolate: Isolate = False,
    step_timeout: StepTimeout = None,
    junit: Junit = None,
    json: Json = False,
) -> None:
    """Repeat a run of `live` or of a Session, bit for bit.

    Scenario, FMUs and actions are those of the run's journal. The results are those of
    `panda-cosim run`, which takes `--session RUN`, too.

    ```
    panda-cosim replay runs/my-session
    ```
    """
    scenario, options = read_session(run, Options(isolate=isolate, step_timeout=step_timeout))
    output = Output(out, video, plot, view, junit, json)

    def repeat(folder: Path, update: Update) -> Run:
        return replay(run, folder, options, progress=update)

    conclude(simulate(scenario, options.kind, output, repeat), output)
