"""The line to a client: its connections, requests and packets, and the waiting for them."""

from __future__ import annotations

import select
import signal
import socket
import time
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from .wire import Protocol

SLICE: Final = 0.1  # [s] of waiting, after which timeouts are looked at
LINGER: Final = 0.5  # [s] after which a client that has closed its connections has left
SEND_TIMEOUT: Final = 5.0  # [s] for a client to take an answer
LONGEST: Final = 4096  # [byte] no request is nearly as long
MOST_TAKEN: Final = 10_000  # requests, and packets without the command that is due, within a tick
RECEIVED: Final = 65536  # [byte] read at once
PACKETS: Final = Path("/proc/net/udp")  # what the kernel's sockets hold, on Linux


class LineError(ValueError):
    """The client has died, floods, or sends what is no message; or none has come."""


class EndedError(Exception):
    """There is no more to do: the client has left in good order, or a signal came."""


class Request:
    """A request of a client, which is answered once or, a `Move`, twice."""

    def __init__(self, client: Client, number: int, identity: int, body: Any) -> None:
        self.name, self.body, self.client = client.protocol.requests[number][0], body, client
        self._number, self._identity = number, identity

    def answer(self, status: int, more: bytes = b"") -> None:
        """Answer it, unless its client has gone."""
        protocol = self.client.protocol
        with suppress(OSError):  # which is noticed where it is read from
            self.client.tcp.sendall(protocol.answer(self._number, self._identity, status, more))


class Client:
    """The connection of one client: requests over TCP, and packets over UDP both ways."""

    def __init__(self, protocol: Protocol, tcp: socket.socket) -> None:
        self.protocol, self.tcp = protocol, tcp
        tcp.settimeout(SEND_TIMEOUT)
        tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind((tcp.getsockname()[0], 0))
        self.udp.setblocking(False)
        self._port, self._data = 0, b""  # where it takes packets; of an incomplete request

    @property
    def is_connected(self) -> bool:
        """Whether it has said where it takes packets."""
        return self._port > 0

    def connect(self, port: int) -> None:
        """Send packets to a port of the client from now on, and take only its own."""
        self._port = port
        self.udp.connect((self.tcp.getpeername()[0], port))

    def requests(self) -> Iterator[Request]:
        """Yield what it asks for; raises EOFError if it has closed the connection."""
        try:
            received = self.tcp.recv(RECEIVED)
        except OSError:
            received = b""
        if not received:
            raise EOFError
        self._data += received
        for number, identity, size, body in self.protocol.split(self._data):
            self._data = self._data[size:]
            yield Request(self, number, identity, self._checked(number, body))
        if len(self._data) > LONGEST:
            raise LineError(f"the client sends {len(self._data)} bytes that are no request")

    def _checked(self, number: int, body: bytes) -> Any:
        """Return the fields of a request."""
        if number >= len(self.protocol.requests):
            raise LineError(
                f"the client sends request {number}; must be less than "
                f"{len(self.protocol.requests)}, as version {self.protocol.version} has them"
            )
        name, layout = self.protocol.requests[number]
        if len(body) != layout.itemsize:
            raise LineError(
                f"the client sends {name} with {len(body)} bytes; must be {layout.itemsize}, as "
                f"version {self.protocol.version} has it"
            )
        return np.frombuffer(body, layout)[0] if body else None

    def send(self, packet: bytes) -> None:
        """Send a packet, unless the client has gone."""
        if self._port:
            with suppress(OSError):
                self.udp.send(packet)

    def packets(self, size: int) -> Iterator[bytes]:
        """Yield the packets that have come."""
        with suppress(OSError):  # there is none
            while True:
                yield self.udp.recv(size)

    def has_unread(self) -> bool:
        """Whether it has packets to read, as the kernel tells of programs on this machine."""
        end = f":{self._port:04X}"
        with suppress(OSError):
            for line in PACKETS.read_text(encoding="ascii").splitlines()[1:]:
                words = line.split()
                if words[1].endswith(end):
                    return not words[4].endswith(":00000000")
        return False

    def close(self) -> None:
        """Close its sockets."""
        self.udp.close()
        self.tcp.close()


class Service:
    """Listens on a port, for one client at a time; its requests are methods of an owner."""

    def __init__(self, protocol: Protocol, owner: Any, address: str, port: int) -> None:
        self.protocol, self.place = protocol, f"{address}:{port}"
        self.client: Client | None = None
        self._owner, self._listener = owner, socket.socket()
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind((address, port))
            self._listener.listen()
        except OSError as error:
            self.close()
            raise LineError(f"{protocol.name}: cannot listen on {self.place}: {error}") from None

    @property
    def sockets(self) -> list[socket.socket]:
        """What may have something to read."""
        client = self.client
        return [self._listener, client.tcp, client.udp] if client else [self._listener]

    def serve(self, ready: Container[socket.socket]) -> int:
        """Take what has come on sockets; return the number of requests."""
        count, client = 0, self.client
        if self._listener in ready:
            self._accept()
        if client and client.tcp in ready:
            try:
                for request in client.requests():
                    getattr(self._owner, request.name)(request)
                    count += 1
            except EOFError:
                client.close()
                self.client = None
                self._owner.leave()
        return count

    def agree(self, request: Request) -> None:
        """Answer `connect`: the client speaks our version, or it leaves."""
        version, port = request.body.item()
        is_ours = version == self.protocol.version
        request.answer(0 if is_ours else 1, np.array(self.protocol.version, "<u2").tobytes())
        if is_ours:
            request.client.connect(port)

    def _accept(self) -> None:
        tcp, _ = self._listener.accept()
        if self.client:  # a robot has one
            tcp.close()
        else:
            self.client = Client(self.protocol, tcp)

    def close(self) -> None:
        """Close all sockets."""
        self._listener.close()
        if self.client:
            self.client.close()


class Line:
    """The services of a robot, and the waiting for their clients, in slices."""

    def __init__(self, services: Sequence[Service], connection_timeout: float) -> None:
        self._services, self._timeout = services, connection_timeout
        self._since, self._was_connected = time.monotonic(), False
        self._taken = 0  # requests and packets in this tick
        self._woken, self._waker = socket.socketpair()
        self._waker.setblocking(False)

    @contextmanager
    def tick(self) -> Iterator[None]:
        """Notice, during a tick, the signals that the process handles."""
        self._taken = 0
        try:
            before = signal.set_wakeup_fd(self._waker.fileno(), warn_on_full_buffer=False)
        except ValueError:  # not the main thread, which alone gets signals
            yield
            return
        try:
            yield
        finally:
            signal.set_wakeup_fd(before)

    def serve(self, limit: float) -> None:
        """Take what comes, for which it waits a time [s]."""
        sockets = [each for service in self._services for each in service.sockets]
        ready, _, _ = select.select([self._woken, *sockets], [], [], limit)
        if self._woken in ready:
            self._wake()
        for service in self._services:
            self.count(service.serve(ready))
        if not ready:
            self._check()

    def count(self, taken: int) -> None:
        """Count what a client has sent in this tick."""
        self._taken += taken
        if self._taken > MOST_TAKEN:
            raise LineError(
                f"the client floods: more than {MOST_TAKEN} requests and packets in one tick"
            )

    def _wake(self) -> None:
        for number in self._woken.recv(RECEIVED):
            if number != signal.SIGCHLD:
                raise EndedError(f"{signal.Signals(number).name} while it waited for the client")

    def _check(self) -> None:
        """Look at what has taken too long, while nothing comes."""
        now = time.monotonic()
        if any(service.client for service in self._services):
            self._since, self._was_connected = now, True
        elif self._was_connected and now - self._since > LINGER:
            raise EndedError("the client has left")
        elif not self._was_connected and 0.0 < self._timeout < now - self._since:
            raise LineError(
                f"no client has connected to {self._services[0].place} for {self._timeout:g} s"
            )

    def close(self) -> None:
        """Close all sockets."""
        for service in self._services:
            service.close()
        self._woken.close()
        self._waker.close()
