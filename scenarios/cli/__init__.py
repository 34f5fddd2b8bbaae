"""The command line `panda-cosim`: one module for each group of commands.

Nothing heavy is imported here: each command imports what it needs when it is called, so that
`--help` is there at once.
"""

from __future__ import annotations

from . import about, outputs, proof, running, testing
from .app import app, main

__all__ = ["app", "main"]

for group in (running, testing, outputs, about, proof):
    group.register(app)
