"""FMUs of the table player, and what is checked on them, each check in a process of its own."""

from __future__ import annotations

import locale
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from native_support import ERROR, OK, TIME, Instance, Row, Table, comma_locale, unpacked

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


def csv(rows: list[list[float]], step: float = 0.001) -> str:
    """A table as a person writes it."""
    lines = ['time,"a[1]",a[2],a[3],b']
    lines += [",".join(map(repr, [k * step, *row])) for k, row in enumerate(rows)]
    return "\n".join(lines) + "\n"


@check
def rows_are_played_one_each_step_and_the_last_one_stays(folder: Path, version: int) -> None:
    it = Instance(folder, TABLE, version).start()
    assert shown(it) == ROWS[0]
    for k in range(1, 8):
        assert it.step((k - 1) * 0.001) == OK
        assert shown(it) == ROWS[min(k, 4)]
    it.free()
    for start, row in ((0.002, 2), (-5.0, 0), (100.0, 4)):
        it = Instance(folder, TABLE, version).start(start)
        assert shown(it) == ROWS[row]
        it.free()


@check
def a_state_is_a_place_in_the_table(folder: Path, version: int) -> None:
    it = Instance(folder, TABLE, version).start()
    it.steps(2)
    state = it.save()
    it.steps(1, first=2)
    assert it.load(state) == OK
    assert shown(it) == ROWS[2]
    it.steps(1, first=2)
    assert shown(it) == ROWS[3]
    it.drop(state)
    it.free()


@check
def a_csv_file_takes_the_tables_place_in_any_locale(folder: Path, version: int) -> None:
    rows = [[0.5, -1e-3, 1e300, float(k) / 3] for k in range(4)]
    path, comma = folder.parent / "täble.csv", comma_locale(folder.parent)
    for text in (csv(rows), csv(rows).replace("\n", "\r\n"), csv(rows).rstrip("\n")):
        path.write_bytes(text.encode())
        for name in (comma, "C"):
            locale.setlocale(locale.LC_NUMERIC, name)
            assert (locale.localeconv()["decimal_point"] == ",") == (name == comma)
            it = Instance(folder, TABLE, version)
            assert it.set("table", str(path).encode()) == OK
            it.start()
            assert shown(it) == rows[0]
            it.steps(2)
            assert shown(it) == rows[2]
            it.free()


@check
def a_csv_file_that_does_not_fit_is_refused_with_its_line(folder: Path, version: int) -> None:
    path = folder.parent / f"bad{version}.csv"
    good = csv(ROWS)
    cases = {
        good.replace("a[2]", "c"): "line 1: the columns must be time",
        good.replace("20.0", "x"): "line 4: 5 finite numbers are needed",
        good.replace("20.0", "nan"): "line 4: 5 finite numbers",
        good.replace("20.0,", ""): "line 4: 5 finite numbers",
        good.replace("0.002", "0.0025"): "line 4: time 0.0025 s; must be 0.002 s",
        good.partition("\n")[0] + "\n": "has no rows",
        good.partition("\n")[0]: "line 1",
        "": "line 1",
    }
    for text, reason in cases.items():
        path.write_text(text)
        it = Instance(folder, TABLE, version)
        it.set("table", str(path).encode())
        it.enter()
        assert it("ExitInitializationMode") == ERROR
        assert reason in it.messages(), it.messages()
        it.set("table", b"/nowhere.csv")
        assert it("ExitInitializationMode") == ERROR
        assert "/nowhere.csv cannot be read: No such file" in it.messages()
        it.set("table", b"")  # the built-in one again
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
