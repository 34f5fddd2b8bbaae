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
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

from ..fmus.atomic import cache_folder, held
from ..fmus.errors import SimulationEndedError, SimulationError, one_line, printable
from ..fmus.master.calls import without_traceback
from ..fmus.master.master import Master
from ..fmus.processes import Program
from .prepare import PATIENCE, Prepared
from .stopping import StopRequest

ADDRESSES: Final = tuple(f"127.0.1.{number}" for number in range(1, 255))  # of runs side by side
LOOKING: Final = 0.05  # [s] between two looks at the program and the stop
GRACE: Final = 0.5  # [s] for a step to end after the run has been asked to stop
DYING: Final = 2.0  # [s] for a program to end after an FMU has failed
SHOWN: Final = 3  # last lines of a program that failed


@contextmanager
def addressed(prepared: Prepared) -> Iterator[Prepared]:
    """Choose where FMUs listen: if the client is told, the first address that nobody has."""
    client, places = prepared.scenario.client, list(prepared.listening.values())
    for address in (places[0][0], *ADDRESSES) if client and client.has_address and places else ():
        (file := cache_folder() / f"address-{address}").touch()
        with held(file) as is_ours:
            if is_ours and all(_is_free((address, port)) for _, port in places):
                yield replace(prepared, address=address)
                return
    yield prepared


def _is_free(place: tuple[str, int]) -> bool:
    with suppress(OSError), socket.create_server(place):
        return True
    return False


class RunningClient:
    """The program of a scenario, from when its FMUs are open to the end of the run.

    `Execution.open` starts one. What the program prints is passed on if it `tells`, and its last
    lines explain a failure.
    """

    def __init__(self, prepared: Prepared, *, tells: bool = True) -> None:
        scenario, self._listening = prepared.scenario, prepared.listening
        assert scenario.client is not None
        address = next((address for address, _ in self._listening.values()), "")
        folder = scenario.folder or Path()
        words = scenario.client.words(folder, address)
        self.left = False  # whether its end has ended the run, where no FMU listens
        self._program = Program(words, folder, _tell if tells else lambda _: None)
        self.end = self._program.end  # with all that it has started

    @property
    def unfinished(self) -> str:
        """Say that it has not ended yet, or ""."""
        text = "the client still ran at the scenario's end; a longer `duration` gives it more time"
        return text if self._program.ended() is None else ""

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
        has_ended = False
        while not done.wait(LOOKING):
            stop.poll()
            if stop.reason and not done.wait(GRACE):
                self.end()
            if not has_ended and self._program.ended() is not None:
                has_ended = True
                self._knock()
                self.left = not self._listening and not stop.reason
                master.stop_requested |= self.left

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
        code = self._program.ended(PATIENCE)
        if code != 0:
            instance = ended.instance if ended else ""
            raise SimulationError(self._how(code), time=time, instance=instance)

    def _how(self, code: int | None) -> str:
        """Say how it ended, and what it said last."""
        if code is None:
            return f"the client still ran {PATIENCE:g} s after it had left"
        how = f"exit code {code}" if code > 0 else f"signal {-code}"
        said = without_traceback("\n".join(self._program.last)).splitlines()[-SHOWN:]
        return f"the client ended with {how}: {one_line(' '.join(said)) or 'it said nothing'}"


def _tell(line: str) -> None:
    print(printable(line), file=sys.stderr, flush=True)
