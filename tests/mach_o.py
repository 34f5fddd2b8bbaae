"""Reads the load commands of a Mach-O file, as <mach-o/loader.h> lays them out."""

import struct
from dataclasses import dataclass, field

MAGIC, FAT_MAGIC = 0xFEEDFACF, 0xCAFEBABE
X86_64, ARM64 = 0x01000007, 0x0100000C
DYLIB, MACOS = 6, 1
_LOAD_DYLIB, _LOAD_WEAK, _REEXPORT, _ID_DYLIB = 0xC, 0x80000018, 0x8000001F, 0xD
_SYMTAB, _CODE_SIGNATURE, _BUILD_VERSION = 0x2, 0x1D, 0x32
_HEADER, _SYMBOL = "<IiiIIIII", "<IBBHQ"
_EXTERNAL, _TYPE, _SECTION = 0x01, 0x0E, 0x0E  # of a symbol's n_type


@dataclass
class MachO:
    """A Mach-O file for one processor."""

    processor: int  # cputype
    kind: int  # filetype
    name: str = ""  # install name
    needs: list[str] = field(default_factory=list)  # libraries that it is linked with
    platform: int = 0
    minimum: tuple[int, int] = (0, 0)  # lowest version of macOS
    signed: bool = False  # or an ARM Mac loads nothing
    exports: set[str] = field(default_factory=set)


def read(content: bytes) -> MachO:
    """Read a file of one processor."""
    magic, processor, _, kind, count, size, *_ = struct.unpack_from(_HEADER, content)
    assert magic == MAGIC, f"magic {magic:#x}: no Mach-O file of 64 bits"
    file, at = MachO(processor, kind), struct.calcsize(_HEADER)
    end = at + size
    for _ in range(count):
        command, length = struct.unpack_from("<II", content, at)
        _take(file, command, content[at : at + length], content)
        at += length
    assert at == end, f"load commands end at {at}; must be {end}"
    return file


def slices(content: bytes) -> list[MachO]:
    """Read a file of one processor or of several."""
    if struct.unpack_from(">I", content)[0] != FAT_MAGIC:
        return [read(content)]
    (count,) = struct.unpack_from(">I", content, 4)
    places = [struct.unpack_from(">iiIII", content, 8 + 20 * i)[2:4] for i in range(count)]
    return [read(content[first : first + size]) for first, size in places]


def _take(file: MachO, command: int, words: bytes, content: bytes) -> None:
    if command in (_LOAD_DYLIB, _LOAD_WEAK, _REEXPORT):
        file.needs.append(_text(words))
    elif command == _ID_DYLIB:
        file.name = _text(words)
    elif command == _BUILD_VERSION:
        file.platform, version = struct.unpack_from("<II", words, 8)
        file.minimum = version >> 16, version >> 8 & 0xFF
    elif command == _SYMTAB:
        file.exports = _exports(content, *struct.unpack_from("<4I", words, 8))
    file.signed |= command == _CODE_SIGNATURE


def _text(words: bytes) -> str:
    (first,) = struct.unpack_from("<I", words, 8)
    return words[first:].split(b"\0")[0].decode()


def _exports(content: bytes, first: int, count: int, texts: int, size: int) -> set[str]:
    names, exports = content[texts : texts + size], set()
    for i in range(count):
        at, kind, *_ = struct.unpack_from(_SYMBOL, content, first + i * struct.calcsize(_SYMBOL))
        if kind & _EXTERNAL and kind & _TYPE == _SECTION and not kind & 0x10:  # not private
            exports.add(names[at:].split(b"\0")[0].decode())
    return exports
