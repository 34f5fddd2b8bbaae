"""An FMU that calls exit() ends the process as a failure, with whatever code it does so.

An FMU runs in this process, unless it is isolated. Rows that were flushed before stay, and the
recording says that it is incomplete.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from ...fmus.errors import SimulationError

_under_way: list[tuple[int, int, Path | None]] = []  # process, thread and folder of each run


@contextmanager
def exit_guard(folder: Path) -> Iterator[None]:
    """Make the process fail if it ends while the block runs."""
    _watch()
    place = folder.absolute() if folder.name else None  # a run without files has none
    run = (os.getpid(), threading.get_ident(), place)
    _under_way.append(run)
    try:
        yield
    finally:
        _under_way.remove(run)


def _fail(*_: object) -> None:
    folders = [folder for process, _, folder in _under_way if process == os.getpid()]
    if not folders:  # none, or those of the process that this one was forked from
        return
    for folder in folders:
        if folder is not None:
            with suppress(OSError):  # it holds what was recorded
                folder.rmdir()
        text = f"Error: {folder or 'a run'}: exit() was called, in an FMU for instance, which ends "
        os.write(2, f"{text}the whole process; with --isolate it has its own\n".encode())
    with suppress(Exception):
        sys.stdout.flush()
    os._exit(SimulationError.exit_code)


_handler = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_fail)
_key = ctypes.c_char()  # by whose address the handler is taken back


@cache
def _watch() -> None:
    """Call `_fail` when the process exits: exit() in C does not end Python first."""
    # glibc and macOS; with other C libraries a handler stays, and Python is gone when it is called.
    if sys.platform == "darwin" or "CS_GNU_LIBC_VERSION" in getattr(os, "confstr_names", ()):
        ctypes.CDLL(None)["__cxa_atexit"](_handler, None, ctypes.byref(_key))
        atexit.register(_end_python)


def _end_python() -> None:
    if threading.get_ident() in {thread for _, thread, _ in _under_way}:
        _fail()
    _under_way.clear()
    ctypes.CDLL(None)["__cxa_finalize"](ctypes.byref(_key))
