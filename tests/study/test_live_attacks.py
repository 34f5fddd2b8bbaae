"""`panda-cosim live` under attack: malformed requests, floods, clients that stall."""

import gc
import signal
import socket
import threading
import time
from contextlib import ExitStack, suppress
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed

from live_support import Live, asked, live, told, upgrade, viewer, wait_to_act
from panda_cosim.result.recording import Recording
from panda_cosim.study.live.server import COMMAND_LIMIT, OPEN_TIME, VIEWERS, LiveServer


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A server that ends soon and without a word, also while clients stall."""
    with live(tmp_path_factory.mktemp("live") / "run", "--speed", "0.05") as opened:
        yield opened
        with raw(opened, b"GET / HT"), raw(opened, upgrade(opened)) as stalled:
            stalled.sendall(500 * b"\x81\x82\0\0\0\0{}")  # masked with zeros; and reads no answer
            time.sleep(0.1)
            began = time.monotonic()
            opened.process.send_signal(signal.SIGINT)
            _, complaint = opened.process.communicate(timeout=60)
            assert (opened.process.returncode, complaint) == (0, "")
            assert time.monotonic() - began < 8.0
    assert Recording.open(opened.folder).rows > 0


def raw(server: Live, content: bytes) -> socket.socket:
    """Send bytes over a new TCP connection."""
    host, _, port = server.host.partition(":")
    opened = socket.create_connection((host, int(port)), timeout=10)
    opened.sendall(content)
    return opened


def journal(server: Live) -> str:
    return (server.folder / "session.jsonl").read_text()


# What is sent, and the status of the answer; None: a connection that ends.
MALFORMED: dict[str, tuple[bytes, bytes | None]] = {
    "nothing that a server knows": (b"\x16\x03\x01\n\n\n", None),
    "no host": (b"GET / HTTP/1.1\r\n\r\n", b"403"),
    "long address": (b"GET /" + b"x" * 100_000 + b" HTTP/1.1\r\n\r\n", b"414"),
    "address that is none": (b"GET http://[x?token=TOKEN HTTP/1.1\r\n\r\n", b"400"),
    "lone surrogate": (b"GET /?token=%ed%a0%80 HTTP/1.1\r\nHost: HOST\r\n\r\n", b"403"),
    "file of the run": (b"GET /session.jsonl?token=TOKEN HTTP/1.1\r\nHost: HOST\r\n\r\n", b"404"),
}


@pytest.mark.parametrize("kind", MALFORMED)
def test_malformed_requests_get_nothing(server, kind):
    content, status = MALFORMED[kind]
    content = content.replace(b"HOST", server.host.encode())
    with raw(server, content.replace(b"TOKEN", server.token.encode())) as opened:
        if status is None:
            opened.shutdown(socket.SHUT_WR)
        answer = b"".join(iter(lambda: opened.recv(1 << 16), b""))
    assert answer[9:12] in ((status,) if status else (b"", b"400"))
    assert b"<script" not in answer
    assert b"run" not in answer.partition(b"\r\n\r\n")[2]


def test_half_open_connections_are_cut_off(server):
    with raw(server, b"GET / HT") as alone:
        assert asked(server, f"/?token={server.token}")[0] == 200
        alone.settimeout(OPEN_TIME + 20.0)
        while alone.recv(1 << 16):
            pass


def test_no_more_than_a_few_may_look(server):
    with ExitStack() as stack:
        sockets = [stack.enter_context(raw(server, upgrade(server))) for _ in range(40)]
        begins = [opened.recv(12) for opened in sockets]
        assert begins.count(b"HTTP/1.1 101") == VIEWERS
        assert begins.count(b"HTTP/1.1 503") == 40 - VIEWERS


WRONG = [
    b"\0\1\2", b"\xff" * 100, "x" * 5000, b"x" * 10_000_000, "[" * 4000, "null", '"\\ud800"', "NaN",
    '{"do": NaN}', '{"do": "step", "ticks": 1e400}', "9" * 4000,
    '{"do": "step", "do": "fly", "ticks": 1}',
    '{"do": "set", "name": "controller.kp", "value": 1e999}',
    '{"do": "set", "name": "controller.kp", "value": "\\u0000"}',
    '{"do": "set", "name": "controller.kp[99999999999999999999]", "value": 5}',
    '{"do": "set", "name": "plant.qpos", "value": 5}',
    '{"do": "set", "name": "\\u202e", "value": 5}',
    '{"do": "set", "name": "__class__", "value": 5}',
    '{"do": "waypoint", "row": 3, "position": [1e308, 0, 0]}',
    '{"do": "keep", "name": "..", "to": "/etc"}', '{"do": "run", "command": "id"}',
]  # fmt: skip


def test_messages_of_wrong_type_and_size_change_nothing(server):
    before = journal(server)
    for message in WRONG:
        with viewer(server) as opened:
            wait_to_act(opened)
            opened.send(message)
            if len(message) > COMMAND_LIMIT:
                with pytest.raises(ConnectionClosed):
                    told(opened, "refused")
            else:
                assert 0 < len(told(opened, "refused")["refused"]) <= 500, message[:80]
    assert journal(server) == before
    assert server.process.poll() is None


def test_a_flood_does_not_hold_up_the_simulation(server):
    messages: list[str | bytes] = []

    def listen() -> None:
        with suppress(ConnectionClosed):
            messages.extend(opened)  # until it is closed

    with viewer(server) as opened:
        wait_to_act(opened)
        reader = threading.Thread(target=listen)
        reader.start()
        began, sent = time.monotonic(), 0
        while sent < 1000 or time.monotonic() - began < 1.5:
            opened.send('{"do": "set", "name": "controller.kp", "value": 5}')
            sent += 1
        rows = sum(isinstance(each, bytes) for each in messages)
    reader.join(20)
    assert rows > 8  # of 75, without a flood
    assert any(isinstance(each, str) and "too many" in each for each in messages)


def test_an_ended_server_leaves_no_task_behind(caplog):
    server = LiveServer(SimpleNamespace(status=dict, plan=dict), "page")  # type: ignore[arg-type]
    with server.serving():
        place = urlsplit(server.address)
        silent = socket.create_connection((place.hostname, place.port), timeout=10)
        time.sleep(0.1)  # for the server to take it
    with silent:
        del server
        gc.collect()
    assert caplog.messages == []
