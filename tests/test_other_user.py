"""Other users of the machine: nothing of theirs is loaded, and a live run is not theirs."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import other_user_jobs
import pytest
from fmu_support import in_process
from other_user_jobs import ORIGINAL, OTHER, ask_without_token
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.master.archive import unpack
from panda_cosim.fmus.packaging.cache import cache_folder
from test_archive import make
from test_live import live
from test_live_attacks import viewer

as_root = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can be another user, too"
)


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder that all may write to, as /tmp is."""
    folder = Path(tempfile.mkdtemp(prefix="panda-cosim-test-"))
    folder.chmod(0o1777)
    yield folder
    shutil.rmtree(folder)


@as_root
@pytest.mark.parametrize("way", ["their cache", "a symlink to it", "our cache in their folder"])
def test_nothing_of_another_users_cache_is_loaded(
    shared: Path, tmp_path: Path, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make(tmp_path / "x.fmu", lambda f: [f.writestr(*m) for m in ORIGINAL])
    ours = way == "our cache in their folder"  # where they may put theirs in its place
    cache, link = shared / "theirs" / ("cache" if ours else ""), shared / "link"
    in_process(other_user_jobs.plant, str(cache), str(link), str(cache))
    if ours:
        for place in (cache, *cache.rglob("*")):
            os.chown(place, 0, 0)
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(link if "symlink" in way else cache))
    with pytest.raises(InputError, match=f"user {OTHER}"):
        unpack(path, cache_folder() / "unpacked" / "out")


@as_root
def test_another_users_symlink_cannot_be_turned_later(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make(tmp_path / "x.fmu", lambda f: [f.writestr(*m) for m in ORIGINAL])
    link, theirs = shared / "link", shared / "theirs"
    in_process(other_user_jobs.plant, str(theirs), str(link), str(tmp_path / "cache"))
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(link))
    folder = unpack(path, cache_folder() / "unpacked" / "out")
    in_process(other_user_jobs.turn, str(link), str(theirs))
    assert {name: (folder / name).read_bytes() for name, _ in ORIGINAL} == dict(ORIGINAL)


def text_in(path: Path) -> str:
    """Return a file's text once it has one."""
    end = time.monotonic() + 60.0
    while not (path.exists() and path.read_text()):
        assert time.monotonic() < end, f"{path}: nobody writes it"
        time.sleep(0.01)
    return path.read_text()


@pytest.mark.parametrize("more", ["&", ""], ids=["in the background", "in the foreground"])
def test_the_browser_gets_the_token_in_a_file_of_the_users_own(
    shared: Path, monkeypatch: pytest.MonkeyPatch, more: str
) -> None:
    browser = shared / "browser"
    browser.write_text('#!/bin/sh\necho "$@" > "$0.said"\nexec sleep 45 >&- 2>&-\n')
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s {more}".strip())
    with live(shared / "run", "--speed", "0.05", "--open") as server:
        leads = server.folder / "open.html"
        assert text_in(shared / "browser.said").strip() == leads.as_uri()
        assert server.address in leads.read_text()
        assert stat.S_IMODE(leads.stat().st_mode) == 0o600
        with viewer(server) as socket:
            said = [socket.recv(20) for _ in range(20)]
        assert sum(isinstance(each, bytes) for each in said) > 5  # rows, with the browser open
        ask_without_token(server.host)
        if os.geteuid() == 0:
            in_process(other_user_jobs.spy, server.token, str(shared), server.host)
        server.end()
    assert not leads.exists()
