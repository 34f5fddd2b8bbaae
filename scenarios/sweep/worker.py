"""Runs rows in a process of its own: `python -P -m panda_cosim...worker SOCKET PARENT`.

A pickled job comes first, which None answers once it is ready. Then tasks come one at a time, and
each is answered by what it came to. The process has a session of its own, so that Ctrl-C reaches
who asked for the work, and not the work.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from multiprocessing.connection import Connection

from ..regression.worker import end_with


def main(socket: int, parent: int) -> None:
    """Work until the connection ends."""
    end_with(parent)
    from .row import RowRunner  # noqa: PLC0415 - heavy; after the parent's end is provided for

    connection = Connection(socket)
    with RowRunner(connection.recv()) as runner, suppress(EOFError, BrokenPipeError):
        connection.send(None)
        while True:
            task = connection.recv()
            connection.send(runner.run(task))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
