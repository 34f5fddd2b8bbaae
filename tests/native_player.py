"""FMUs of the table player, and what is checked on them, each check in a process of its own."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from native_support import ERROR, OK, TIME, Instance, Row, Table, unpacked

ROWS = [[10.0 * k + i for i in range(4)] for k in range(5)]
TABLE = Table(
    (
        Row("a", shape=(3,)),
        Row("b"),
        Row("table", "parameter", variability="fixed", kind="String"),
        TIME,
    ),
    (("table", "table.bin"),),
)
CHECKS: list[Callable[[Path, int], None]] = []


def check(function: Callable[[Path, int], None]) -> Callable[[Path, int], None]:
    """Collect a check."""
    CHECKS.append(function)
    return function


def build(folder: Path) -> Path:
    """Write the FMU."""
    content = b"".join(struct.pack("<4d", *row) for row in ROWS)
    return unpacked(folder, "player", TABLE, {"table.bin": content})


def shown(it: Instance) -> list[float]:
    """The outputs of now."""
    return it.get("a") + it.get("b")


@check
def a_csv_file_is_refused(folder: Path, version: int) -> None:
    it = Instance(folder, TABLE, version)
    it.set("table", b"/some.csv")
    it.enter()
    assert it("ExitInitializationMode") == ERROR
    assert "/some.csv: a native FMU plays only the table that it was built with" in it.messages()
    it.set("table", b"")
    assert it("ExitInitializationMode") == OK
    assert shown(it) == ROWS[0]
    it.free()


@check
def a_damaged_built_in_table_is_refused(folder: Path, version: int) -> None:
    file = folder / "resources" / "table.bin"
    whole = file.read_bytes()
    for content in (whole[:-1], b""):
        file.write_bytes(content)
        with pytest.raises(AssertionError, match="not whole rows of 32"):
            Instance(folder, TABLE, version)
    file.write_bytes(whole)


def run(name: str, folder: str, version: int) -> None:
    """Run the check of a name."""
    next(c for c in CHECKS if c.__name__ == name)(Path(folder), version)
