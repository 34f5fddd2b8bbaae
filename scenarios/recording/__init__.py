"""Recordings: one row a tick, written while a run goes on, and read again.

`Recorder` appends to `recording.arrows`, which keeps every row up to the last flush whatever
happens to the process, and turns it into `recording.parquet` at the end. `Recording` reads either.
"""

from scenarios.recording.reader import Recording
from scenarios.recording.recorder import Recorder
from scenarios.recording.storage import Column

__all__ = ["Column", "Recorder", "Recording"]
