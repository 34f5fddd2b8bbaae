"""The client of a scenario beside its run: where it finds the FMUs, and how both end together.

An FMU that listens has the parameters `LISTENING`. It waits in a step for what the program sends,
and ends the simulation once the program has left. It may wait for ever, so a thread looks after it:

- The program has ended: an FMU to which it never connected gets a connection that is closed at
  once, and takes this for a client that has left. Where no FMU listens, the run ends.
- The run is to stop: a program that keeps an FMU waiting is killed, which closes its connections.
"""

from __future__ import annotations

import socket
import sys
import threading
import time as clock
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Final, Self

from ..fmus.atomic import cache_folder, held
from ..fmus.errors import InputError, SimulationEndedError, SimulationError, one_line, printable
from ..fmus.master.calls import without_traceback
from ..fmus.master.master import Master
from ..fmus.processes import Program
from .prepare import PATIENCE, Prepared
from .stopping import StopRequest

ADDRESSES: Final = tuple(f"127.0.1.{number}" for number in range(1, 255))  # of runs side by side
LOCAL: Final = "127.0.0.1"  # the address that a client is told where no FMU listens
LOOKING: Final = 0.05  # [s] between two looks at the program and the stop
GRACE: Final = 0.5  # [s] for a step to end after the run has been asked to stop
DYING: Final = 2.0  # [s] for a program to end after an FMU has failed
SHOWN: Final = 3  # last lines of a program that failed


@contextmanager
def addressed(prepared: Prepared) -> Iterator[Prepared]:
    """Choose where FMUs listen: if the client is told, the first address that no run uses."""
    client, listening = prepared.scenario.client, prepared.listening
    if not (client and client.has_address and listening):
        yield prepared
        return
    ports = [port for _, port in listening.values()]
    first = next(address for address, _ in listening.values())
    for address in (first, *ADDRESSES):
        with ExitStack() as stack:
            file = cache_folder() / f"address-{address}"
            file.touch()
            if stack.enter_context(held(file)) and _is_free(address, ports):
                yield replace(prepared, address=address)
                return
    raise InputError(f"[client]: ports {ports} are in use at {first} and 127.0.1.1 to 254")


def _is_free(address: str, ports: list[int]) -> bool:
    """Whether nobody listens at some ports."""
    for port in ports:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((address, port))
            except OSError:
                return False
    return True


class Client:
    """The program of a scenario, from when its FMUs are open to the end of the run.

    `Execution.open` starts one; it is a context manager, which ends the program with all that it
    has started. What it prints is passed on if it `tells`, and its last lines explain a failure.
    """

    def __init__(self, prepared: Prepared, *, tells: bool = True) -> None:
        scenario, self._listening = prepared.scenario, prepared.listening
        assert scenario.client is not None
        addresses = [address for address, _ in self._listening.values()]
        folder = scenario.folder or Path()
        words = scenario.client.words(folder, (*addresses, LOCAL)[0])
        self.left = False  # whether its end has ended the run, where no FMU listens
        self._program = Program(words, folder, _tell if tells else lambda _: None)

    def __enter__(self) -> Self:
        """Return it."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self._program.end()

    @property
    def unfinished(self) -> str:
        """Say that it has not ended yet, or ""."""
        if self._program.ended() is not None:
            return ""
        return "the client still ran at the scenario's end; a longer `duration` gives it more time"

    @contextmanager
    def beside(self, master: Master, stop: StopRequest) -> Iterator[None]:
        """Look after it while the FMUs step within this; a program that failed is an error."""
        done = threading.Event()
        watch = threading.Thread(target=self._watch, args=(master, stop, done), daemon=True)
        watch.start()
        try:
            yield
        except SimulationError as error:
            if code := self._program.ended(DYING):
                error.message += f"; {self._how(code)}"
            raise
        finally:
            done.set()
            watch.join()

    def _watch(self, master: Master, stop: StopRequest, done: threading.Event) -> None:
        ended: float | None = None
        while not done.wait(LOOKING):
            stop.poll()
            if stop.reason:
                if not done.wait(GRACE):
                    self._program.end()
                    self._knock()
                return
            if ended is None and self._program.ended() is not None:
                ended = clock.monotonic()
                self._knock()
            late = ended is not None and clock.monotonic() - ended > PATIENCE
            if late or (ended is not None and not self._listening):
                self.left = master.stop_requested = True
                return

    def _knock(self) -> None:
        """Connect to the FMUs that listen, and leave at once."""
        for place in self._listening.values():
            with suppress(OSError):
                socket.create_connection(place, GRACE).close()

    def check_end(self, time: float, ended: SimulationEndedError | None) -> None:
        """Wait for the end of a program that has left, for which an FMU may have `ended` the run.

        Raises:
            SimulationError: It ended with another exit code than 0, or does not end.
        """
        if code := self._program.ended(PATIENCE):
            text = self._how(code)
        elif code is None:
            text = f"the client still ran {PATIENCE:g} s after it had left"
        else:
            return
        raise SimulationError(text, time=time, instance=ended.instance if ended else "")

    def _how(self, code: int) -> str:
        """Say how it ended, and what it said last."""
        how = f"exit code {code}" if code > 0 else f"signal {-code}"
        said = without_traceback("\n".join(self._program.last)).splitlines()[-SHOWN:]
        return f"the client ended with {how}: {one_line(' '.join(said)) or 'it said nothing'}"


def _tell(line: str) -> None:
    print(printable(line), file=sys.stderr, flush=True)
