"""The command line `panda-cosim`: the program in app.py, one module per command in commands/."""

from __future__ import annotations

from .app import app, main

__all__ = ["app", "main"]
