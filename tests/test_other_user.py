"""Other users of the machine: nothing of theirs is loaded, and a live run is not theirs."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.master.archive import unpack
from panda_cosim.fmus.packaging.cache import cache_folder
from test_archive import ORIGINAL, make
from test_live import Live, asked, live

OTHER = 12345  # id of a user
as_root = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can be another user, too"
)


def as_other(act: Callable[[], object]) -> None:
    """Do something as another user, in a process of its own."""
    child = os.fork()
    if not child:
        code = 1
        try:
            os.setgroups([])
            os.setgid(OTHER)
            os.setuid(OTHER)
            act()
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    assert os.waitpid(child, 0)[1] == 0


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder that all may write to, as /tmp is."""
    folder = Path(tempfile.mkdtemp(prefix="panda-cosim-test-"))
    folder.chmod(0o1777)
    yield folder
    shutil.rmtree(folder)


def plant(cache: Path) -> None:
    """Write an unpacked FMU with another library."""
    for name, content in ORIGINAL:
        path = cache / "unpacked" / "out" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content + b"x" * name.endswith(".so"))


def linked(link: Path, target: Path) -> None:
    """Make a symlink, or turn it to another target."""
    link.unlink(missing_ok=True)
    link.symlink_to(target)


@as_root
@pytest.mark.parametrize("way", ["their cache", "a symlink to it", "our cache in their folder"])
def test_nothing_of_another_users_cache_is_loaded(
    shared: Path, tmp_path: Path, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make(tmp_path / "x.fmu", lambda f: [f.writestr(*m) for m in ORIGINAL])
    ours = way == "our cache in their folder"  # where they may put theirs in its place
    cache, link = shared / "theirs" / ("cache" if ours else ""), shared / "link"
    as_other(lambda: (plant(cache), linked(link, cache)))
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
    as_other(lambda: (plant(theirs), linked(link, tmp_path / "cache")))
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(link))
    folder = unpack(path, cache_folder() / "unpacked" / "out")
    as_other(lambda: linked(link, theirs))
    assert {name: (folder / name).read_bytes() for name, _ in ORIGINAL} == dict(ORIGINAL)


def look_for(token: str, folder: Path) -> None:
    """Check that a token is in no file, and in no process's arguments, that one can read."""
    for path in (*Path("/proc").glob("[0-9]*/cmdline"), *folder.rglob("*")):
        try:
            content = path.read_bytes()
        except OSError:  # a folder, not ours to read, or gone
            continue
        assert token.encode() not in content, path


def act_without_token(server: Live) -> None:
    """Ask for all that the server has."""
    for path in ("/", "/live", "/session.zip"):
        assert asked(server, path) == (403, b"")


def test_the_browser_gets_the_token_in_a_file_of_the_users_own(
    shared: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    browser = shared / "browser"
    browser.write_text('#!/bin/sh\necho "$@" > "$0.said"\nsleep 3\n')
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s &")
    with live(shared / "run", "--speed", "0.05", "--open") as server:
        leads = server.folder / "open.html"
        while not (said := shared / "browser.said").exists() or not said.read_text():
            time.sleep(0.01)
        assert said.read_text().strip() == leads.as_uri()
        assert server.address in leads.read_text()
        assert stat.S_IMODE(leads.stat().st_mode) == 0o600
        act_without_token(server)  # also loads what the other user may not read
        if os.geteuid() == 0:
            as_other(lambda: (look_for(server.token, shared), act_without_token(server)))
        server.end()
    assert not leads.exists()
