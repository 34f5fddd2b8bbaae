"""Bad input is reported in one line that names the place and the problem; nothing is written."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fault_support import write_files, write_scenario
from fmu_support import initialize, members, pack
from panda_cosim.cli.app import app
from panda_cosim.fmus.atomic import replacing
from panda_cosim.fmus.errors import InputError, nearest
from panda_cosim.fmus.master.fmi import open_slave
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.sources.targets import Target, build

Change = Callable[[dict[str, bytes]], None]
XML = "modelDescription.xml"
LIBRARY = "binaries/linux64/PandaPlant.so"


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    """Members of the plant's FMU, without what only running it needs."""
    content = members(build(("plant",), target=Target("python"))["plant"])
    return {name: content[name] for name in (XML, LIBRARY)}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    return write_scenario(tmp_path_factory.mktemp("scenario") / "short", 0.02)


def refused(folder: Path, *arguments: object) -> str:
    """Give a command; returns the one line that refuses it. Nothing in the folder changes."""
    before, here = sorted(folder.rglob("*")), Path.cwd()
    done = CliRunner().invoke(app, [*map(str, arguments)])
    assert done.exit_code == InputError.exit_code, done.output
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("Error: ")]
    assert line.isprintable()
    assert "Traceback" not in done.output
    assert sorted(folder.rglob("*")) == before
    assert Path.cwd() == here
    return line


# Files: changes of the plant's FMU, and the message that each must give.


def substitute(pattern: str, new: str) -> Change:
    """Return a change of the description's text."""

    def change(members: dict[str, bytes]) -> None:
        text, count = re.subn(pattern, new, members[XML].decode(), count=1, flags=re.S)
        assert count
        members[XML] = text.encode()

    return change


def replace(old: str, new: str) -> Change:
    return substitute(re.escape(old), new)


def put(name: str, content: bytes) -> Change:
    return lambda members: members.__setitem__(name, content)


def drop(name: str) -> Change:
    return lambda members: members.__delitem__(name)


# Changes of the plant's FMU, and the message that each must give.
BAD_FMUS: dict[str, tuple[Change, str]] = {
    "no description": (drop(XML), r"modelDescription.xml: no such file"),
    "another XML": (put(XML, b"<html/>"), "'html' of fmiVersion None; must be a fmiModel"),
    "not UTF-8": (put(XML, b'<?xml version="1.0"?><a b="\xff"/>'), "not well-formed XML"),
    "FMI 1": (replace('fmiVersion="2.0"', 'fmiVersion="1.0"'), "fmiVersion '1.0'; must be a"),
    "model exchange": (replace("<CoSimulation", "<ModelExchange"), "not a co-simulation FMU"),
    "identifier is a path": (
        replace('modelIdentifier="PandaPlant"', 'modelIdentifier="../../../evil"'),
        r"modelIdentifier: value '../../../evil'; must be letters, digits, _ and -",
    ),
    "no binary": (drop(LIBRARY), "no binary for this platform; .* is missing"),
    "no value reference": (
        substitute(r' valueReference="\d+"', ""), "'valueReference' is required but missing"
    ),
    # Bad once it is coupled or loaded.
    "output missing": (
        replace('name="hand_xpos[2]"', 'name="hand_xpo[2]"'),
        r"plant.hand_xpos \(1\) \[m\] feeds controller.hand_xpos \(3\).*must have the same shape",
    ),
    "another unit": (
        substitute(r'(<ScalarVariable name="hand_xpos\[2\]".*?)unit="m"', r'\1unit="rad"'),
        r"plant.hand_xpos \(3\) \[m, rad\] feeds controller.hand_xpos .*must have the same unit",
    ),
    "binary lacks functions": (
        lambda m: put(LIBRARY, m[LIBRARY].replace(b"fmi2DoStep", b"fmi2DoStop"))(m), "fmi2DoStep"
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD_FMUS)
def test_a_bad_fmu_is_refused(tmp_path, plant, scenario, kind):
    change, expected = BAD_FMUS[kind]
    content = dict(plant)
    change(content)
    bad = pack(tmp_path / "bad.fmu", content)
    line = refused(tmp_path, "run", scenario, "--plant", bad, "--out", tmp_path / "run")
    assert re.search(expected, line)


def test_each_fmu_is_quoted_with_its_own_words(scenario, tmp_path):
    """The library that formats messages keeps a single logger: the last one, even after its end."""
    fmus = build(target=Target("python"))
    talker = open_slave("first", Fmu(fmus["controller"]))
    open_slave("second", Fmu(fmus["plant"])).close()
    with pytest.raises(InputError, match=r"^first: the FMU refuses its start .*0\.0015 s"):
        initialize(talker, {"period": 0.0015})
    talker.close()


# Keys and values: what scenario.toml says, whether there is a trajectory, and the message.

BAD_KEYS = [
    ('system = "no.ssp"\n', False, "no.ssp"),
    ('system = "."\n', False, "not a regular file"),
    ('system = "a.ssp"\n[fmus]\nplant = "x.fmu"\n', False, "cannot be combined with [fmus]"),
    ("step = 0.01\n", True, "step"),
    ('system = "a.ssp"\nstep = 0\n', False, "step"),
    ('expect = "failure"\n', True, "expect_reason"),
    ('expect_reason = "so"\n', True, "expect_reason"),
    ('fmus = "x.fmu"\n', True, "fmus"),
    ('[fmus]\nplant = "x.fmu"\n', True, "no such file"),
    ('[fmus]\ncontroller = "law.py:"\n', True, "[fmus] controller"),
    ('[fmus]\n"a b" = "x.fmu"\n', True, "a name of letters"),
    ('[connect]\n"plant.ctrl" = 3\n', True, "connect"),
    ('[connect]\n"plant.ctrl" = "controller.qpos_ref"\n', True, "must have the same shape"),
    ('[connect]\n"plant.ctrl" = "controller.ctl"\n', True, "did you mean 'ctrl'"),
    ("[parameters.motor]\nk = 3.0\n", True, "motor"),
    ('[inputs]\n"plant.push_force" = 1e9\n', True, "[inputs] plant.push_force[1]: "),
]


@pytest.mark.parametrize(
    ("text", "has_table", "words"), BAD_KEYS, ids=[each[0][:40] for each in BAD_KEYS]
)
def test_a_bad_key_is_refused(tmp_path, text, has_table, words):
    folder = write_files(tmp_path / "mine", f"duration = 1.0\n{text}")
    if not has_table:
        (folder / "trajectory.csv").unlink()
    line = refused(tmp_path, "run", folder, "--out", tmp_path / "run")
    assert str(folder) in line
    assert words in line


@pytest.mark.parametrize("command", ["check", "run"])
def test_gains_without_effect_are_refused(tmp_path, command):
    result = CliRunner().invoke(app, [command, "draw_circle", "--set", "gains=tutorial"])
    assert result.exit_code == 2
    assert "gains: acts only on the project's own controller" in result.output


def test_only_close_names_are_suggested():
    assert nearest("nope", ["wipe", "tutorial"]) is None
    assert nearest("tutoral", ["wipe", "tutorial"]) == "tutorial"


# Places to write to.


def touched(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.touch()
    return path


BAD_PLACES: dict[str, Callable[[Path], Path]] = {
    "file": lambda p: touched(p / "x"),
    "below a file": lambda p: touched(p / "x") / "run",
    "folder with other files": lambda p: touched(p / "x" / "thesis.doc").parent,
    "proc": lambda p: Path("/proc/run"),
    "below a device": lambda p: Path("/dev/null/run"),
    "long name": lambda p: p / ("x" * 300),
    "null byte": lambda p: p / "a\0b",
}


@pytest.mark.parametrize("kind", BAD_PLACES)
def test_a_run_is_not_begun_where_it_cannot_be_written(tmp_path, scenario, kind):
    place = BAD_PLACES[kind](tmp_path)
    line = refused(tmp_path, "run", scenario, "--out", place)
    assert re.search("already exists; must be|cannot be written|null (byte|character)", line)


@pytest.mark.parametrize("kind", ["file", "below a file", "proc", "long name"])
def test_a_cache_that_cannot_be_used_is_reported(tmp_path, monkeypatch, scenario, kind):
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(BAD_PLACES[kind](tmp_path)))
    line = refused(tmp_path, "run", scenario, "--out", tmp_path / "run")
    assert "set PANDA_COSIM_CACHE to a writable folder" in line


def test_a_file_is_whole_or_not_at_all(tmp_path):
    (tmp_path / "a").write_text("old")

    def stop_half_way() -> None:
        with replacing(tmp_path / "a") as path:
            path.write_text("ne")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_half_way()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a", "old")]
