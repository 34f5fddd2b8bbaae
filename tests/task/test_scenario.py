"""Every scenario is read right or refused in one line that says what would be valid."""

import os
import sys
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

import panda_cosim
from bounded import ran
from panda_cosim import InputError, TableRow, load_scenario
from panda_cosim.fmus.master.step import COUPLINGS
from panda_cosim.task import scenario as scenario_module
from panda_cosim.task.table import COLUMNS, read_tables
from refusals import refused

TABLE = "time,frame,x,y,z,grip\n0,home,0,0,0,0.08\n1,home,0,0,-0.1,0.08\n"
GOOD = 'purpose = "A test"\nduration = 1.5\n'

PLACE = GOOD + "[success]\nblock_position = [{}, 0, 0]\n"

# What scenario.toml holds, and what the message must say.
BAD_SCENARIOS = {
    "empty": ("", "key duration is missing"),
    "latin-1": ('purpose = "h\xf6her"\n'.encode("latin-1"), "line 1: invalid start byte; must"),
    "too large": ("#" * 65_537, "is too large; must be at most 65536 bytes"),
    "key twice": (GOOD + "duration = 2\n", "at line 3"),
    "key misspelt": ("durration = 1.0\n", "did you mean 'duration'?"),
    "key unknown": (GOOD + "colour = 1\n", "key 'colour' is unknown; valid: duration, purpose"),
    "duration too long": ("duration = 3600.001\n", "must be a number from 0.001 to 3600 s"),
    "duration of 400 digits": ("duration = " + "9" * 400, "an integer of 1329 bits"),
    "duration no whole tick": ("duration = 1.0005\n", "must be a whole number of ticks of 0.001"),
    "scene unknown": (GOOD + 'scene = "tabeltop"\n', "did you mean 'tabletop'?"),
    "align number": (GOOD + "align = 1\n", "key align: must be true or false"),
    "purpose of two lines": ('duration = 1.0\npurpose = "a\\nb"\n', "must be one line of at most"),
    "plant no section": (GOOD + "plant = 3\n", "key plant: must be a section [plant]"),
    "parameter dotted": (GOOD + "[plant]\nblock.mass = 1\n", "[plant] block: is a section"),
    "scene among parameters": (GOOD + '[plant]\nscene = "tutorial"\n', "must stand at the top"),
    "place far away": (PLACE.format(600) + "position_tolerance = 0.1\n", "from -10 to 10 m"),
    "place without tolerance": (PLACE.format(0.6), "one is missing; must be both or neither"),
    "push no list": (GOOD + "push = 1\n", "key push: must be sections [[push]]"),
    "order no list": (GOOD + 'order = "plant"\n', "key order: must be a list of texts"),
    "push incomplete": (GOOD + "[[push]]\nstart = 1.0\nduration = 0.1\n", "force is missing"),
    "push too strong": (
        GOOD + "[[push]]\nstart = 0\nduration = 1\nforce = [2000, 0, 0]\n",
        "[[push]] 1: force[1]: value 2000",
    ),
}


def write(folder: Path, toml: str | bytes = GOOD, table: str | bytes = TABLE) -> Path:
    """Make a scenario's folder."""
    folder.mkdir(exist_ok=True)
    for name, content in (("scenario.toml", toml), ("trajectory.csv", table)):
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return folder


@pytest.mark.parametrize(("toml", "expected"), BAD_SCENARIOS.values(), ids=BAD_SCENARIOS.keys())
def test_a_bad_scenario_is_refused_in_one_line_that_says_where_and_why(tmp_path, toml, expected):
    folder = write(tmp_path / "mine", toml)
    message = refused(load_scenario, folder)
    assert message.startswith(f"{folder / 'scenario.toml'}: ")
    assert expected in message
    assert len(message) < 440 + len(str(folder))


@pytest.mark.parametrize("missing", ["scenario.toml", "trajectory.csv"])
def test_a_folder_without_one_of_its_files_is_refused(tmp_path, missing):
    folder = write(tmp_path / "mine")
    (folder / missing).unlink()
    with pytest.raises(InputError, match=f"{missing}: no such file"):
        load_scenario(folder)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("pick_and_plaec", "did you mean 'pick_and_place'"),
        ("Tutorial", "did you mean 'tutorial'"),
        ("", "or a name from `panda-cosim list`"),
        ("a\0b", "no such folder"),
        ("x" * 5000, "no such folder"),
        (Path(__file__), "no such folder; must be one with scenario.toml"),
        ("lift/scenario.toml", "or a name from `panda-cosim list`; did you mean 'lift'"),
    ],
)
def test_an_unknown_scenario_is_refused_with_the_nearest(name, expected):
    assert expected in refused(load_scenario, name)


def test_a_shipped_name_goes_before_a_folder_of_that_name(tmp_path, monkeypatch):
    write(tmp_path / "tutorial")
    monkeypatch.chdir(tmp_path)
    assert load_scenario("tutorial").duration == 6.5
    assert load_scenario("./tutorial").duration == 1.5
    assert load_scenario(Path("tutorial")).duration == 1.5


@pytest.mark.parametrize(
    "toml", [GOOD, "\ufeff" + GOOD, GOOD.replace("\n", "\r\n"), GOOD + "# \u00e4\n"]
)
def test_byte_order_mark_line_ends_and_comments_do_no_harm(tmp_path, toml):
    scenario = load_scenario(write(tmp_path / "mine", toml))
    assert (scenario.name, scenario.purpose, scenario.ticks) == ("mine", "A test", 1500)


def test_parameters_are_kept_as_given_and_numbers_are_floats(tmp_path):
    toml = GOOD + (
        '[plant]\n"block_pos[1]" = 0.45\nblock_mass = 1\n'
        '[controller]\nkp = [1, 2.5, 3]\nhold = true\nmode = "a b"\n'
    )
    scenario = load_scenario(write(tmp_path / "mine", toml))
    assert scenario.plant == {"block_pos[1]": 0.45, "block_mass": 1.0}
    assert isinstance(scenario.plant["block_mass"], float)
    assert scenario.controller == {"kp": (1.0, 2.5, 3.0), "hold": True, "mode": "a b"}


def test_what_a_scenario_may_name_is_what_there_is():
    """The names stand here, too, since the module that defines them imports MuJoCo."""
    assert get_args(scenario_module.Coupling) == COUPLINGS


def test_each_public_name_is_there_and_no_other():
    assert set(panda_cosim.__all__) == set(dir(panda_cosim))
    assert all(getattr(panda_cosim, name) is not None for name in panda_cosim.__all__)
    with pytest.raises(AttributeError, match="no attribute 'run_scenari'"):
        _ = panda_cosim.run_scenari


HEAVY = {"pyarrow", "fmpy", "mujoco", "matplotlib", "scipy", "mediapy", "control"}


@pytest.mark.parametrize(
    ("what", "heavy"),
    [("__version__", {*HEAVY, "numpy", "typer", "rich"}), ("load_scenario('tutorial')", HEAVY)],
)
def test_neither_the_package_nor_a_scenario_imports_anything_heavy(what, heavy):
    code = f"import panda_cosim, sys; panda_cosim.{what}; print({heavy} & sys.modules.keys())"
    done = ran([sys.executable, "-c", code])
    assert done.stdout.strip() == "set()"


VALUE = st.sampled_from(["1", "-1", "nan", "true", '"x"', "[]", "[1, 2]", "{}", "{a = 1}", "1e400"])
KEY = st.sampled_from(
    ["duration", "purpose", "scene", "align", "plant", "controller", "success", "x", '"a[1]"']
)


@given(
    st.one_of(
        st.binary(max_size=100),
        st.text(alphabet='[]{}"=.#\n aeinf19', max_size=60).map(str.encode),
        st.dictionaries(KEY, VALUE, max_size=5).map(
            lambda keys: "\n".join(f"{key} = {value}" for key, value in keys.items()).encode()
        ),
    )
)
def test_no_content_at_all_gives_anything_but_a_scenario_or_one_line(tmp_path, content):
    folder = write(tmp_path / "mine", content)
    try:
        scenario = load_scenario(folder)
    except InputError as error:
        assert str(error).isprintable()  # noqa: PT017  # most contents are refused, not all
    else:
        assert scenario.ticks >= 1


# Every table is read right or refused in one line that says what would be valid.


HEAD = "time,frame,x,y,z,qw,qx,qy,qz,grip\n"
SHORT = "time,frame,x,y,z,grip\n"
A = "0,home,0,0,0,,,,,0.08\n"
B = "1,target,0,0,0.1,0,1,0,0,0.02\n"
GOOD_TABLE = HEAD + A + B


def with_cell(column: str, text: str) -> str:
    """Return a table whose second row (line 3) has another text in one column."""
    cells = dict(zip(COLUMNS, B.strip().split(","), strict=True))
    return HEAD + A + ",".join({**cells, column: text}.values()) + "\n"


# What the file holds, and what the message must say.
BAD_TABLES = {
    "empty": ("", "0 rows; must be 2"),
    "one row": (HEAD + A, "1 rows; must be 2 to 100000"),
    "latin-1": (GOOD_TABLE.replace("home", "h\xf6me").encode("latin-1"), "line 2: invalid start"),
    "no header": (A + B, "line 1: column '0' is unknown"),
    "semicolons": (GOOD_TABLE.replace(",", ";"), "must be separated by commas"),
    "column missing": (GOOD_TABLE.replace("z,", "height,", 1), "column 'height' is unknown"),
    "no grip column": ("time,frame,x,y,z\n0,home,0,0,0\n", "line 2: key grip is missing"),
    "column repeated": (GOOD_TABLE.replace(",grip", ",qw,grip"), "'qw' occurs 2 times; must occur"),
    "row too short": (HEAD + A + "1,home,0,0\n", "line 3: 4 values; must be 10"),
    "open quote": (HEAD + A + '1,"home,0,0,0,,,,,0\n', "line 3: unexpected end of data"),
    "decimal comma": (with_cell("y", '"0,5"'), "such as 0.25"),
    "millimetres": (with_cell("z", "185"), "column z: value 185.0; must be a number from -10"),
    "time repeats": (with_cell("time", "0"), "row 2: time: value 0.0; must be at least 1e-06 s"),
    "times too close": (with_cell("time", "1e-9"), "value 1e-09; must be at least 1e-06 s after"),
    "frame misspelt": (with_cell("frame", "tagret"), "did you mean 'target'?"),
    "quaternion of zero length": (with_cell("qx", "0"), "must be longer than 0, or blank"),
    "quaternion partly blank": (with_cell("qz", ""), "value [0.0, 1.0, 0.0]; must be 4 numbers"),
}


def write_table(folder: Path, content: str | bytes) -> Path:
    return write(folder, table=content) / "trajectory.csv"


@pytest.mark.parametrize(("content", "expected"), BAD_TABLES.values(), ids=BAD_TABLES.keys())
def test_a_bad_table_is_refused_in_one_line_that_says_where_and_why(tmp_path, content, expected):
    path = write_table(tmp_path, content)
    message = refused(read_tables, path)
    assert message.startswith(f"{path}: ")
    assert expected in message
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
    assert refused(read_tables, path)


@pytest.mark.parametrize(
    "content",
    [
        GOOD_TABLE,
        "\ufeff" + GOOD_TABLE.replace("\n", "\r\n"),
        GOOD_TABLE.rstrip(),
        GOOD_TABLE.replace("\n", "\n\n"),
        GOOD_TABLE.replace(",", " , "),
        GOOD_TABLE.replace("home", '"home"'),
        GOOD_TABLE.replace("0,1,0,0,0.02", "0,7.5,0,0,0.02"),
        GOOD_TABLE.replace("0,1,0,0,0.02", "0,1e-3,0,0,2e-2"),
        "grip,frame,time,qz,qy,qx,qw,z,y,x\n0.08,home,0,,,,,0,0,0\n0.02,target,1,0,0,1,0,.1,0,0\n",
    ],
)
def test_harmless_variants_of_a_table_mean_the_same(tmp_path, content):
    table, _ = read_tables(write_table(tmp_path, content))
    assert table.rows == (
        TableRow(0.0, "home", (0.0, 0.0, 0.0), 0.08),
        TableRow(1.0, "target", (0.0, 0.0, 0.1), 0.02, (0.0, 1.0, 0.0, 0.0)),
    )


CELL = st.one_of(
    st.sampled_from(["0", "1", "0.05", "nan", "1e400", "", "home", "target", '"', "\r", "-1"]),
    st.text(max_size=5),
)


LINES = st.lists(st.lists(CELL, min_size=8, max_size=11).map(",".join), max_size=5).map(
    lambda lines: (HEAD + "\n".join(lines)).encode("utf-8", "surrogatepass")
)


@given(st.binary(max_size=200) | LINES)
def test_no_content_at_all_gives_anything_but_a_table_or_one_line(tmp_path, content):
    path = write_table(tmp_path, content)
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
