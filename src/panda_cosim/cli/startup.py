"""How the process is set up, so that a command starts and ends quickly; nothing else depends on it.

Processor time of `run --no-video`, 0.74 s in all, that each of these saves:

| what | saves |
| --- | --- |
| no search for garbage while modules are imported (`begin`, `imported`) | 0.04 s |
| none at the end, in what is freed with the process anyway (`end`) | 0.18 s |
| what closes and draws a run is imported while FMUs in C step (`meanwhile`) | 0.1 s of waiting |
| the process of isolated FMUs imports beside this one (`start_isolation`) | 0.1 s of waiting |
| no search for pydantic's plugins, no threads of OpenBLAS (`environment`) | 0.03 s |
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable
from contextlib import suppress


def begin() -> None:
    """Before anything is imported."""
    gc.disable()


def environment() -> None:
    """Set what this process, and those that it starts, read when they import libraries."""
    # They must never import from the working directory.
    os.environ["PYTHONSAFEPATH"] = "1"
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def keep_output() -> None:
    """Keep standard output for this program: what FMUs print in C goes to standard error."""
    with suppress(OSError):  # it is closed
        own = os.fdopen(os.dup(1), "w", encoding=sys.stdout.encoding)
        os.dup2(2, 1)
        sys.stdout = own


def start_isolation() -> None:
    """Before a command is imported that runs each FMU in a process of its own."""
    from ..fmus.master.nursery import start_ahead  # noqa: PLC0415 - few runs need it

    start_ahead()


def imported() -> None:
    """Once a command's modules are there: they stay to the end, and are not searched again."""
    if not gc.isenabled():
        gc.freeze()
        gc.set_threshold(50_000)  # objects; a run has little garbage
        gc.enable()


def meanwhile(load: Callable[[], object]) -> None:
    """Call in a thread while FMUs in C step; what fails there fails again where it is used."""
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 - only a run needs it

    sys.setswitchinterval(1e-5)  # [s] else each return from C waits up to 5 ms for this thread
    ThreadPoolExecutor(1).submit(load)


def end() -> None:
    """Before the process exits."""
    if "ompl" not in sys.modules:  # which lists what it misses then
        gc.freeze()
