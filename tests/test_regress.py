"""Shipped scenarios match their reference recordings; differences are reported with exit codes."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from importlib.metadata import entry_points
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from fault_support import STARTING_LAW, processes_with
from forked import command as cli
from panda_cosim import shipped_scenarios
from panda_cosim.fmus.atomic import KEPT, TEMPORARY, cache_folder
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.sources.targets import build
from panda_cosim.scenarios.compare import regress
from panda_cosim.scenarios.compare.reference import REFERENCE_FILE, Reference
from panda_cosim.scenarios.compare.regress import Outcome, find_scenarios, start
from panda_cosim.scenarios.scenario.scenario import Scenario
from panda_cosim.scenarios.work import MODULE, Workers

pytestmark = pytest.mark.fmu

NAMES = tuple(shipped_scenarios())
LARGEST = 200_000  # bytes of a reference; noise compresses badly

SETTINGS = """
purpose = "Moves a little"
duration = 0.2
[success]
tracking_max = 0.005
"""
TABLE = """time,frame,x,y,z,grip
0.0,home,0.0,0.0,0.0,0.08
0.15,home,0.0,0.005,0.0,0.06
"""

DIES = """
import os, signal

class Dies:
    def update(self, time, qpos):
        os.kill(os.getpid(), signal.SIGSEGV)
"""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Future[Outcome]]]:
    """Run all shipped scenarios, two at a time."""
    build()  # once, not in each process
    folder = tmp_path_factory.mktemp("runs")
    longest_first = sorted(find_scenarios(), key=lambda scenario: -scenario.duration)
    with Workers(2) as workers:
        yield {s.name: start(workers, s, folder / s.name) for s in longest_first}


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_scenario_is_as_its_reference(
    outcomes: dict[str, Future[Outcome]], name: str
) -> None:
    outcome = outcomes[name].result()
    assert outcome.ok, f"{outcome.verdict}: {outcome.reason}"


@pytest.mark.parametrize("name", NAMES)
def test_a_reference_is_compact_and_says_what_made_it(name: str) -> None:
    path = shipped_scenarios()[name] / REFERENCE_FILE
    assert path.stat().st_size <= LARGEST
    metadata = Reference.read(path).metadata
    assert metadata["scenario"] == name
    assert {"panda-cosim", "mujoco", "numpy"} <= metadata["versions"].keys()
    assert {"plant", "controller"} <= metadata["fmus"].keys()
    assert metadata["parameters"]["plant"]["block_mass"] > 0.0


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """Return a folder of scenarios with a short one in it."""
    folder = tmp_path / "mine" / "short"
    folder.mkdir(parents=True)
    (folder / "scenario.toml").write_text(SETTINGS)
    (folder / "trajectory.csv").write_text(TABLE)
    return folder.parent


CLI = [sys.executable, "-c", "from panda_cosim.scenarios.cli import main; main()"]


def cli_with_closed_input(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", "-c", 'exec "$@" <&-', "sh", *CLI, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def start_cli(*arguments: object, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*CLI, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )


def build_into(cache: Path) -> Path:
    """Return a separate cache with the FMUs built."""
    shutil.copytree(cache_folder(), cache, ignore=shutil.ignore_patterns(".*"))
    return cache


def test_a_suite_of_ones_own_is_made_kept_and_told_from_another(mine: Path, tmp_path: Path) -> None:
    asked = ("regress", "--scenarios", mine)
    judged = cli(*asked)
    assert judged.returncode == 0, judged.stderr
    assert "Without a reference, judged by their criteria alone: short" in judged.stdout
    path = mine / "short" / "scenario.toml"
    path.write_text(SETTINGS.replace("tracking_max", "# tracking_max"))
    missing = cli(*asked)
    assert missing.returncode == 2, missing.stderr
    told = f"does not exist; `panda-cosim regress {mine / 'short'} --update` makes it"
    assert told in " ".join(missing.stdout.split())
    path.write_text(SETTINGS)

    made = cli(*asked, "--update", "--yes")
    assert made.returncode == 0, made.stderr
    assert "short: is new" in made.stdout

    same = cli(*asked, "--exact")
    assert same.returncode == 0, same.stdout
    assert "1 of 1 scenarios match their references" in same.stdout
    assert "short" in same.stderr  # the progress

    report = tmp_path / "report"
    other = cli(*asked, "--set", "controller.gravity_feedforward=0.9", "--report", report)
    assert other.returncode == 1, other.stderr
    assert "controller.dq" in other.stdout
    assert (report / "runs" / "short" / "recording.parquet").is_file()
    case = ET.parse(report / "junit.xml").getroot()[0]
    assert (case.get("tests"), case.get("failures"), case.get("errors")) == ("1", "1", "0")
    assert "times its" in str(case[0][0].text)

    before = (mine / "short" / REFERENCE_FILE).read_bytes()
    (mine / "short" / "trajectory.csv").write_text(TABLE.replace("0.005", "0.006"))
    moved = cli(*asked, "--update", "--yes")
    assert moved.returncode == 0, moved.stderr
    assert re.search(r"short: controller\.\w+_cmd\[2\] off by", moved.stdout)
    assert (mine / "short" / REFERENCE_FILE).read_bytes() != before
    assert "short: is unchanged" in cli(*asked, "--update", "--yes").stdout


def test_a_report_replaces_only_what_regress_made(mine: Path, tmp_path: Path) -> None:
    """Recordings in ./runs and whatever else lies there are not lost to `--report .`."""
    settings = mine / "short" / "scenario.toml"
    settings.write_text(SETTINGS.replace("tracking_max", "# tracking_max"))  # cannot be judged
    folder = tmp_path / "work"
    (folder / "runs" / "first").mkdir(parents=True)
    precious = folder / "runs" / "first" / "recording.parquet"
    precious.write_text("not to be made again")
    asked = ("regress", "--scenarios", mine, "--report", folder)
    for wrong in (("--jobs", "0"), ("--set", "controller.kq=1"), ()):
        assert cli(*asked, *wrong).returncode == 2
    assert precious.read_text() == "not to be made again"
    kept = folder / "runs" / "short"
    assert (kept / "recording.parquet").is_file()  # there is no reference

    (kept / "notes.txt").write_text("mine")
    first = (kept / "recording.parquet").stat().st_mtime_ns
    assert cli(*asked).returncode == 2
    assert (kept / "recording.parquet").stat().st_mtime_ns > first  # replaced
    assert cli(*asked, "--update", "--yes").returncode == 0
    assert cli(*asked).returncode == 0
    assert [path.name for path in kept.iterdir()] == ["notes.txt"]  # it is the same now
    assert precious.read_text() == "not to be made again"
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


def test_a_report_does_not_take_the_place_of_a_recording(mine: Path, tmp_path: Path) -> None:
    other = tmp_path / "runs" / "short"
    other.mkdir(parents=True)
    (other / "recording.parquet").write_text("of somebody else")
    refused = cli("regress", "--scenarios", mine, "--report", tmp_path)
    assert refused.returncode == InputError.exit_code
    assert "runs/short: was not made by regress" in refused.stderr
    assert "Running" not in refused.stderr
    assert (other / "recording.parquet").read_text() == "of somebody else"


SLIPS = [
    (("regress", "pus"), "did you mean 'push'"),
    (("regress", "push", "push"), "given twice"),
    (("regress", "push", "--set", "controller.kq=1"), "did you mean 'kp'"),
    (("regress", "push", "--update", "--set", "controller.kp=7"), "cannot be combined with --set"),
    (("regress", "--scenarios", "/nowhere"), "no scenarios there"),
    (("regress", "push", "--pictures"), "--pictures: only goes with --report"),
]


@pytest.mark.parametrize(("arguments", "told"), SLIPS)
def test_a_slip_is_reported_in_one_line(arguments: tuple[str, ...], told: str) -> None:
    slip = cli(*arguments)
    assert slip.returncode == InputError.exit_code
    assert told in slip.stderr
    assert slip.stderr.count("\n") == 1
    assert "Traceback" not in slip.stderr


def test_a_run_that_fails_or_dies_fails_alone(
    mine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = Scenario.read(mine / "short")
    monkeypatch.setattr(regress, "TIMEOUT", 0.01)
    with Workers(1) as workers:
        outcome = start(workers, scenario, tmp_path / "a").result()
    assert (outcome.verdict, outcome.error) == ("failed", "took more than 0.01 s and was killed")
    monkeypatch.setattr(regress, "TIMEOUT", 60.0)
    folder = mine / "dies"
    shutil.copytree(mine / "short", folder)
    (folder / "scenario.toml").write_text('duration = 0.2\n[fmus]\ncontroller = "dies.py:Dies"\n')
    (folder / "dies.py").write_text(DIES)
    with Workers(2) as workers:
        both = (Scenario.read(folder), scenario)
        futures = [start(workers, each, tmp_path / f"b-{each.name}") for each in both]
        died, other = (future.result() for future in futures)
    assert (died.verdict, died.error) == ("failed", "its process ended with signal 11")
    assert other.verdict == "holds"


def wait_for(condition: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.fixture
def endless(mine: Path) -> Path:
    """Return the folder of a scenario that runs for minutes."""
    settings = SETTINGS.replace("0.2", "1000.0")
    (mine / "short" / "scenario.toml").write_text(settings)
    return mine


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
@pytest.mark.parametrize(
    ("number", "reported"),
    [
        (signal.SIGINT, True),
        (signal.SIGTERM, False),
        (signal.SIGKILL, True),
        (signal.SIGKILL, False),
    ],
)
def test_a_signal_ends_a_suite_at_once_and_leaves_nothing(
    endless: Path, tmp_path: Path, number: signal.Signals, reported: bool
) -> None:
    """Only SIGKILL leaves the folder of the runs, which a start removes a week later."""
    cache = build_into(tmp_path / "cache")
    place = tmp_path / "report" if reported else cache
    arguments = ["regress", "--scenarios", endless, *(["--report", place] if reported else [])]
    child = start_cli(*arguments, PANDA_COSIM_CACHE=str(cache))
    recordings = list[Path]()
    wait_for(lambda: recordings.extend(place.glob(f"{TEMPORARY}*/short/recording.*")) or recordings)
    begin = time.monotonic()
    child.send_signal(number)
    child.communicate(timeout=30)
    assert time.monotonic() - begin < 5.0
    assert child.returncode == (-9 if number == signal.SIGKILL else 128 + number)
    wait_for(lambda: not processes_with(f"PANDA_COSIM_CACHE={cache}", MODULE), 5.0)
    left = list(place.glob(f"{TEMPORARY}*"))
    assert bool(left) is (number == signal.SIGKILL)
    for folder in left:
        os.utime(folder, (time.time() - 2 * KEPT,) * 2)
    (endless / "short" / "scenario.toml").write_text(SETTINGS)
    assert cli(*arguments, PANDA_COSIM_CACHE=str(cache)).returncode == 0
    assert not list(place.glob(f"{TEMPORARY}*"))


def test_code_in_the_working_directory_is_not_run(mine: Path, tmp_path: Path) -> None:
    """Nor if a user's script starts a suite, without the command's environment."""
    here = tmp_path / "here"
    here.mkdir()
    with (mine / "short" / "scenario.toml").open("a") as settings:
        settings.write('[fmus]\ncontroller = "starts.py:Starts"\n')
    (mine / "short" / "starts.py").write_text(STARTING_LAW)
    for name in ("json", "numpy", "mujoco", "typer"):
        (here / f"{name}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'a').write({name!r})")
    code = (
        "import sys; sys.path.pop(0)\n"
        "from pathlib import Path\n"
        "from panda_cosim.scenarios.compare.regress import Suite, find_scenarios, run_suite\n"
        f"found = find_scenarios((), Path({str(mine)!r}))\n"
        f"(outcome,) = run_suite(Suite(found), Path({str(tmp_path / 'runs')!r}))\n"
        "assert 'not measured' in outcome.error, outcome\n"  # it ran; the law has no command
    )
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
    subprocess.run([sys.executable, "-c", code], cwd=here, env=environment, check=True, timeout=300)
    assert not (tmp_path / "ran").exists()


def test_a_damaged_reference_ends_no_suite_and_is_replaced(mine: Path) -> None:
    shutil.copytree(mine / "short", mine / "other")
    asked = ("regress", "--scenarios", mine)
    assert cli(*asked, "--update").returncode == 0
    path = mine / "other" / REFERENCE_FILE
    content = path.read_bytes()
    path.write_bytes(content.replace(b'"success"', b'"succesr"'))
    damaged = cli(*asked)
    assert damaged.returncode == 2
    assert "reference.parquet: is not a reference" in damaged.stdout
    assert "1 of 2 scenarios" in damaged.stdout
    assert "is not a reference" in cli("check", mine / "other").stdout
    assert cli(*asked, "other", "--update", "--yes").returncode == 0
    assert Reference.read(path).metadata["scenario"] == "other"


def test_narrower_tolerances_ask_for_a_finer_reference(mine: Path, tmp_path: Path) -> None:
    asked = ("regress", "--scenarios", mine)
    assert cli(*asked, "--update").returncode == 0
    settings = mine / "short" / "scenario.toml"
    settings.write_text(settings.read_text() + "[regression]\nscale = 0.1\n")
    coarse = cli(*asked)
    assert coarse.returncode == 2
    assert "too coarse for a tolerance of 1e-07 m; must be recorded again" in coarse.stdout.replace(
        "\n", " "
    )
    made = cli(*asked, "--update", "--yes")
    assert made.returncode == 0, made.stderr
    assert "short: is rounded anew, as its tolerances have changed" in made.stdout
    shutil.copytree(mine / "short", tmp_path / "elsewhere" / "renamed")
    for folder in (mine, tmp_path / "elsewhere"):
        (found,) = json.loads(cli("regress", "--scenarios", folder, "--json").stdout)["scenarios"]
        assert (found["verdict"], found["worst"]["share"]) == ("same", 0.0)


@pytest.mark.parametrize("stdin", ["empty", "closed"])
def test_references_are_not_overwritten_without_being_asked_for(mine: Path, stdin: str) -> None:
    asked = ("regress", "--scenarios", mine, "--update")
    assert cli(*asked).returncode == 0  # a new one overwrites nothing
    path = mine / "short" / REFERENCE_FILE
    before = path.read_bytes()
    (mine / "short" / "trajectory.csv").write_text(TABLE.replace("0.005", "0.006"))
    refused = (cli_with_closed_input if stdin == "closed" else cli)(*asked)
    assert refused.returncode == InputError.exit_code
    assert "--yes" in refused.stderr
    assert "Traceback" not in refused.stderr
    assert path.read_bytes() == before


def plugin_options() -> list[str]:
    names = {entry.value for entry in entry_points(group="pytest11")}
    return (
        []
        if "panda_cosim.scenarios.compare.pytest_plugin" in names
        else ["-p", "panda_cosim.scenarios.compare.pytest_plugin"]
    )


def test_pytest_collects_a_folder_of_scenarios(mine: Path, tmp_path: Path) -> None:
    shutil.copytree(mine / "short", mine / "other")
    assert cli("regress", "--scenarios", mine, "--update", "--yes").returncode == 0
    (mine / "other" / "trajectory.csv").write_text(TABLE.replace("0.005", "0.006"))
    command = [sys.executable, "-m", "pytest", *plugin_options(), "-v", "-p", "no:cacheprovider"]
    (tmp_path / "empty").mkdir()
    tests = subprocess.run(
        [*command, "--panda-scenarios", str(mine)],
        cwd=tmp_path / "empty",
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert tests.returncode == 1, tests.stdout + tests.stderr
    assert "1 failed, 1 passed" in tests.stdout
    assert re.search(r"other: differs: controller\.\w+_cmd\[2\] off by", tests.stdout)
    wrong = [*command, "--panda-scenarios", str(tmp_path / "nowhere")]
    refused = subprocess.run(
        wrong, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300
    )
    assert refused.returncode == pytest.ExitCode.USAGE_ERROR
    assert "no such folder" in refused.stderr


@pytest.mark.parametrize("name", ["empty", "build"])
def test_pytest_refuses_a_folder_of_which_it_collects_nothing(
    mine: Path, tmp_path: Path, name: str
) -> None:
    """Even beside tests that pass: pytest looks into no folder called build."""
    here = tmp_path / "here"
    (here / name).mkdir(parents=True)
    if name == "build":
        shutil.copytree(mine / "short", here / name / "short")
    (here / "test_own.py").write_text("def test_own():\n    pass\n")
    command = [sys.executable, "-m", "pytest", *plugin_options(), "-p", "no:cacheprovider", "."]
    done = subprocess.run(
        [*command, "--panda-scenarios", name],
        cwd=here,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == pytest.ExitCode.USAGE_ERROR, done.stdout
    assert f"--panda-scenarios: {name}: no scenario was collected" in done.stderr
