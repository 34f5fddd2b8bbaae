"""`panda-cosim bench`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ....fmus.atomic import check_replaceable, replacing
from ...benchmark import bench, tables
from ...files import marked_json
from ..console import show, tell
from ..options import Kind, Overwrite


def command(
    kind: Kind = "native",
    json: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Also write the numbers to this file."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure what a co-simulation step costs.

    Compares our master's step with MuJoCo alone, stepping the scene as it is drawn and the model
    that the FMU steps, and with a plain FMPy loop over the same FMUs. Takes a minute or two.

    ```
    panda-cosim bench
    panda-cosim bench --kind python --json bench.json
    ```
    """
    if json is not None:
        check_replaceable(json, overwrite=overwrite)
    tell("Measuring for a minute or two; do not use the machine meanwhile ...")
    result = bench(kind=kind)
    show(tables(result))
    if json is not None:
        with replacing(json) as path:
            path.write_text(marked_json(result.to_json()), encoding="utf-8")
        show(str(json))
