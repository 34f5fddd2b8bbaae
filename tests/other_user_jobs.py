"""What another user of the machine does, in processes that root starts for it."""

from __future__ import annotations

import os
from http.client import HTTPConnection
from pathlib import Path

OTHER = 12345  # id of a user


def become_other() -> None:
    """Give up all rights but the other user's."""
    os.setgroups([])
    os.setgid(OTHER)
    os.setuid(OTHER)


def spy(token: str, folder: str, host: str) -> None:
    """Look for a live run's token, and ask the server without it."""
    ask_without_token(host)  # also loads what the other user may not read
    become_other()
    look_for(token, Path(folder))
    ask_without_token(host)


def look_for(token: str, folder: Path) -> None:
    """Check that a token is in no file, and in no process's arguments, that one can read."""
    for path in (*Path("/proc").glob("[0-9]*/cmdline"), *folder.rglob("*")):
        try:
            content = path.read_bytes()
        except OSError:  # a folder, not ours to read, or gone
            continue
        assert token.encode() not in content, path


def ask_without_token(host: str) -> None:
    """Ask for all that the server has."""
    for path in ("/", "/live", "/session.zip"):
        connection = HTTPConnection(host, timeout=20)
        connection.request("GET", path)
        answer = connection.getresponse()
        assert (answer.status, answer.read()) == (403, b"")
        connection.close()
