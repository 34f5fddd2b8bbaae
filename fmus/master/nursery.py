"""The process from which those of isolated FMUs are forked. It imports for a tenth of a second."""

from __future__ import annotations

import json
import os
import sys
from typing import Final

from ..errors import InputError
from ..processes import Nursery

_CODE: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from panda_cosim.fmus.master.remote_slave import nurse_slaves; "
    "nurse_slaves(*map(int, sys.argv[2:]))"
)
_ahead: list[Nursery] = []


def start_ahead() -> None:
    """Start the one that `nursery` returns next, so that it imports while this process does."""
    _ahead.append(nursery())


def nursery() -> Nursery:
    """Start it, unless one was started ahead; who calls this ends it."""
    if not hasattr(os, "memfd_create"):
        raise InputError("--isolate: not on this platform; must be Linux")
    if _ahead:
        return _ahead.pop()
    return Nursery("-u", "-c", _CODE, json.dumps([folder for folder in sys.path if folder]))
