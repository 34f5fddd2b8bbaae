"""Serves one page and its socket, only to clients with the token.

Each request must have the token in its address and name this server in its `Host` header: a
foreign name that resolves to it (DNS rebinding) is refused. A socket must come from the page
itself: browsers put that into the header `Origin`, and pages cannot change it.

Clients that flood it, stop reading or never finish their request cost a bounded amount of memory
and file descriptors, and do not delay its end.
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import logging
import secrets
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

import numpy as np
from numpy.typing import NDArray
from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State

from ...fmus.errors import InputError
from .commands import LetGo, parse_command
from .simulation import KEPT, Simulation

LOCAL: Final = "127.0.0.1"
PAGE, SOCKET, JOURNAL = "/", "/live", "/session.zip"
DOWNLOADED: Final = {"Content-Disposition": "attachment; filename=session.zip"}
COMMAND_LIMIT: Final = 4096  # [B] largest message to the simulation
VIEWERS: Final = 8
CONNECTIONS: Final = 64  # TCP; above this, the oldest one that is not a viewer is closed
BACKLOG: Final = 16 << 20  # [B] that a viewer may leave unread, besides the history
OPEN_TIME: Final = 5.0  # [s] for a request to arrive
CLOSE_TIME: Final = 1.0  # [s] for viewers to say goodbye
HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}

# Errors in a client's request belong into a log, if the user keeps one, not on the terminal.
LOG: Final = logging.getLogger(__name__)
LOG.addHandler(logging.NullHandler())


class LiveServer:
    """Page and socket of a simulation, in a thread of its own.

    Args:
        simulation: Takes commands from the first client.
        page: Its page.
        host: Address to listen on.
        port: TCP port; 0: any free one.
    """

    def __init__(self, simulation: Simulation, page: str, host: str = LOCAL, port: int = 0) -> None:
        self._simulation, self._page = simulation, page.encode()
        self._host, self._port = host, port
        self._token = secrets.token_urlsafe(24)
        self._viewers: list[ServerConnection] = []  # the first one may act
        self._connections: dict[_Connection, None] = {}  # of TCP, the oldest first
        self._backlog = BACKLOG + KEPT * simulation.history[0].nbytes
        self._status, self._plan = simulation.status(), simulation.plan()

    @property
    def address(self) -> str:
        """Address of the page, with its token."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self._port}{PAGE}?token={self._token}"

    @contextmanager
    def serving(self) -> Iterator[None]:
        """Serve until the `with` block ends.

        Raises:
            InputError: It cannot listen on the address.
        """
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(_log)
        thread = threading.Thread(target=self._loop.run_forever, name="live server", daemon=True)
        thread.start()
        try:
            server = self._wait(self._open())
            yield
            with suppress(TimeoutError):  # on a busy machine clients may be left without a goodbye
                self._wait(self._close(server))
        finally:
            with suppress(TimeoutError):
                self._wait(self._cancel_all())
            self._loop.call_soon_threadsafe(self._loop.stop)
            thread.join(5)

    def _wait(self, task: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(task, self._loop).result(10)

    async def _open(self) -> Server:
        try:
            server = await serve(
                self._talk,
                self._host,
                self._port,
                process_request=self._answer,
                create_connection=self._connection,  # type: ignore[arg-type]
                open_timeout=OPEN_TIME,
                close_timeout=CLOSE_TIME,
                logger=LOG,
                max_size=COMMAND_LIMIT,
                max_queue=16,
                compression=None,
                server_header=None,
            )
        except OSError as error:
            place = f"{self._host}:{self._port}"
            raise InputError(f"cannot listen on {place}: {error.strerror or error}") from error
        self._port = next(iter(server.sockets)).getsockname()[1]
        return server

    async def _close(self, server: Server) -> None:
        server.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(2 * CLOSE_TIME):
                await server.wait_closed()
        for connection in list(self._connections):  # which do not read, or never asked
            connection.transport.abort()
        await server.wait_closed()

    async def _cancel_all(self) -> None:
        """End what is left, as of clients that came while the server closed."""
        left = asyncio.all_tasks() - {asyncio.current_task()}
        for task in left:
            task.cancel()
        if left:
            await asyncio.wait(left, timeout=CLOSE_TIME)

    def _connection(self, *arguments: Any, **settings: Any) -> _Connection:
        return _Connection(self._connections, *arguments, **settings)

    # Requests.

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse, return the page, or let the socket be opened (None)."""
        try:
            address = urlsplit(request.path)
            given = parse_qs(address.query, max_num_fields=4).get("token", [""])
        except ValueError:
            return connection.respond(HTTPStatus.BAD_REQUEST, "")
        known = len(given) == 1 and secrets.compare_digest(given[0].encode(), self._token.encode())
        if not (known and self._is_ours(request.headers, socket=address.path == SOCKET)):
            return connection.respond(HTTPStatus.FORBIDDEN, "")
        if address.path == SOCKET:
            full = len(self._viewers) >= VIEWERS
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "") if full else None
        if address.path == JOURNAL:
            return _response("application/zip", self._simulation.journal(), DOWNLOADED)
        if address.path != PAGE:
            return connection.respond(HTTPStatus.NOT_FOUND, "")
        return _response("text/html; charset=utf-8", self._page)

    def _is_ours(self, headers: Headers, *, socket: bool) -> bool:
        """Whether a request names this server and comes from its page or from no page."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_this_server(hosts[0]):
            return False
        return origins == [f"http://{hosts[0]}"] or (not socket and not origins)

    def _is_this_server(self, host: str) -> bool:
        name, colon, port = host.rpartition(":")
        if not colon or port != str(self._port):
            return False
        # As browsers write it: an IPv6 address in brackets, a name in lower case.
        name, own = name.strip("[]").lower(), self._host.lower()
        if name == own or (own == LOCAL and name == "localhost"):
            return True
        try:  # a numeric address cannot be rebound by a foreign page
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return self._host in ("0.0.0.0", "::")  # noqa: S104 - where all addresses were asked for

    # The socket.

    async def _talk(self, connection: ServerConnection) -> None:
        self._viewers.append(connection)
        try:
            await connection.send(np.array(list(self._simulation.history)).tobytes())
            await connection.send(json.dumps({"plan": self._plan}))
            self._tell_status()
            async for message in connection:
                self._take(connection, message)
        except ConnectionClosed:
            pass
        finally:
            if connection is self._viewers[0]:
                self._simulation.ask(LetGo(do="let_go"), lambda _: None)
            self._viewers.remove(connection)
            self._tell_status()

    def _take(self, connection: ServerConnection, message: str | bytes) -> None:
        def refuse(words: str) -> None:
            text = json.dumps({"refused": words[:500]})
            self._loop.call_soon_threadsafe(self._send, [connection], text)

        if connection is not self._viewers[0]:
            refuse("view only: another page has control")
            return
        try:
            self._simulation.ask(parse_command(message), refuse)
        except InputError as error:
            refuse(str(error))

    def rows(self, rows: NDArray[np.float64]) -> None:
        """Send rows to all clients; called from the simulation's thread."""
        self._loop.call_soon_threadsafe(self._send, self._viewers, rows.tobytes())

    def status(self, status: dict[str, Any]) -> None:
        """Send the simulation's status to all clients; called from the simulation's thread."""
        self._status = status
        self._loop.call_soon_threadsafe(self._tell_status)

    def plan(self, plan: dict[str, Any]) -> None:
        """Send a new commanded path to all clients; called from the simulation's thread."""
        self._plan = plan
        text = json.dumps({"plan": plan})
        self._loop.call_soon_threadsafe(self._send, self._viewers, text)

    def _tell_status(self) -> None:
        for index, viewer in enumerate(self._viewers):
            self._send([viewer], json.dumps({"status": {**self._status, "acts": index == 0}}))

    def _send(self, viewers: Iterable[ServerConnection], message: str | bytes) -> None:
        """Send a message at once; viewers that do not read what they are sent are cut off."""
        open_ones = [viewer for viewer in viewers if not viewer.transport.is_closing()]
        broadcast(open_ones, message)
        for viewer in open_ones:
            if viewer.transport.get_write_buffer_size() > self._backlog:
                viewer.transport.abort()


class _Connection(ServerConnection):
    """A TCP connection that makes room among the others if there are too many.

    Args:
        others: The open ones, the oldest first.
        *arguments: Of `ServerConnection`.
        **settings: Of `ServerConnection`.
    """

    def __init__(self, others: dict[_Connection, None], *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._others = others

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Close the oldest connection that is not a viewer if there are too many."""
        super().connection_made(transport)
        waiting = [each for each in self._others if each.state is not State.OPEN]
        if len(self._others) >= CONNECTIONS and waiting:
            del self._others[waiting[0]]  # before the event loop tells that it is lost
            waiting[0].transport.abort()
        self._others[self] = None

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove it from the open connections."""
        super().connection_lost(exc)
        self._others.pop(self, None)


def _log(_loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    LOG.error(context["message"], exc_info=context.get("exception"))


def _response(kind: str, body: bytes, more: Mapping[str, str] | None = None) -> Response:
    own = {"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close"}
    return Response(HTTPStatus.OK, "OK", Headers({**HEADERS, **own, **(more or {})}), body)


__all__ = ["LOCAL", "LiveServer"]
