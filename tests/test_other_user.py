"""Other users of the machine: nothing of theirs is loaded, and a live run is not theirs."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import time
from pathlib import Path

import pytest

from live_support import asked, live, viewer
from panda_cosim.fmus.atomic import cache_folder
from panda_cosim.fmus.errors import InputError

OTHER = 12345  # id of a user


@pytest.fixture
def shared():
    """A folder that all may write to, as /tmp is."""
    folder = Path(tempfile.mkdtemp(prefix="panda-cosim-test-"))
    folder.chmod(0o1777)
    yield folder
    shutil.rmtree(folder)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be another user, too")
def test_another_users_cache_is_refused(shared, monkeypatch):
    (shared / "theirs").mkdir(mode=0o700)
    os.chown(shared / "theirs", OTHER, OTHER)
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(shared / "theirs"))
    with pytest.raises(InputError, match=r"others may write to it.*PANDA_COSIM_CACHE"):
        cache_folder()


@pytest.mark.parametrize("mode", [0o770, 0o777, 0o1777])
def test_a_cache_that_others_may_write_to_is_refused(shared, mode, monkeypatch):
    shared.chmod(mode)
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(shared))
    with pytest.raises(InputError, match=r"others may write to it.*PANDA_COSIM_CACHE"):
        cache_folder()


def test_a_new_cache_is_private_whatever_the_umask(shared, monkeypatch):
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(shared / "new" / "cache"))
    before = os.umask(0)
    try:
        assert stat.S_IMODE(cache_folder().stat().st_mode) == 0o700
    finally:
        os.umask(before)


def text_in(path: Path) -> str:
    """Return a file's text once it has one."""
    end = time.monotonic() + 60.0
    while not (path.exists() and path.read_text()):
        assert time.monotonic() < end, f"{path}: nobody writes it"
        time.sleep(0.01)
    return path.read_text()


def test_the_browser_gets_the_token_in_a_file_of_the_users_own(shared, monkeypatch):
    browser = shared / "browser"
    browser.write_text('#!/bin/sh\necho "$@" > "$0.said"\nexec sleep 45 >&- 2>&-\n')
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    with live(shared / "run", "--speed", "0.05", "--open") as server:
        leads = server.folder / "open.html"
        assert text_in(shared / "browser.said").strip() == leads.as_uri()
        assert server.address in leads.read_text()
        assert stat.S_IMODE(leads.stat().st_mode) == 0o600
        with viewer(server) as socket:
            messages = [socket.recv(20) for _ in range(20)]
        assert sum(isinstance(each, bytes) for each in messages) > 5  # rows, with the browser open
        for path in ("/", "/live", "/session.zip"):
            assert asked(server, path) == (403, b"")
        command = Path(f"/proc/{server.process.pid}/cmdline").read_bytes()
        assert server.token.encode() not in command  # which all users can read
        server.end()
    assert not leads.exists()
