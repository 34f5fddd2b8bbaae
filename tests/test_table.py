"""Every table is read right or refused in one line that says what would be valid."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from panda_cosim.fmus.errors import InputError
from panda_cosim.task.table import COLUMNS, TableRow, read_tables

HEAD = "time,frame,x,y,z,qw,qx,qy,qz,grip\n"
SHORT = "time,frame,x,y,z,grip\n"
A = "0,home,0,0,0,,,,,0.08\n"
B = "1,target,0,0,0.1,0,1,0,0,0.02\n"
GOOD = HEAD + A + B


def with_cell(column: str, text: str) -> str:
    """Return a table whose second row (line 3) has another text in one column."""
    cells = dict(zip(COLUMNS, B.strip().split(","), strict=True))
    return HEAD + A + ",".join({**cells, column: text}.values()) + "\n"


# What the file holds, and what the message must say.
BAD_TABLES = {
    "empty": ("", "is empty"),
    "one row": (HEAD + A, "1 rows; must be 2 to 100000"),
    "latin-1": (GOOD.replace("home", "h\xf6me").encode("latin-1"), "line 2: byte 0xf6"),
    "no header": (A + B, "line 1: column '0' is unknown"),
    "semicolons": (GOOD.replace(",", ";"), "must be separated by commas"),
    "column missing": (GOOD.replace("z,", "height,", 1), "column 'height' is unknown"),
    "no grip column": (
        "time,frame,x,y,z\n0,home,0,0,0\n1,home,0,0,0\n",
        "grip: missing; must have the columns time, frame, x, y, z, grip",
    ),
    "column repeated": (GOOD.replace("qx", "qw"), "column 'qw' occurs 2 times; must occur once"),
    "one quaternion column missing": (
        "time,frame,x,y,z,qw,qx,qy,grip\n" + "0,home,0,0,0,,,,0\n",
        "qz: missing; must have the columns time, frame, x, y, z, qw, qx, qy, qz, grip",
    ),
    "row too short": (HEAD + A + "1,home,0,0\n", "line 3: 4 values; must be 10"),
    "open quote": (HEAD + A + '1,"home,0,0,0,,,,,0\n', "line 3: unexpected end of data"),
    "decimal comma": (with_cell("y", '"0,5"'), "with a decimal point"),
    "millimetres": (with_cell("z", "185"), "column z: value 185.0; must be a number from -10"),
    "time repeats": (with_cell("time", "0"), "line 3: column time: value 0.0 repeats"),
    "time goes back": (
        GOOD + A.replace("0,", "0.5,", 1),
        "line 4: column time: value 0.5 goes back",
    ),
    "times too close": (with_cell("time", "1e-9"), "is too close; must be at least 1e-06 s after"),
    "frame misspelt": (with_cell("frame", "tagret"), "did you mean 'target'?"),
    "quaternion of zero length": (with_cell("qx", "0"), "of length 0; must be longer than 0"),
    "quaternion partly blank": (with_cell("qz", ""), "column qz is blank; qw to qz must be all"),
}


def write(folder: Path, content: str | bytes) -> Path:
    path = folder / "trajectory.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize(("content", "expected"), BAD_TABLES.values(), ids=BAD_TABLES.keys())
def test_a_bad_table_is_refused_in_one_line_that_says_where_and_why(tmp_path, content, expected):
    path = write(tmp_path, content)
    with pytest.raises(InputError) as caught:
        read_tables(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert expected in message
    assert message.isprintable()
    assert len(message) < 400 + len(str(path))


@pytest.mark.parametrize("kind", ["missing", "folder", "pipe", "null byte", "name too long"])
def test_what_is_not_a_plain_file_is_refused_without_waiting_for_it(tmp_path, kind):
    path = tmp_path / "trajectory.csv"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "null byte":
        path = tmp_path / "a\0b.csv"
    elif kind == "name too long":
        path = tmp_path / ("a" * 5000)
    with pytest.raises(InputError):
        read_tables(path)


@pytest.mark.parametrize(
    "content",
    [
        GOOD,
        "\ufeff" + GOOD.replace("\n", "\r\n"),
        GOOD.rstrip(),
        GOOD.replace("\n", "\n\n"),
        GOOD.replace(",", " , "),
        GOOD.replace("home", '"home"'),
        GOOD.replace("0,1,0,0,0.02", "0,7.5,0,0,0.02"),
        GOOD.replace("0,1,0,0,0.02", "0,1e-3,0,0,2e-2"),
        "grip,frame,time,qz,qy,qx,qw,z,y,x\n0.08,home,0,,,,,0,0,0\n0.02,target,1,0,0,1,0,.1,0,0\n",
    ],
)
def test_harmless_variants_of_a_table_mean_the_same(tmp_path, content):
    table, _ = read_tables(write(tmp_path, content))
    assert table.rows == (
        TableRow(0.0, "home", (0.0, 0.0, 0.0), 0.08),
        TableRow(1.0, "target", (0.0, 0.0, 0.1), 0.02, (0.0, 1.0, 0.0, 0.0)),
    )


FUZZ = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
CELL = st.one_of(
    st.sampled_from(["0", "1", "0.05", "nan", "1e400", "", "home", "target", '"', "\r", "-1"]),
    st.text(max_size=5),
)


@FUZZ
@given(
    content=st.one_of(
        st.binary(max_size=200),
        st.lists(st.lists(CELL, min_size=8, max_size=11).map(",".join), max_size=5).map(
            lambda lines: (HEAD + "\n".join(lines)).encode("utf-8", "surrogatepass")
        ),
    )
)
def test_no_content_at_all_gives_anything_but_a_table_or_one_line(tmp_path, content):
    path = write(tmp_path, content)
    try:
        table, _ = read_tables(path)
    except InputError as error:
        assert str(error).isprintable()  # noqa: PT017  # most contents are refused, not all
    else:
        assert len(table.rows) >= 2


@pytest.mark.parametrize("blank", ["", "  ", ",,,,,,"])
def test_blank_lines_change_neither_rows_nor_inputs(tmp_path, blank):
    path, read = tmp_path / "trajectory.csv", []
    lines = [f"{SHORT.strip()},plant.block_force[1]", "0,home,0,0,0,0.08,3", "1,home,0,0,0,0.08,4"]
    for place in (None, 0, 1, 3):
        more = lines if place is None else [*lines[:place], blank, *lines[place:]]
        path.write_text("\n".join(more) + "\n")
        read.append(read_tables(path))
    assert read == read[:1] * 4
    assert read[0][1].columns == {"plant.block_force[1]": ("3", "4")}
