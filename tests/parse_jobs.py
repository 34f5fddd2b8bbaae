"""Python source that threads parse at one moment, in a process of its own."""

from __future__ import annotations

import gc
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from panda_cosim.fmus.sources.python_fmu import parse_file


def in_threads(path: str, times: int) -> int:
    """Parse a file in four threads that change places within it; returns how often."""

    def change_places(phase: str, _info: object) -> None:
        if phase == "start":
            time.sleep(0)

    gc.callbacks.append(change_places)
    gc.set_threshold(20)  # a syntax tree has thousands of nodes
    with ThreadPoolExecutor(4) as pool:
        return len(list(pool.map(parse_file, [Path(path)] * times)))
