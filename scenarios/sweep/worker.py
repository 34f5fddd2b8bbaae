"""Runs rows in a separate process: `python -m panda_cosim...worker SOCKET PARENT FOLDER`.

It first receives a pickled job, and answers None when ready. It then receives tasks one at a time,
and answers each with its result. The process has its own session, so that Ctrl-C reaches only the
parent.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

from ...fmus.processes import end_with


def main(socket: int, parent: int, folder: Path) -> None:
    """Work until the connection ends."""
    end_with(parent)
    from .row import RowRunner  # noqa: PLC0415 - heavy; after the parent's end is provided for

    connection = Connection(socket)
    with suppress(EOFError, BrokenPipeError):
        runner = RowRunner(connection.recv(), folder)
        connection.send(None)
        while True:
            task = connection.recv()
            connection.send(runner.run(task))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
