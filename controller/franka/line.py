"""The line to a program: its connections, requests and packets, and the waiting for them."""

from __future__ import annotations

import select
import signal
import socket
import time
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from .wire import Message, ProgramError, Protocol

LINGER: Final = 0.5  # [s] after which a program that has closed its connections has left
SEND_TIMEOUT: Final = 5.0  # [s] for a program to take an answer
MOST_TAKEN: Final = 10_000  # requests, and packets without the command that is due, within a tick
RECEIVED: Final = 65536  # [byte] read at once; no request is nearly as long
PACKETS: Final = Path("/proc/net/udp")  # what the kernel's sockets hold, on Linux


class EndedError(Exception):
    """There is no more to do: the program has left in good order, or a signal came."""


class Request(NamedTuple):
    """A request of a program, which is answered once or, a `move`, twice."""

    body: Message
    answer: Callable[..., None]  # with a status and, maybe, more bytes


class Service:
    """Listens on a port for one program at a time; other requests are methods of an owner."""

    def __init__(self, protocol: Protocol, owner: Any, address: str, port: int) -> None:
        self._protocol, self._owner, self.place = protocol, owner, f"{address}:{port}"
        self.program: socket.socket | None = None  # its connection
        self._port, self._data = 0, b""  # where packets go; of a request that is not complete
        try:
            self._listener = socket.create_server((address, port))
        except OSError as error:
            why = str(error.strerror).partition(" (")[0]  # which names the address again
            raise ProgramError(f"{protocol.name}: cannot listen on {self.place}: {why}") from None
        self.udp = socket.socket(type=socket.SOCK_DGRAM)
        self.udp.bind((address, 0))
        self.udp.setblocking(False)

    @property
    def sockets(self) -> list[socket.socket]:
        """What may have a connection or a request."""
        return [self._listener, *([self.program] if self.program else [])]

    def serve(self, ready: Container[socket.socket]) -> int:
        """Take what has come on sockets; return the number of requests."""
        count = 0
        if self.program and self.program in ready:
            count = self._read(self.program)
        if self._listener in ready:
            tcp, _ = self._listener.accept()
            if self.program:  # a robot has one program
                tcp.close()
            else:
                tcp.settimeout(SEND_TIMEOUT)
                tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.program, self._data = tcp, b""
        return count

    def _read(self, tcp: socket.socket) -> int:
        count, received = 0, b""
        with suppress(OSError):
            received = tcp.recv(RECEIVED)
        if not received:
            tcp.close()
            self.program, self._port = None, 0
            self._owner.leave()
        self._data += received
        for number, identity, size, body in self._protocol.split(self._data):
            self._data, count = self._data[size:], count + 1
            name = self._protocol.requests[number][0]
            act = getattr(self if name == "connect" else self._owner, name)
            act(Request(body, partial(self._answer, tcp, number, identity)))
        return count

    def _answer(
        self, tcp: socket.socket, number: int, identity: int, status: int, more: bytes = b""
    ) -> None:
        with suppress(OSError):  # the program has gone, which is noticed where it is read from
            tcp.sendall(self._protocol.answer(number, identity, status, more))

    def connect(self, request: Request) -> None:
        """Send states from now on, if the program speaks our version; else it leaves."""
        version, port = request.body.item()
        if version == self._protocol.version:
            assert self.program is not None
            self.udp.connect((self.program.getpeername()[0], port))
            self._port = port
        answer = np.array(self._protocol.version, "<u2").tobytes()
        request.answer(version != self._protocol.version, answer)
        self._owner.send_state()

    def send(self, packet: Message) -> None:
        """Send a packet, if a program takes them."""
        if self._port:
            with suppress(OSError):  # it has gone
                self.udp.send(packet.tobytes())

    def packets(self) -> Iterator[bytes]:
        """Yield the packets that have come."""
        with suppress(OSError):  # there is none
            while True:
                yield self.udp.recv(RECEIVED)

    @property
    def is_read(self) -> bool:
        """Whether a program has read all packets, as the kernel tells of this machine's."""
        with suppress(OSError):
            for line in PACKETS.read_text(encoding="ascii").splitlines()[1:]:
                words = line.split()
                if words[1].endswith(f":{self._port:04X}"):
                    return words[4].endswith(":00000000")
        return self._port > 0

    def close(self) -> None:
        """Close all sockets."""
        for each in (*self.sockets, self.udp):
            each.close()


class Line:
    """The services of a robot, and the waiting for their programs."""

    def __init__(self, services: Sequence[Service], connection_timeout: float) -> None:
        self._services, self._timeout = services, connection_timeout
        self._since, self._was_connected = time.monotonic(), False  # without a program since then
        self._taken = 0  # requests and packets in this tick
        self._woken, self._waker = socket.socketpair()
        self._waker.setblocking(False)

    @contextmanager
    def tick(self) -> Iterator[None]:
        """Notice, during a tick, the signals that the process handles."""
        self._taken, before = 0, None
        with suppress(ValueError):  # not the main thread, which gets them
            before = signal.set_wakeup_fd(self._waker.fileno(), warn_on_full_buffer=False)
        try:
            yield
        finally:
            if before is not None:
                signal.set_wakeup_fd(before)

    def serve(self, limit: float, *more: socket.socket) -> None:
        """Take what comes, for which it waits a time [s], or until more sockets have something."""
        sockets = [each for service in self._services for each in service.sockets]
        ready, _, _ = select.select([self._woken, *sockets, *more], [], [], limit)
        for number in self._woken.recv(RECEIVED) if self._woken in ready else b"":
            if number != signal.SIGCHLD:
                raise EndedError(f"{signal.Signals(number).name} while it waited for the program")
        self.count(sum(service.serve(ready) for service in self._services))
        if any(service.program for service in self._services):
            self._since, self._was_connected = time.monotonic(), True
        elif not ready:
            self._check()

    def count(self, taken: int) -> None:
        """Count what a program has sent in this tick."""
        self._taken += taken
        if self._taken > MOST_TAKEN:
            raise ProgramError(
                f"the program floods: more than {MOST_TAKEN} requests and packets in one tick"
            )

    def _check(self) -> None:
        """Look at how long there has been no program."""
        waited, place = time.monotonic() - self._since, self._services[0].place
        if self._was_connected and waited > LINGER:
            raise EndedError("the program has left")
        if not self._was_connected and 0.0 < self._timeout < waited:
            raise ProgramError(f"no program has connected to {place} for {self._timeout:g} s")

    def close(self) -> None:
        """Close all sockets."""
        for service in self._services:
            service.close()
        self._woken.close()
        self._waker.close()
