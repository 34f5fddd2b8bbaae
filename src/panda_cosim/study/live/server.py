"""Serves one page and its socket, only to clients with the token.

Each request must have the token in its address. A socket must come from a page of the host that it
names, too: browsers put that into the header `Origin`, and pages cannot change it.

Clients that stop reading are closed by the keepalive of `websockets`, and unfinished requests after
`OPEN_TIME`.
"""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import threading
import webbrowser
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from http import HTTPStatus
from pathlib import Path
from typing import Final
from urllib.parse import parse_qs, urlsplit

import numpy as np
from numpy.typing import NDArray
from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from ...fmus.errors import InputError
from ...result.view.page import rendered
from .simulation import Act, Simulation, parse_command

LOCAL: Final = "127.0.0.1"
PAGE, SOCKET, JOURNAL = "/", "/live", "/session.zip"
DOWNLOADED: Final = {"Content-Disposition": "attachment; filename=session.zip"}
COMMAND_LIMIT: Final = 4096  # [B] largest message to the simulation
VIEWERS: Final = 8
OPEN_TIME: Final = 5.0  # [s] for a request to arrive
CLOSE_TIME: Final = 1.0  # [s] for viewers to say goodbye
OPEN_FILE: Final = "open.html"
OPEN_PAGE: Final = Path(__file__).with_name(OPEN_FILE)
HEADERS: Final = {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer"}  # of the token

# Errors in a client's request belong into a log, if the user keeps one, not on the terminal.
LOG: Final = logging.getLogger(__name__)
LOG.addHandler(logging.NullHandler())
logging.getLogger("asyncio").setLevel(logging.ERROR)  # it warns of viewers that have gone


class LiveServer:
    """Page and socket of a simulation, in a thread of its own; its first client may act."""

    def __init__(self, simulation: Simulation, page: str, host: str = LOCAL, port: int = 0) -> None:
        self._simulation, self._page = simulation, page.encode()
        self._host, self._port = host, port
        self._token = secrets.token_urlsafe(24)
        self._loop = asyncio.new_event_loop()
        self._viewers: list[ServerConnection] = []  # the first one may act
        self._status, self._plan = simulation.status(), simulation.plan()

    @property
    def address(self) -> str:
        """Address of the page, with its token."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self._port}{PAGE}?token={self._token}"

    @contextmanager
    def serving(self) -> Iterator[None]:
        """Serve until the `with` block ends."""
        thread = threading.Thread(target=self._loop.run_forever, name="live server", daemon=True)
        thread.start()
        try:
            server = asyncio.run_coroutine_threadsafe(self._listen(), self._loop).result()
            self._port = next(iter(server.sockets)).getsockname()[1]
            try:
                yield
            finally:
                asyncio.run_coroutine_threadsafe(_end(server), self._loop).result()
        finally:
            self._loop.call_soon_threadsafe(self._loop.stop)
            thread.join()
            self._loop.close()

    async def _listen(self) -> Server:
        self._loop.set_exception_handler(
            lambda _, context: LOG.error(context["message"], exc_info=context.get("exception"))
        )
        try:
            return await serve(
                self._talk,
                self._host,
                self._port,
                process_request=self._answer,
                open_timeout=OPEN_TIME,
                close_timeout=CLOSE_TIME,
                logger=LOG,
                max_size=COMMAND_LIMIT,
                compression=None,
                server_header=None,
            )
        except OSError as error:
            place = f"{self._host}:{self._port}"
            raise InputError(f"cannot listen on {place}: {error.strerror or error}") from None

    # Requests.

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse, return the page, or let the socket be opened (None)."""
        try:
            address = urlsplit(request.path)
            token = parse_qs(address.query, max_num_fields=4).get("token", [""])[0]
        except ValueError:
            return connection.respond(HTTPStatus.BAD_REQUEST, "")
        is_known = secrets.compare_digest(token.encode(), self._token.encode())
        hosts, origins = map(request.headers.get_all, ("Host", "Origin"))
        is_own = address.path != SOCKET or origins == [f"http://{host}" for host in hosts]
        if not (is_known and is_own):
            return connection.respond(HTTPStatus.FORBIDDEN, "")
        if address.path == SOCKET:
            full = len(self._viewers) >= VIEWERS
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "") if full else None
        if address.path == JOURNAL:
            return _response("application/zip", self._simulation.journal(), DOWNLOADED)
        if address.path != PAGE:
            return connection.respond(HTTPStatus.NOT_FOUND, "")
        return _response("text/html; charset=utf-8", self._page)

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
                self._simulation.ask(Act(do="let_go"), lambda _: None)
            self._viewers.remove(connection)
            self._tell_status()

    def _take(self, connection: ServerConnection, message: str | bytes) -> None:
        def refuse(words: str) -> None:
            text = json.dumps({"refused": words[:500]})
            self._loop.call_soon_threadsafe(broadcast, [connection], text)

        if connection is not self._viewers[0]:
            refuse("view only: another page has control")
            return
        try:
            self._simulation.ask(parse_command(message), refuse)
        except InputError as error:
            refuse(str(error))

    def rows(self, rows: NDArray[np.float64]) -> None:
        """Send rows to all clients; called from the simulation's thread."""
        self._loop.call_soon_threadsafe(broadcast, self._viewers, rows.tobytes())

    def status(self, status: dict[str, object]) -> None:
        """Send the simulation's status to all clients; called from the simulation's thread."""
        self._status = status
        self._loop.call_soon_threadsafe(self._tell_status)

    def plan(self, plan: dict[str, object]) -> None:
        """Send a new commanded path to all clients; called from the simulation's thread."""
        self._plan = plan
        self._loop.call_soon_threadsafe(broadcast, self._viewers, json.dumps({"plan": plan}))

    def _tell_status(self) -> None:
        for index, viewer in enumerate(self._viewers):
            broadcast([viewer], json.dumps({"status": {**self._status, "acts": index == 0}}))


async def _end(server: Server) -> None:
    """Close a server; clients that do not answer in time are left without a goodbye."""
    server.close()
    with suppress(TimeoutError):
        await asyncio.wait_for(server.wait_closed(), 2 * CLOSE_TIME)
    left = asyncio.all_tasks() - {asyncio.current_task()}
    for task in left:
        task.cancel()
    await asyncio.gather(*left, return_exceptions=True)


def _response(kind: str, body: bytes, more: Mapping[str, str] | None = None) -> Response:
    own = {"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close"}
    return Response(HTTPStatus.OK, "OK", Headers({**HEADERS, **own, **(more or {})}), body)


@contextmanager
def opened(address: str, folder: Path) -> Iterator[None]:
    """Open a page in the browser without showing its address, with the token, to other users."""
    # They see the arguments of each program. So the browser is given a file that only this user can
    # read, and that leads to the page; it goes at the end.
    path = folder / OPEN_FILE
    path.touch(mode=0o600, exist_ok=False)
    path.write_text(rendered(OPEN_PAGE, address=address), encoding="utf-8")
    uri = path.resolve().as_uri()
    # In a thread: some browsers stay in the foreground until they are closed.
    try:
        threading.Thread(target=webbrowser.open, args=[uri], daemon=True).start()
        yield
    finally:
        path.unlink(missing_ok=True)
