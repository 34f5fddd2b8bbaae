"""Bad input is reported in one line that names the place and the problem; nothing is written."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bounded import limited
from fault_support import (
    complain_after_another_has_closed,
    run_command,
    start_wrong,
    write_scenario,
)
from fmu_support import in_process
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from panda_cosim.fmus.atomic import replacing
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.files.fmu_file import Fmu, _read_description
from panda_cosim.fmus.master.system import open_slave
from panda_cosim.fmus.sources.targets import Target, build
from panda_cosim.scenarios.cli.app import app
from panda_cosim.scenarios.recording import Column, Recorder, Recording
from panda_cosim.scenarios.run.options import Options
from panda_cosim.scenarios.run.run import run_scenario
from typer.testing import CliRunner

Change = Callable[[dict[str, bytes]], None]
XML = "modelDescription.xml"
LIBRARY = "binaries/linux64/PandaPlant.so"


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Members of the plant's FMU, without what only running it needs."""
    with zipfile.ZipFile(build(("plant",), target=Target("python"))["plant"]) as archive:
        names = [n for n in archive.namelist() if n in (XML, LIBRARY)]
        return {name: archive.read(name) for name in names}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenario(tmp_path_factory.mktemp("scenario") / "short", 0.02)


def replace(old: str, new: str) -> Change:
    """Return a change of the description's text."""

    def change(members: dict[str, bytes]) -> None:
        text = members[XML].decode()
        assert old in text
        members[XML] = text.replace(old, new, 1).encode()

    return change


def substitute(pattern: str, new: str) -> Change:
    def change(members: dict[str, bytes]) -> None:
        text, count = re.subn(pattern, new, members[XML].decode(), count=1, flags=re.S)
        assert count
        members[XML] = text.encode()

    return change


def put(name: str, content: bytes) -> Change:
    return lambda members: members.__setitem__(name, content)


def drop(name: str) -> Change:
    return lambda members: members.__delitem__(name)


def move_library(members: dict[str, bytes]) -> None:
    members["binaries/win64/PandaPlant.dll"] = members.pop(LIBRARY)


VARIABLE = r'(<ScalarVariable name="hand_xpos\[2\]".*?)'
FIRST = r"(<ScalarVariable .*?</ScalarVariable>)"

# Changes of the plant's FMU, and the message that each must give.
BAD_FMUS: dict[str, tuple[Change, str]] = {
    "no description": (drop(XML), r"modelDescription.xml: there is no such file"),
    "empty description": (put(XML, b""), "not well-formed XML"),
    "truncated description": (lambda m: put(XML, m[XML][:999])(m), "not well-formed XML"),
    "no XML": (put(XML, b"{}"), "not well-formed XML"),
    "another XML": (put(XML, b"<html/>"), "'html' of fmiVersion None; must be a fmiModel"),
    "not UTF-8": (put(XML, b'<?xml version="1.0"?><a b="\xff"/>'), "not well-formed XML"),
    "undefined entity": (
        replace("<ModelVariables>", "<ModelVariables>&x;"), "not well-formed XML: undefined entity"
    ),
    "FMI 1": (replace('fmiVersion="2.0"', 'fmiVersion="1.0"'), r"fmiVersion '1.0'; must be a"),
    "FMI 3 in name only": (replace('fmiVersion="2.0"', 'fmiVersion="3.0"'),
                           "modelDescription.xml: cannot be read|instantiationToken"),
    "FMI 7": (replace('fmiVersion="2.0"', 'fmiVersion="7.0"'), r"fmiVersion '7.0'; must be"),
    "no FMI version": (replace('fmiVersion="2.0"', ""), "fmiVersion None; must be a"),
    "no GUID": (substitute(' guid="[^"]*"', ""), "guid"),
    "empty GUID": (substitute(' guid="[^"]*"', ' guid=""'), "the guid .* is missing or empty"),
    "model exchange": (replace("<CoSimulation", "<ModelExchange"), "not a co-simulation FMU"),
    "no identifier": (replace('modelIdentifier="PandaPlant"', ""), "modelIdentifier"),
    "identifier is a path": (
        replace('modelIdentifier="PandaPlant"', 'modelIdentifier="../../../evil"'),
        r"modelIdentifier '../../../evil'; must be letters, digits and _",
    ),
    "identifier of another": (
        replace('modelIdentifier="PandaPlant"', 'modelIdentifier="PandaPlanet"'),
        r"binaries/linux64/PandaPlanet.so is missing",
    ),
    "no binary": (drop(LIBRARY), "no binary for this platform; .* is missing"),
    "binary of another platform": (move_library, "no binary for this platform"),
    "variable twice": (substitute(FIRST, r"\1\1"), "occurs twice"),
    "no value reference": (substitute(' valueReference="[^"]*"', ""), "valueReference"),
    "value reference is a word": (
        substitute(' valueReference="[^"]*"', ' valueReference="one"'), "valueReference|one"
    ),
    "nameless variable": (substitute(' name="qpos[^"]*"', ""), "name"),
    "unknown type": (substitute(r"<Real ([^>]*?)/>", r"<Complex \1/>"), "Complex"),
}  # fmt: skip
# Bad once it is coupled or loaded.
BAD_PARTS: dict[str, tuple[Change, str]] = {
    "output missing": (
        replace('name="hand_xpos[2]"', 'name="hand_xpo[2]"'),
        r"no variable 'hand_xpos\[2\]'; did you mean 'hand_xpo",
    ),
    "input missing": (
        replace('name="ctrl[3]"', 'name="control[3]"'), r"no variable 'ctrl\[3\]'"
    ),
    "parameter missing": (
        replace('name="block_mass"', 'name="block_mas"'), "did you mean 'block_mas'"
    ),
    "output is an input": (
        substitute(VARIABLE + 'causality="output"', r'\1causality="input"'),
        r"hand_xpos\[2\]: causality input; must be output",
    ),
    "input is local": (
        substitute(r'(name="ctrl\[3\]".*?)causality="input"', r'\1causality="local"'),
        r"ctrl\[3\]: causality local; must be input",
    ),
    "output is an integer": (
        substitute(VARIABLE + r"<Real [^>]*/>", r"\1<Integer/>"),
        r"hand_xpos\[2\]: type Integer; must be Real",
    ),
    "another unit": (
        substitute(VARIABLE + r'unit="m"', r'\1unit="rad"'),
        r"unit 'rad' feeds unit 'm'; must be the same",
    ),
    "parameter with another bound": (
        substitute(r'(name="block_mass".*?min=")[^"]*"', r'\g<1>0.5"'),
        r"block_mass: 0.18 kg is out of range; must be between 0.5 and 3 kg",
    ),
    "parameter is an output": (
        substitute(r'(name="block_mass".*?)causality="parameter" variability="fixed" '
                   r'initial="exact"', r'\1causality="output" variability="continuous"'),
        "block_mass: causality output; cannot be set",
    ),
    "binary needs what is not there": (
        lambda m: put(LIBRARY, m[LIBRARY].replace(b"libc.so.6", b"libc.so.9"))(m),
        r"Failed to load shared library .*libc\.so\.9",
    ),
    "binary lacks functions": (
        lambda m: put(LIBRARY, m[LIBRARY].replace(b"fmi2DoStep", b"fmi2DoStop"))(m), "fmi2DoStep"
    ),
}  # fmt: skip


def pack(path: Path, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def check_line(error: InputError, *words: str) -> None:
    message = str(error)
    assert message.isprintable(), message
    for word in words:
        assert word in message


@pytest.mark.parametrize("kind", BAD_FMUS)
def test_a_bad_fmu_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plant: dict[str, bytes], kind: str
) -> None:
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path / "cache"))
    change, expected = BAD_FMUS[kind]
    members = dict(plant)
    change(members)
    with pytest.raises(InputError, match=expected) as refused:
        Fmu(pack(tmp_path / "bad.fmu", members))
    check_line(refused.value, str(tmp_path / "bad.fmu"))


@pytest.mark.fmu
@pytest.mark.parametrize("kind", BAD_PARTS)
def test_an_fmu_that_does_not_fit_is_refused_before_anything_is_written(
    tmp_path: Path, plant: dict[str, bytes], scenario: Path, kind: str
) -> None:
    change, expected = BAD_PARTS[kind]
    members = dict(plant)
    change(members)
    bad = pack(tmp_path / "bad.fmu", members)
    here = Path.cwd()
    with pytest.raises(InputError, match=expected) as refused:
        run_scenario(scenario, tmp_path / "run", Options(fmus={"plant": bad}))
    check_line(refused.value)
    assert Path.cwd() == here
    assert [p.name for p in tmp_path.iterdir()] == ["bad.fmu"]


@pytest.mark.fmu
def test_a_library_that_cannot_be_loaded_leaves_the_working_directory(
    tmp_path: Path, plant: dict[str, bytes]
) -> None:
    members = dict(plant)
    BAD_PARTS["binary needs what is not there"][0](members)
    bad, here = Fmu(pack(tmp_path / "bad.fmu", members)), Path.cwd()
    with pytest.raises(InputError, match="Failed to load shared library"):
        open_slave("plant", bad)
    assert Path.cwd() == here


@pytest.mark.fmu
def test_each_fmu_is_quoted_with_its_own_words() -> None:
    """The library that formats messages keeps a single logger: the last one, even after its end."""
    assert in_process(start_wrong).startswith(
        "controller: the FMU refuses its start values: fmi2ExitInitializationMode: period: 0.0015 s"
    )
    paths = [str(build(target=Target("python"))[name]) for name in ("controller", "plant")]
    assert in_process(complain_after_another_has_closed, *paths).startswith(
        "first: the FMU refuses"
    )


TOKENS = ("", "0", "-1", "1e999", "nan", "\u00e4", "&amp;", "x" * 70_000, "../..", "true", "[1]")


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 1.0, exclude_max=True),
            st.sampled_from(["value", "name", "drop", "element", "cut"]),
            st.sampled_from(TOKENS),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_a_description_changed_at_random_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory,
    plant: dict[str, bytes],
    changes: list[tuple[float, str, str]],
) -> None:
    folder = tmp_path_factory.mktemp("fuzz")
    text = plant[XML].decode()
    for where, kind, token in changes:
        text = scramble(text, where, kind, token)
    (folder / XML).write_text(text)
    (folder / LIBRARY).parent.mkdir(parents=True)
    (folder / LIBRARY).write_bytes(plant[LIBRARY])
    try:
        _read_description(Path("x.fmu"), folder)
    except InputError as error:
        check_line(error, "x.fmu")
    shutil.rmtree(folder)


def scramble(text: str, where: float, kind: str, token: str) -> str:
    """Change one attribute or element of an XML text."""
    pattern = {
        "value": r'(?<==)"[^"]*"',
        "name": r'\b\w+(?==")',
        "drop": r' \w+="[^"]*"',
        "element": r"<\w+",
        "cut": r"<[^>]*/>",
    }[kind]
    found = list(re.finditer(pattern, text))
    if not found:
        return text
    match = found[int(where * len(found))]
    new = {"value": f'"{token}"', "name": f"a{len(token)}", "element": f"<e{len(token)}"}
    return text[: match.start()] + new.get(kind, "") + text[match.end() :]


# Places to write to.


def a_file(path: Path) -> Path:
    path.touch()
    return path


def a_full_folder(path: Path) -> Path:
    path.mkdir()
    (path / "thesis.doc").touch()
    return path


def a_run(path: Path) -> Path:
    path.mkdir()
    (path / "recording.parquet").touch()
    return path


def a_loop(path: Path) -> Path:
    path.symlink_to(path)
    return path


BAD_PLACES: dict[str, Callable[[Path], Path]] = {
    "file": lambda p: a_file(p / "x"),
    "below a file": lambda p: a_file(p / "x") / "run",
    "folder with other files": lambda p: a_full_folder(p / "x"),
    "earlier run": lambda p: a_run(p / "x"),
    "proc": lambda p: Path("/proc/run"),
    "device": lambda p: Path("/dev/null"),
    "below a device": lambda p: Path("/dev/null/run"),
    "long name": lambda p: p / ("x" * 300),
    "long path": lambda p: p / "/".join(["x" * 200] * 30),
    "loop of links": lambda p: a_loop(p / "x"),
    "null byte": lambda p: p / "a\0b",
}


@pytest.mark.fmu
@pytest.mark.parametrize("kind", BAD_PLACES)
def test_a_run_is_not_begun_where_it_cannot_be_written(
    tmp_path: Path, scenario: Path, kind: str
) -> None:
    place = BAD_PLACES[kind](tmp_path)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError) as refused:
        run_scenario(scenario, place)
    check_line(refused.value)
    assert re.search("already exists; must be|cannot be written", str(refused.value))
    assert ("is not a folder" in str(refused.value)) == kind.startswith("below")
    assert sorted(tmp_path.rglob("*")) == before


BAD_FILES: dict[str, Callable[[Path], Path]] = {
    "folder": lambda p: p,
    "below a file": lambda p: a_file(p / "x") / "a.csv",
    "proc": lambda p: Path("/proc/a.csv"),
    "below a device": lambda p: Path("/dev/null/a.csv"),
    "long name": lambda p: p / ("x" * 300),
    "null byte": lambda p: p / "a\0b",
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    with Recorder(folder, [Column("time", "s"), Column("plant.x")], {"scenario": "x"}) as recorder:
        recorder.append(np.random.default_rng(1).normal(size=(3000, 2)))
        recorder.close(complete=True)
    return folder


@pytest.mark.parametrize("kind", BAD_FILES)
def test_no_export_where_it_cannot_be_written(tmp_path: Path, recording: Path, kind: str) -> None:
    place = BAD_FILES[kind](tmp_path)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError) as refused:
        Recording.open(recording).to_csv(place)
    check_line(refused.value)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("kind", BAD_FILES)
def test_no_picture_where_it_cannot_be_written(tmp_path: Path, kind: str) -> None:
    place = BAD_FILES[kind](tmp_path)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError) as refused, replacing(place) as path:
        path.write_text("picture")
    check_line(refused.value)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_file_is_whole_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")

    def stop_half_way() -> None:
        with replacing(tmp_path / "a") as path:
            path.write_text("ne")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_half_way()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a", "old")]


def test_an_export_to_a_full_disk_leaves_nothing(tmp_path: Path, recording: Path) -> None:
    code = (
        "import sys\nfrom panda_cosim.scenarios.recording import Recording\n"
        "from panda_cosim.fmus.errors import InputError\n"
        "try: Recording.open(sys.argv[1]).to_csv(sys.argv[2])\n"
        "except InputError as error: print(error)"
    )
    command = [sys.executable, "-c", code, str(recording), str(tmp_path / "a.csv")]
    done = subprocess.run(
        [*limited(FSIZE=20_000), *command],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert done.stdout.startswith(f"{tmp_path / 'a.csv'}: cannot be written: ")
    assert done.stdout.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


# The environment.

BAD_CACHES: dict[str, Callable[[Path], Path]] = {
    "file": lambda p: a_file(p / "x"),
    "below a file": lambda p: a_file(p / "x") / "cache",
    "proc": lambda p: Path("/proc/cache"),
    "device": lambda p: Path("/dev/null"),
    "long name": lambda p: p / ("x" * 300),
}


@pytest.mark.fmu
@pytest.mark.parametrize("kind", BAD_CACHES)
def test_a_cache_that_cannot_be_used_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scenario: Path, kind: str
) -> None:
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(BAD_CACHES[kind](tmp_path)))
    with pytest.raises(InputError, match="set PANDA_COSIM_CACHE to a writable folder") as refused:
        run_scenario(scenario, tmp_path / "run")
    check_line(refused.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.fmu
@pytest.mark.parametrize("cache", ["a cache/b", "c\u00e4che", "100%25"])
def test_any_name_of_a_cache_will_do(tmp_path: Path, scenario: Path, cache: str) -> None:
    fmus = build(target=Target("python"))
    environment = os.environ | {"PANDA_COSIM_CACHE": cache}
    command = run_command(scenario, tmp_path / "run", fmus={k: str(v) for k, v in fmus.items()})
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=60)
    assert Recording.open(tmp_path / "run").complete


# The command line ends all of them with one line and exit code 2.


@pytest.mark.fmu
@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "{empty}", "--out", "{new}"],
        ["run", "{short}", "--out", "{file}"],
        ["run", "{short}", "--out", "/proc/run"],
        ["run", "{short}", "--out", "{new}", "--step-timeout", "3"],
        ["run", "{short}", "--out", "{new}", "--isolate", "--step-timeout", "-1"],
        ["run", "{short}", "--out", "{new}", "--isolate", "--step-timeout", "soon"],
        ["run", "{short}", "--out", "{new}", "--set", "plant.block_pos=0,0"],
        ["run", "{short}", "--out", "{new}", "--set", "controller.period=0.0015"],
        ["run", "{short}", "--out", "{new}", "--set", "plant.block_pos=1,2,3"],
        ["run", "{short}", "--out", "{new}", "--set", "plant.scene=moon"],
        ["run", "{short}", "--out", "{new}", "--set", "controller.use_reference=perhaps"],
        ["run", "{short}", "--out", "{new}", "--set", "plant.block_mass=nan"],
        ["export", "{file}", "{new}"],
        ["plot", "{empty}"],
        ["render", "{file}"],
        ["inputs", "{short}", "{file}"],
        ["build", "--out", "{file}"],
    ],
    ids=" ".join,
)
def test_the_command_line_says_it_in_one_line(
    tmp_path: Path, scenario: Path, arguments: list[str]
) -> None:
    (tmp_path / "file").write_text("precious")
    (tmp_path / "empty").mkdir()
    places = {n: str(tmp_path / n) for n in ("file", "empty", "new")} | {"short": str(scenario)}
    result = CliRunner().invoke(app, [a.format(**places) for a in arguments])
    assert result.exit_code == InputError.exit_code, result.output
    told = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    assert len(told) == 1
    assert "Traceback" not in result.output
    assert (tmp_path / "file").read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty", "file"]
