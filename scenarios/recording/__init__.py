"""Recordings: one row per tick, written during a run and read back.

`Recorder` appends to `recording.arrows`, where all flushed rows survive the process, and turns it
into `recording.parquet` at the end. `Recording` reads either.
"""

from .memory import MemoryRecorder
from .reader import Recording
from .recorder import Recorder
from .storage import Column

AnyRecorder = Recorder | MemoryRecorder

__all__ = ["AnyRecorder", "Column", "MemoryRecorder", "Recorder", "Recording"]
