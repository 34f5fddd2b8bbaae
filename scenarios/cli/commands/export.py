"""`panda-cosim export`."""

from __future__ import annotations

from ...recording import Recording
from ..console import show
from ..options import CsvFile, Overwrite, RunFolder


def command(run: RunFolder, file: CsvFile, overwrite: Overwrite = False) -> None:
    """Write a recording as CSV.

    One column per signal and one row per tick, in full precision (RFC 4180).

    ```
    panda-cosim export runs/first first.csv
    ```
    """
    recording = Recording.open(run, in_order=True)
    recording.to_csv(file, overwrite=overwrite)
    show(f"{file}: {recording.rows} rows, {len(recording.columns)} columns")
