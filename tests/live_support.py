"""`panda-cosim live` in a process of its own, and requests to it, for tests."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from itertools import count
from operator import itemgetter
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from websockets.sync.client import ClientConnection, connect

from bounded import line_of, running

BIN = Path(sys.executable).parent
READY = "window.PandaView !== undefined && PandaView.firstPicture > 0"


class Live:
    """A server in a process of its own.

    Attributes:
        address: Of its page.
        folder: Of its run.
    """

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self.process, self.folder = process, folder
        lines = (line_of(process) for _ in count())
        self.address = next(line.strip() for line in lines if line.startswith("http://"))
        self.token = self.address.partition("token=")[2]
        self.host = urlsplit(self.address).netloc

    def end(self) -> str:
        """Press Ctrl-C; returns what it says."""
        self.process.send_signal(signal.SIGINT)
        said, complaint = self.process.communicate(timeout=60)
        assert self.process.returncode == 0, complaint
        return said


@contextmanager
def live(folder: Path, *options: str) -> Iterator[Live]:
    """Start `panda-cosim live` in the parent of its run's folder."""
    command = [BIN / "panda-cosim", "live", "--out", folder, *options]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "bufsize": 1}
    with running(command, cwd=folder.parent, **pipes) as process:
        yield Live(process, folder)


def asked(server: Live, path: str, **headers: str) -> tuple[int, bytes]:
    """Ask for a path, with other headers than a browser's."""
    connection = HTTPConnection(server.host, timeout=20)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in {"Host": server.host, **headers}.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    return answer.status, answer.read()


def told(
    socket: ClientConnection, key: str, fits: Callable[[Any], object] = lambda _: True
) -> dict[str, Any]:
    """Wait for a message of the server under a key, and with content that fits."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        said = socket.recv(20)
        if isinstance(said, str) and key in (found := json.loads(said)) and fits(found[key]):
            return dict(found)
    raise TimeoutError(f"no such message under '{key}'")


def wait_to_act(socket: ClientConnection) -> None:
    """Wait until the server lets this viewer act; those before it may still be leaving."""
    told(socket, "status", itemgetter("acts"))


def upgrade(server: Live) -> bytes:
    """A request that opens the socket of a viewer."""
    lines = (
        f"GET /live?token={server.token} HTTP/1.1", f"Host: {server.host}",
        f"Origin: http://{server.host}", "Upgrade: websocket", "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13", "", "",
    )  # fmt: skip
    return "\r\n".join(lines).encode()


def viewer(server: Live) -> ClientConnection:
    """Open the page's socket."""
    address, origin = f"ws://{server.host}/live?token={server.token}", f"http://{server.host}"
    return connect(address, origin=origin, max_size=None, ping_interval=None)
