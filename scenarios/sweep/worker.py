"""Runs rows in a separate process: `python -P -m panda_cosim...worker SOCKET PARENT`.

It first receives a pickled job, and answers None when ready. It then receives tasks one at a time,
and answers each with its result. The process has its own session, so that Ctrl-C reaches only the
parent.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from multiprocessing.connection import Connection

from ...fmus.packaging.cache import cache_folder
from ...fmus.packaging.scratch import SWEEP, scratch_folder
from ..regression.worker import end_with


def main(socket: int, parent: int) -> None:
    """Work until the connection ends."""
    end_with(parent)
    from .row import RowRunner  # noqa: PLC0415 - heavy; after the parent's end is provided for

    connection = Connection(socket)
    with (
        scratch_folder(cache_folder(), SWEEP) as folder,
        suppress(EOFError, BrokenPipeError),
    ):
        runner = RowRunner(connection.recv(), folder)
        connection.send(None)
        while True:
            task = connection.recv()
            connection.send(runner.run(task))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
