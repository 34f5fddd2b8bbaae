"""Mutations of files: bytes, text, tables, archives; drawn from a seeded generator."""

from __future__ import annotations

import io
import json
import os
import re
import stat
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

Mutation = Callable[[Random, Path], None]

NUMBERS = (
    "1e308", "-1e308", "1e-320", "1e999", "nan", "inf", "-inf", "-0.0", "-1", "0", "1e-12",
    "9" * 400, "2147483648", "9223372036854775808", "1_000", "0x10", "1e", "", '""', "true", "[]",
    "{}", "null", "१२", "1,5",
)  # fmt: skip
ODD_TEXT = (
    "\0", "\x1b[31m", "\ufeff", "\u202e", "\u200b", "\u0430", "\uff11", "\u2028", "\ud7ff", "\r",
    "\x85", "'", '"', "\\", "\\u0000", "\\ud800", "&#0;", "<!--", "]]>", "%s", "{0}", "$x$", "../",
    "\U0001f600", "e\u0301", "=", "[", "]]", "\t", "#", ",", "\n",
)  # fmt: skip
TWINS = {"a": "\u0430", "e": "\u0435", "o": "\u043e", "c": "\u0441", "p": "\u0440", "x": "\u0445",
         "i": "\u0456", "s": "\u0455", "1": "\uff11", "0": "\uff10", "=": "\uff1d"}  # fmt: skip
MANY = 1_000_000  # rows or characters
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def of_bytes(drawn: Random, data: bytes) -> bytes:
    """Return bytes with bits flipped, a part cut, doubled, zeroed, or something put in."""
    changed = bytearray(data)
    at = drawn.randrange(len(data))
    length = drawn.choice((1, 2, 8, 100, len(data) // 3))
    match drawn.randrange(8):
        case 0:
            changed[at] ^= 1 << drawn.randrange(8)
        case 1:
            for _ in range(20):
                changed[drawn.randrange(len(data))] ^= 1 << drawn.randrange(8)
        case 2:
            del changed[at:]
        case 3:
            del changed[at : at + length]
        case 4:
            changed[at:at] = changed[at : at + length]
        case 5:
            changed[at : at + length] = bytes(len(changed[at : at + length]))
        case 6:
            changed[at:at] = drawn.randbytes(length)
        case _:  # the end, where parquet and zip have their tables of contents
            changed[-drawn.randrange(1, min(len(data), 600))] ^= 1 << drawn.randrange(8)
    return bytes(changed)


def of_text(drawn: Random, text: str) -> bytes:
    """Return text with an odd number, character, line, key, encoding or length."""
    lines = text.splitlines(keepends=True)
    at = drawn.randrange(len(text))
    row, other = drawn.randrange(len(lines)), drawn.randrange(len(lines))
    kind = drawn.randrange(16)
    if kind < 5:
        text = _odd_number(drawn, text)
    elif kind == 5:
        text = text[:at] + drawn.choice(ODD_TEXT) + text[at:]
    elif kind == 6:
        text = text[:at] + TWINS.get(text[at], "\u0430") + text[at + 1 :]
    elif kind == 7:
        lines[row], lines[other] = lines[other], lines[row]
        text = "".join(lines)
    elif kind == 8:
        text = "".join((*lines[: row + 1], *lines[row:]))
    elif kind == 9:
        text = "".join((*lines[:row], *lines[row + 1 :]))
    elif kind == 10:
        text = text[:at] + text[at + drawn.choice((1, 3, 30)) :]
    elif kind == 11:
        return text.encode(drawn.choice(("utf-16", "utf-16-le", "utf-32", "utf-8-sig", "cp037")))
    elif kind == 12:
        text = text[:at] + drawn.choice("[{(<x9\"' ") * drawn.choice((300, 20_000)) + text[at:]
    elif kind == 13:
        text = drawn.choice((text.replace("\n", "\r"), text.replace("\n", "\r\n"), "", text * 2))
    elif kind == 14:
        words = sorted(set(re.findall(r"[A-Za-z_]{3,}", text)))
        one, two = (
            drawn.choice(words or [text[:1]]),
            drawn.choice([*words, "nan", "__proto__", "x" * 10_000]),
        )
        text = text.replace(one, two, drawn.choice((1, -1)))
    else:
        return of_bytes(drawn, text.encode())
    return text.encode("utf-8", "surrogatepass")


def _odd_number(drawn: Random, text: str) -> str:
    found = list(NUMBER.finditer(text))
    if not found:
        return text + drawn.choice(NUMBERS)
    at = drawn.choice(found)
    return text[: at.start()] + drawn.choice(NUMBERS) + text[at.end() :]


def of_place(drawn: Random, path: Path) -> None:
    """Replace a file by something that is no file, or is one elsewhere."""
    data = path.read_bytes()
    path.unlink()
    match drawn.randrange(7):
        case 0:
            path.mkdir()
        case 1:
            path.symlink_to(path.name)
        case 2:
            path.symlink_to("/dev/zero")
        case 3:
            os.mkfifo(path)
        case 4:
            path.write_bytes(b"")
        case 5:
            path.symlink_to("no such file")
        case _:
            (path.parent / "elsewhere").write_bytes(data)
            path.symlink_to("elsewhere")


def text_file(drawn: Random, path: Path) -> None:
    """Mutate a text file; seldom more than once, seldom into 10^6 rows."""
    kind = drawn.randrange(40)
    if kind == 0:
        text = path.read_text(encoding="utf-8")
        last = text.rstrip("\n").rpartition("\n")[2] + "\n"
        path.write_text(text + last * (MANY // (10 if len(last) > 60 else 1)), encoding="utf-8")
        return
    if kind < 4:
        of_place(drawn, path)
        return
    data = of_text(drawn, path.read_text(encoding="utf-8"))
    if kind < 12 and data:
        data = of_text(drawn, data.decode("utf-8", "replace"))
    path.write_bytes(data)


def parquet_file(drawn: Random, path: Path) -> None:
    """Mutate a table: its bytes, cells, columns, types, rows or metadata."""
    kind = drawn.randrange(20)
    if kind == 0:
        of_place(drawn, path)
    elif kind < 8:
        path.write_bytes(of_bytes(drawn, path.read_bytes()))
    else:
        table = pq.read_table(path)
        if kind < 12 and table.schema.metadata:
            changed = _other_metadata(drawn, table)
        else:
            changed = _other_table(drawn, table)
        pq.write_table(changed, path)


def _other_metadata(drawn: Random, table: pa.Table) -> pa.Table:
    metadata = dict(table.schema.metadata)
    key = drawn.choice(sorted(metadata))
    text = metadata.pop(key).decode()
    match drawn.randrange(4):
        case 0:
            pass
        case 1:
            metadata[key] = of_bytes(drawn, text.encode())
        case _:
            metadata[key] = of_json(drawn, text)
    return table.replace_schema_metadata(metadata)


def _other_table(drawn: Random, table: pa.Table) -> pa.Table:  # noqa: PLR0911, PLR0912
    number = drawn.randrange(table.num_columns)
    field, rows = table.schema.field(number), table.num_rows
    cells = table.column(number)
    match drawn.randrange(13):
        case 0:
            return table.drop_columns([field.name])
        case 1:
            return table.slice(0, drawn.choice((0, 1, 2)))
        case 2:
            order = np.arange(rows)
            one, other = drawn.randrange(rows), drawn.randrange(rows)
            order[[one, other]] = order[[other, one]]
            return table.take(order)
        case 3:
            return pa.concat_tables([table, table])
        case 4:
            other = pa.array(["x"] * rows)
        case 5:
            other = pa.nulls(rows, cells.type)
        case 6:
            other = pa.array([[1.0]] * rows)
        case 7:
            return table.append_column(field, cells)
        case 8:
            names = list(table.column_names)
            names[number] = drawn.choice(
                ("", "\0", "a.b.c[", "x" * 10_000, "<b>", "time", f"{field.name}[1]", "\u202e.x")
            )
            return table.rename_columns(names)
        case 9:
            other = pa.array([drawn.choice((True, None)) for _ in range(rows)])
        case _:
            values = cells.to_pylist()
            value = float(drawn.choice(("nan", "inf", "-inf", "1e308", "1e-320", "-1", "1e15")))
            where = slice(None) if drawn.random() < 0.3 else slice(rows // 2, rows // 2 + 1)
            if not isinstance(values[0], float):
                other = pa.array([value] * rows)
            else:
                values[where] = [value] * len(values[where])
                other = pa.array(values)
    return table.set_column(number, field.name, other)


def of_json(drawn: Random, text: str) -> bytes:
    """Return JSON with one value replaced, removed or made odd; or the text mutated."""
    if drawn.random() < 0.3:
        return of_text(drawn, text)
    try:
        value = json.loads(text)
    except ValueError:
        return of_text(drawn, text)
    places = list(_places(value))
    if not places:
        return of_text(drawn, text)
    holder, key = drawn.choice(places)
    if drawn.random() < 0.2:
        del holder[key]
    else:
        holder[key] = drawn.choice(
            (None, True, -1, 0, 1e308, 5e-324, 10**30, 1.5, "", "x", "\0", "\u202e<b>", [], {},
             [[1]], {"a": 1}, float("nan"), float("inf"), "x" * 10_000, ["a", 1], [None], "../x")
        )  # fmt: skip
    return json.dumps(value).encode()


def _places(value: object) -> list[tuple[object, object]]:
    if not isinstance(value, (dict, list)):
        return []
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    inner = [place for key in keys for place in _places(value[key])]
    return [*((value, key) for key in keys), *inner]


def json_file(drawn: Random, path: Path) -> None:
    """Mutate a JSON file, or one line of a file of JSON lines."""
    if drawn.random() < 0.3:
        text_file(drawn, path)
        return
    lines = path.read_text(encoding="utf-8").splitlines()
    if path.suffix == ".jsonl":
        row = drawn.randrange(len(lines))
        lines[row] = of_json(drawn, lines[row]).decode("utf-8", "replace")
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    else:
        path.write_bytes(of_json(drawn, "\n".join(lines)))


def archive(texts: Sequence[str], resources: Sequence[str] = ()) -> Mutation:
    """Return what mutates archives: their structure and the texts in them, never a library.

    Args:
        texts: Names of the members whose text is mutated.
        resources: Names of further members that may be mutated as bytes.
    """

    def mutate(drawn: Random, path: Path) -> None:
        kind = drawn.randrange(24)
        if kind == 0:
            of_place(drawn, path)
        elif kind < 4:
            _directory(drawn, path)
        else:
            with zipfile.ZipFile(path) as source:
                members = [(info.filename, source.read(info)) for info in source.infolist()]
            _rewrite(drawn, path, members, kind)

    def _rewrite(drawn: Random, path: Path, members: list[tuple[str, bytes]], kind: int) -> None:
        names = [name for name, _ in members]
        name = drawn.choice(list(texts))
        at = names.index(name)
        data = members[at][1]
        extra: list[tuple[str | zipfile.ZipInfo, bytes]] = []
        if kind < 15:
            members[at] = (name, of_text(drawn, data.decode()))
        elif kind == 15 and resources:
            at = names.index(drawn.choice(list(resources)))
            members[at] = (names[at], of_bytes(drawn, members[at][1]))
        elif kind == 16:
            del members[drawn.randrange(len(members))]
        elif kind == 17:
            extra.append((drawn.choice((name, name.upper(), name.title(), name + "/x")), data))
        elif kind == 18:
            odd = ("../up", "/tmp/absolute", "C:\\x", "a\\..\\b", "nul\0x", "x" * 5000, "a/./b",
                   "/", "\u202ename", "resources/../../x", "a" + "/a" * 500)  # fmt: skip
            extra.append((drawn.choice(odd), b"x"))
        elif kind == 19:
            link = zipfile.ZipInfo(drawn.choice(("resources/link", "extra", name)))
            link.create_system = 3
            link.external_attr = (stat.S_IFLNK | 0o777) << 16
            extra.append((link, drawn.choice((b"/etc/passwd", b"../..", b"link"))))
        elif kind == 20:
            members[at] = (name, path.read_bytes()[:400_000])
        elif kind == 21:
            extra.append(("resources/big", bytes(10**8)))
        elif kind == 22:
            extra.extend((f"resources/{i}", b"") for i in range(20_000))
        else:
            one = drawn.randrange(len(members))
            members[one], members[at] = (members[one][0], data), (name, members[one][1][: 10**6])
            if members[one][0].endswith((".so", ".dll", ".dylib")):
                members[one] = (members[one][0], b"")
        target = io.BytesIO()
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made:
            for member, content in (*members, *extra):
                made.writestr(member, content)
        path.write_bytes(target.getvalue())

    return mutate


def _directory(drawn: Random, path: Path) -> None:
    """Mutate an archive's table of contents, which stands at its end, or cut the archive."""
    data = bytearray(path.read_bytes())
    if drawn.random() < 0.3:
        del data[drawn.randrange(len(data)) :]
    else:
        begin = data.rfind(b"PK\x01\x02", 0, len(data) - drawn.randrange(400))
        for _ in range(drawn.choice((1, 1, 5))):
            data[drawn.randrange(max(begin, 0), len(data))] ^= 1 << drawn.randrange(8)
    path.write_bytes(bytes(data))
