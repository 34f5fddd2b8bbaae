"""Every scenario is read right or refused in one line that says what would be valid."""

import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import panda_cosim
from bounded import ran
from panda_cosim import load_scenario
from panda_cosim.controller.gains import PRESETS
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.master.step import COUPLINGS
from panda_cosim.task import scenario as scenario_module

TABLE = "time,frame,x,y,z,grip\n0,home,0,0,0,0.08\n1,home,0,0,-0.1,0.08\n"
GOOD = 'purpose = "A test"\nduration = 1.5\n'

# What scenario.toml holds, and what the message must say.
BAD_SCENARIOS = {
    "empty": ("", "is empty"),
    "latin-1": ('purpose = "h\xf6her"\n'.encode("latin-1"), "line 1: byte 0xf6; must be UTF-8"),
    "too large": ("#" * 65_537, "is too large; must be at most 65536 bytes"),
    "key twice": (GOOD + "duration = 2\n", "at line 3"),
    "key misspelt": ("durration = 1.0\n", "did you mean 'duration'?"),
    "key unknown": (GOOD + "colour = 1\n", "key 'colour' is unknown; valid: duration, purpose"),
    "duration missing": ('purpose = "x"\n', "key duration is missing"),
    "duration too long": ("duration = 3600.001\n", "must be a number from 0.001 to 3600 s"),
    "duration of 400 digits": ("duration = " + "9" * 400, "an integer of 1329 bits"),
    "duration no whole tick": ("duration = 1.0005\n", "must be a whole number of ticks of 0.001"),
    "scene unknown": (GOOD + 'scene = "tabeltop"\n', "did you mean 'tabletop'?"),
    "align number": (GOOD + "align = 1\n", "align: value 1; must be true or false"),
    "purpose of two lines": ('duration = 1.0\npurpose = "a\\nb"\n', "must be one line of at most"),
    "plant no section": (GOOD + "plant = 3\n", "key plant: must be a section [plant]"),
    "parameter dotted": (GOOD + "[plant]\nblock.mass = 1\n", "[plant] block: is a section"),
    "parameter list empty": (GOOD + "[plant]\nblock_pos = []\n", "must hold at least one number"),
    "scene among parameters": (GOOD + '[plant]\nscene = "tutorial"\n', "must stand at the top"),
    "place far away": (
        GOOD + "[success]\nblock_position = [600, 0, 0]\nposition_tolerance = 0.1\n",
        "[success] block_position[1]: value 600; must be a number from -10 to 10 m",
    ),
    "place without tolerance": (
        GOOD + "[success]\nblock_position = [0.6, 0.35, 0.25]\n",
        "one is missing; must be both or neither",
    ),
    "push no list": (GOOD + "push = 1\n", "key push: must be sections [[push]]"),
    "order no list": (
        GOOD + 'order = "plant"\n',
        'key order: must be a list of texts, ["...", ...]',
    ),
    "push incomplete": (GOOD + "[[push]]\nstart = 1.0\nduration = 0.1\n", "force is missing"),
    "push too strong": (
        GOOD + "[[push]]\nstart = 0\nduration = 1\nforce = [2000, 0, 0]\n",
        "[[push]] 1: force[1]: value 2000",
    ),
}


def write(folder: Path, toml: str | bytes = GOOD, table: str | None = TABLE) -> Path:
    """Make a scenario's folder."""
    folder.mkdir(exist_ok=True)
    content = toml.encode() if isinstance(toml, str) else toml
    (folder / "scenario.toml").write_bytes(content)
    if table is not None:
        (folder / "trajectory.csv").write_text(table)
    return folder


@pytest.mark.parametrize(("toml", "expected"), BAD_SCENARIOS.values(), ids=BAD_SCENARIOS.keys())
def test_a_bad_scenario_is_refused_in_one_line_that_says_where_and_why(tmp_path, toml, expected):
    folder = write(tmp_path / "mine", toml)
    with pytest.raises(InputError) as caught:
        load_scenario(folder)
    message = str(caught.value)
    assert message.startswith(f"{folder / 'scenario.toml'}: ")
    assert expected in message
    assert message.isprintable()
    assert len(message) < 400 + len(str(folder))


def test_a_bad_table_is_reported_with_its_own_name(tmp_path):
    folder = write(tmp_path / "mine", table=TABLE.replace("home", "hoem"))
    with pytest.raises(InputError, match=r"mine/trajectory\.csv: line 2: .*did you mean 'home'"):
        load_scenario(folder)


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
        ("a\nb", "no such folder"),
        (Path("/nowhere/at/all"), "no such folder; must be one with scenario.toml"),
        (Path(__file__), "no such folder; must be one with scenario.toml"),
        ("lift/scenario.toml", "or a name from `panda-cosim list`; did you mean 'lift'"),
    ],
)
def test_an_unknown_scenario_is_refused_with_the_nearest(name, expected):
    with pytest.raises(InputError) as caught:
        load_scenario(name)
    assert expected in str(caught.value)
    assert str(caught.value).isprintable()


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
    """The names stand here, too, since the modules that define them import MuJoCo."""
    assert set(scenario_module.GAINS) == set(PRESETS)
    assert scenario_module.COUPLINGS == COUPLINGS


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


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
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
