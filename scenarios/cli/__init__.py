"""The command line `panda-cosim`: the program in app.py, one module per command in commands/."""

from __future__ import annotations

import gc
import sys

from .interrupts import INTERRUPTS, ending, exit_code


def main() -> None:
    """Run the program; the console script's entry."""
    gc.disable()  # until a command is imported: it would search modules for garbage
    try:
        ending.listen()
        from .app import run_program  # noqa: PLC0415 - Ctrl-C may come while this is imported

        run_program()
    except INTERRUPTS as error:
        sys.exit(exit_code(error))


__all__ = ["main"]
