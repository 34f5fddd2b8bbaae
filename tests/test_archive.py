"""Archives and XML from elsewhere: unpacked whole and inside their folder, or refused in a line."""

import os
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.reading import file_digest, read_xml, unpack

Write = Callable[[zipfile.ZipFile], object]


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
def test_a_member_outside_the_archive_is_written_inside(tmp_path: Path, name: str) -> None:
    path = make(tmp_path / "bad.fmu", named("good", name))
    folder = unpack(path, tmp_path / "deep" / "out")
    assert sorted(p.name for p in folder.rglob("*") if p.is_file()) == ["evil", "good"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.fmu", "deep"]


def check_message(error: InputError, path: Path) -> None:
    message = str(error)
    assert path.name in message
    assert message.isprintable(), message


def test_a_link_in_an_archive_is_no_link_when_unpacked(tmp_path: Path) -> None:
    folder = unpack(make(tmp_path / "x.fmu", link), tmp_path / "cache" / "out")
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
def test_a_damaged_archive_is_refused_and_nothing_is_written(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "bad.fmu"
    DAMAGED[kind](path)
    with pytest.raises(InputError) as refused:
        unpack(path, tmp_path / "cache" / "out")
    check_message(refused.value, path)
    assert list((tmp_path / "cache").iterdir()) == []


def test_what_is_not_a_plain_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.fmu")
    for path in (tmp_path / "pipe.fmu", Path("/dev/zero"), tmp_path, tmp_path / "missing.fmu"):
        with pytest.raises(InputError, match=r"not a regular file|no such file"):
            file_digest(path)
    for path in (Path("a\0b"), Path("a\nb"), tmp_path / ("n" * 300)):
        with pytest.raises(InputError, match=r"cannot be read|no such file") as refused:
            file_digest(path)
        assert str(refused.value).isprintable()


ORIGINAL = [
    ("modelDescription.xml", b"<x/>"),
    ("binaries/linux64/m.so", bytes(range(256)) * 4),
    ("resources/a.py", b"pass\n" * 50),
    ("resources/__init__.py", b""),
]


def test_an_archive_is_unpacked_whole_and_once(tmp_path: Path) -> None:
    path = make(tmp_path / "x.fmu", lambda f: [f.writestr(*m) for m in ORIGINAL])
    folder = unpack(path, tmp_path / "cache" / "out")
    assert {n: (folder / n).read_bytes() for n, _ in ORIGINAL} == dict(ORIGINAL)
    before = folder.stat().st_ino
    assert unpack(path, folder) == folder
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
def test_xml_that_cannot_be_read_is_refused(tmp_path: Path, kind: str) -> None:
    text, expected = XML[kind]
    (tmp_path / "secret").write_text("SECRET")
    path = tmp_path / "x.xml"
    path.write_text(text.replace("{secret}", f"file://{tmp_path}/secret"))
    with pytest.raises(InputError, match=expected) as refused:
        read_xml(path, "x.fmu: x.xml")
    check_message(refused.value, Path("x.fmu"))
    assert "SECRET" not in str(refused.value)
