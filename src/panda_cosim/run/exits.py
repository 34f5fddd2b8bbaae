"""An FMU that calls exit() ends the process as a failure.

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

from ..fmus.errors import SimulationError

_under_way: list[tuple[int, Path | None]] = []  # thread and folder of each run of this process
os.register_at_fork(after_in_child=_under_way.clear)


@contextmanager
def exit_guard(folder: Path) -> Iterator[None]:
    """Make the process fail if it ends while the block runs."""
    _watch()
    run = (threading.get_ident(), folder.absolute() if folder.name else None)
    _under_way.append(run)
    try:
        yield
    finally:
        if run in _under_way:  # not in a process that was forked since
            _under_way.remove(run)


def _fail(*_: object) -> None:
    if not _under_way:
        return
    for _thread, folder in _under_way:
        if folder is not None:
            with suppress(OSError):  # it holds what was recorded
                folder.rmdir()
        text = f"Error: {folder or 'a run'}: exit() was called, by an FMU for instance, which ends "
        os.write(2, f"{text}the whole process; --isolate gives each FMU its own\n".encode())
    with suppress(Exception):
        sys.stdout.flush()
    os._exit(SimulationError.exit_code)


@cache
def _watch() -> object:
    """Call `_fail` when the process exits: exit() in C does not end Python first."""
    handler = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_fail)
    key = ctypes.c_char()  # by whose address the handler is taken back

    def end_python() -> None:
        if threading.get_ident() in [thread for thread, _ in _under_way]:
            _fail()
        _under_way.clear()
        ctypes.CDLL(None)["__cxa_finalize"](ctypes.byref(key))

    # glibc and macOS; with other C libraries a handler stays, and Python is gone when it is called.
    if sys.platform == "darwin" or "CS_GNU_LIBC_VERSION" in getattr(os, "confstr_names", ()):
        ctypes.CDLL(None)["__cxa_atexit"](handler, None, ctypes.byref(key))
        atexit.register(end_python)
    return handler  # which the cache keeps
