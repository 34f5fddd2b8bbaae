"""Recordings: one row per tick, written during a run and read back.

`Recorder` appends to `recording.arrows`, where all flushed rows survive the process, and turns it
into `recording.parquet` at the end. `Recording` reads either.
"""

from .reader import Recording, by_rows
from .recorder import MemoryRecorder, Recorder
from .storage import Column

__all__ = ["Column", "MemoryRecorder", "Recorder", "Recording", "by_rows"]
