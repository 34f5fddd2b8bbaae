"""What the tests of `scenarios.work` have processes do."""

import ctypes
import os
import signal
import sys
import time
from pathlib import Path


def told(argument: object) -> tuple[object, int, int, bool]:
    """Return the argument, the process, its session, and whether it has loaded pytest."""
    print("printed")
    return argument, os.getpid(), os.getsid(0), "pytest" in sys.modules


def end(how: str) -> None:
    """End this process."""
    if how == "signal":
        os.kill(os.getpid(), signal.SIGSEGV)
    if how == "exit in C":
        ctypes.CDLL(None).exit(0)
    if how == "exception":
        raise RuntimeError(how)
    os._exit(0)


def end_once(mark: Path) -> str:
    """End this process, unless that was done before."""
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def sleep(mark: Path) -> None:
    """Say which process this is, and sleep."""
    mark.write_text(str(os.getpid()))
    time.sleep(100.0)
