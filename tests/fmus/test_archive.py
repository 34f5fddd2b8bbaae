"""Archives and XML from elsewhere: unpacked whole and inside their folder, or refused in a line."""

import os
import re
import shutil
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from fmu_support import needs_compiler
from panda_cosim.fmus.master.fmu_file import read_fmu
from panda_cosim.fmus.reading import ANY_SIZE, MOST_TIMES, read_xml, unpack
from refusals import refused
from toy_fmu import toy_fmu

Write = Callable[[zipfile.ZipFile], object]


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "unpacked"


def make(path: Path, write: Write, compression: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as file:
        write(file)
    return path


def named(*names: str) -> Write:
    """Return a writer of empty members, whose names zipfile would not make itself."""

    def write(file: zipfile.ZipFile) -> None:
        for name in names:
            info = zipfile.ZipInfo("x")
            info.filename = name
            file.writestr(info, b"text")

    return write


def link(file: zipfile.ZipFile) -> None:
    info = zipfile.ZipInfo("out")
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    file.writestr(info, "/etc")


@pytest.mark.parametrize("name", ["../evil", "a/../../evil", "/evil"])
def test_a_member_outside_the_archive_is_written_inside(tmp_path, name):
    path = make(tmp_path / "bad.fmu", named("good", name))
    folder, _ = unpack(path)
    assert sorted(p.name for p in folder.rglob("*") if p.is_file()) == ["evil", "good"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.fmu", "cache"]


def test_a_link_in_an_archive_is_no_link_when_unpacked(tmp_path):
    folder, _ = unpack(make(tmp_path / "x.fmu", link))
    assert not (folder / "out").is_symlink()
    assert (folder / "out").read_text() == "/etc"


def damaged_stored(path: Path) -> None:
    make(path, named("modelDescription.xml"), zipfile.ZIP_STORED)
    path.write_bytes(path.read_bytes().replace(b"text", b"texT"))


def encrypted(path: Path) -> None:
    make(path, named("a"))
    content = bytearray(path.read_bytes())
    content[content.index(b"PK\x01\x02") + 8] |= 1
    content[6] |= 1
    path.write_bytes(content)


DAMAGED: dict[str, Callable[[Path], None]] = {
    "empty": lambda path: path.touch(),
    "text": lambda path: path.write_text("this is no archive"),
    "half": lambda path: path.write_bytes(
        make(path, lambda f: f.writestr("a", os.urandom(999))).read_bytes()[:500]
    ),
    "wrong checksum": damaged_stored,
    "encrypted": encrypted,
}


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_damaged_archive_is_refused_and_nothing_is_written(tmp_path, cache, kind):
    path = tmp_path / "bad.fmu"
    DAMAGED[kind](path)
    assert path.name in refused(unpack, path)
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize("members", [1, 20], ids=["one large member", "many"])
def test_an_archive_that_grows_too_much_is_refused_at_once(tmp_path, cache, members):
    zeros, path = bytes(ANY_SIZE // members + 1), tmp_path / "bomb.fmu"
    make(path, lambda f: [f.writestr(f"{i}", zeros) for i in range(members)])
    assert MOST_TIMES * path.stat().st_size < members * len(zeros)
    told = refused(unpack, path)
    assert re.search("bomb.fmu: .* would be 100 MB unpacked; must be at most 100 MB", told)
    assert list(cache.iterdir()) == []


def test_what_is_not_a_plain_file_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.fmu")
    for path in (tmp_path / "pipe.fmu", Path("/dev/zero"), tmp_path, tmp_path / "missing.fmu"):
        assert re.search("not a regular file|no such file", refused(unpack, path))
    for path in (Path("a\0b"), Path("a\nb"), tmp_path / ("n" * 300)):
        assert re.search("cannot be read|no such file", refused(unpack, path))


ORIGINAL = [
    ("modelDescription.xml", b"<x/>"),
    ("binaries/linux64/m.so", bytes(range(256)) * 4),
    ("resources/a.py", b"pass\n" * 50),
    ("resources/__init__.py", b""),
    ("resources\\of_windows.txt", b"text"),
]


def test_an_archive_is_unpacked_whole_and_once(tmp_path):
    path = make(tmp_path / "x.fmu", lambda f: [f.writestr(*m) for m in ORIGINAL])
    folder, _ = unpack(path)
    assert {n: (folder / n.replace("\\", "/")).read_bytes() for n, _ in ORIGINAL} == dict(ORIGINAL)
    before = folder.stat().st_ino
    assert unpack(path)[0] == folder
    assert folder.stat().st_ino == before


BOMB = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 12))
XML = {
    "external entity": ('<!DOCTYPE a [<!ENTITY x SYSTEM "{secret}">]><a>&x;</a>', "undefined"),
    "entity bomb": (f'<!DOCTYPE a [<!ENTITY e0 "x">{BOMB}]><a>&e11;</a>', "not well-formed"),
    "open": ("<a><b></a>", "not well-formed"),
    "empty": ("", "not well-formed"),
    "unknown encoding": ('<?xml version="1.0" encoding="klingon"?><a/>', "not well-formed|decoded"),
}


@pytest.mark.parametrize("kind", XML)
def test_xml_that_cannot_be_read_is_refused(tmp_path, kind):
    text, expected = XML[kind]
    (tmp_path / "secret").write_text("SECRET")
    path = tmp_path / "x.xml"
    path.write_text(text.replace("{secret}", f"file://{tmp_path}/secret"))
    told = refused(read_xml, path, "x.fmu: x.xml")
    assert re.search(f"x.fmu.*({expected})", told)
    assert "SECRET" not in told


@needs_compiler
def test_an_fmu_is_unpacked_again_once_the_cache_was_cleared(tmp_path, cache):
    path = toy_fmu(tmp_path / "toy.fmu", 2)
    first = read_fmu(path)
    assert read_fmu(path) is first
    shutil.rmtree(cache)
    again = read_fmu(path)
    assert again.library.is_file()
    assert again.library == first.library
