"""A program beside the FMUs: the run begins and ends with it, and leaves nothing behind."""

import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from bounded import PATIENCE, is_alive, ran, running, wait_until
from fault_support import processes_with
from forked import QUIET, command
from panda_cosim import Options, Recording, Session, SimulationError, load_scenario, run_scenario
from panda_cosim.run import prepare as preparation
from panda_cosim.run.replay import replay
from panda_cosim.run.running_client import addressed
from refusals import refused

SLAVES = Path(__file__).parents[1] / "slaves"
SETTINGS = """
purpose = "A program fills a tank"
duration = {duration}
[fmus]
tank = "listener.py:Tank"
{client}
[[success.signal]]
name = "full"
signal = "tank.level"
reduce = "final"
above = 0.45
"""
ALONE = '[parameters.tank]\naddress = "127.0.3.1"\n'
CLIENT = '[client]\ncommand = ["python", "filler.py", "{address}", "200", "THEN"]\n'


def write(folder: Path, then: str = "leave", duration: float = 10.0, client: str = CLIENT) -> Path:
    """Write a scenario whose program fills the tank in 200 steps, and then does something."""
    folder.mkdir(parents=True)
    for name in ("listener.py", "filler.py", "filler_goal.py"):
        shutil.copy(SLAVES / name, folder)
    text = SETTINGS.format(duration=duration, client=client.replace("THEN", then))
    (folder / "scenario.toml").write_text(text)
    return folder


def begun(folder: Path, out: Path) -> AbstractContextManager[Any]:
    """Begin a run in a process of its own."""
    words = ["panda-cosim", "run", folder, *QUIET, "--out", out]
    return running(words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)


def line_with(text: str, process: "subprocess.Popen[str]") -> str:
    """Return the first line of a process's errors that has a text."""
    assert process.stderr is not None
    return next(line for line in process.stderr if text in line)


def processes_of(printed: str) -> list[int]:
    return [int(number) for number in re.findall(r"sleeping (\d+)", printed)]


def test_a_run_ends_with_its_program_and_is_judged(tmp_path):
    folder = write(tmp_path / "fill")
    done = command("run", folder, *QUIET, "--out", tmp_path / "a", code=0)
    assert "Press Enter to fill the tank" in done.stderr
    assert re.search(r"filled by 127\.0\.[01]\.\d+ to 0\.491 m", done.stderr)
    assert "Warning" not in done.stderr
    recording = Recording.open(tmp_path / "a")
    assert recording.complete
    assert recording.rows == 201
    level = 0.0
    for k in range(200):  # the loop of tank and program, once more
        assert recording["tank.level"][k] == level
        level += 20.0 * (0.5 - level) * 0.001
    # What it keeps runs, too, with the program and what that imports; and gives the same bits.
    command("run", tmp_path / "a" / "scenario", *QUIET, "--out", tmp_path / "b", code=0)
    assert Recording.open(tmp_path / "b").sha256() == recording.sha256()


@pytest.mark.parametrize(
    ("then", "line"),
    [
        ("fail", r"at t = 0\.200 s, in FMU 'tank': the client ended with exit code 1: .*"
                 r"filler.py, line \d+: RuntimeError: the tank leaks"),
        ("absent", r"at t = 0\.000 s, in FMU 'tank': the client ended with exit code 1: "
                   r"filler.py, line \d+: LookupError: no time today"),
    ],
)  # fmt: skip
def test_a_program_that_fails_is_a_failed_run(tmp_path, then, line):
    began = time.monotonic()
    done = command("run", write(tmp_path / "fill", then), *QUIET, "--out", tmp_path / "run", code=1)
    assert re.search(f"Error: {line}", done.stderr), done.stderr
    assert time.monotonic() - began < preparation.PATIENCE  # it waits for nobody who cannot come
    assert not Recording.open(tmp_path / "run").complete
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["verdict"] == "failed"


def test_the_end_of_the_scenario_ends_the_program_and_what_it_has_started(tmp_path):
    folder = write(tmp_path / "fill", "hang", 0.2)
    done = command("run", folder, *QUIET, "--out", tmp_path / "run", code=0)
    assert "the client still ran at the scenario's end" in done.stderr
    assert Recording.open(tmp_path / "run").complete
    assert not any(map(is_alive, processes_of(done.stderr)))


def test_ctrl_c_ends_a_run_that_waits_for_its_program(tmp_path):
    with begun(write(tmp_path / "fill", "hang"), tmp_path / "r") as process:
        printed = line_with("sleeping", process)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 128 + signal.SIGINT
        told = process.stderr.read()
    assert "stopped by SIGINT" in told
    assert "Traceback" not in told
    recording = Recording.open(tmp_path / "r")
    assert (recording.rows, recording.reason) == (201, "stopped by SIGINT")
    wait_until(lambda: not any(map(is_alive, processes_of(printed))))


def test_a_killed_run_takes_its_program_with_it(tmp_path):
    with begun(write(tmp_path / "fill", "hang"), tmp_path / "r") as process:
        line_with("sleeping", process)
        process.kill()
    wait_until(lambda: not processes_with("filler.py", "hang"))


@pytest.mark.own_process
def test_a_time_limit_ends_a_run_that_waits_for_its_program(tmp_path):
    run = run_scenario(write(tmp_path / "fill", "hang"), tmp_path / "r", Options(time_limit=1.0))
    assert run.verdict.word == "timeout"
    assert run.recording.rows <= 201


@pytest.mark.own_process
def test_fmus_wait_only_so_long_unless_somebody_is_asked_to_come(tmp_path, monkeypatch):
    monkeypatch.setattr(preparation, "PATIENCE", 0.3)
    with pytest.raises(SimulationError, match=r"in FMU 'tank': .*nobody came for 0\.3 s"):
        run_scenario(write(tmp_path / "alone", client=ALONE), tmp_path / "run")


def test_without_a_client_a_run_says_where_it_waits_for_one(tmp_path):
    folder = write(tmp_path / "alone", client=ALONE)
    with begun(folder, tmp_path / "r") as process:
        waits = "tank waits for a program at 127.0.3.1, port 14337; Ctrl-C ends the run\n"
        assert line_with("waits", process) == waits
        program = [sys.executable, folder / "filler.py", "127.0.3.1", 200, "leave"]
        ran(program, input="\n")
        assert process.wait(PATIENCE) == 0
    assert Recording.open(tmp_path / "r").complete


def test_runs_side_by_side_have_addresses_of_their_own_and_equal_results(tmp_path):
    folder = write(tmp_path / "fill")
    (tmp_path / "sweep.toml").write_text(
        'scenario = "fill"\ndesign = "grid"\nkeep = "all"\n'
        "[vary.duration]\nvalues = [7.0, 8.0, 9.0, 10.0]\n"
    )
    command("sweep", "sweep.toml", "--jobs", 2, "--out", "rows", cwd=tmp_path, code=0)
    runs = [Recording.open(path.parent) for path in (tmp_path / "rows").rglob("summary.json")]
    assert len(runs) == 4
    assert len({run.sha256() for run in runs}) == 1
    assert {run.metadata["parameters"]["tank"]["address"] for run in runs} == {"127.0.0.1"}
    assert folder.is_dir()


def test_addresses_are_taken_one_after_another(tmp_path):
    """Also where somebody else listens, at an address that no run holds."""
    prepared = preparation.prepare(load_scenario(write(tmp_path / "fill")))
    with (
        socket.create_server(("127.0.0.1", 14337)),
        addressed(prepared) as one,
        addressed(prepared) as two,
    ):
        taken = [each.listening["tank"][0] for each in (one, two)]
    assert len({*taken}) == 2
    assert all(address.startswith("127.0.1.") for address in taken)


MISSING = CLIENT + 'needs = ["no-such-package"]\n'


@pytest.fixture(scope="module")
def lacking(tmp_path_factory):
    return write(tmp_path_factory.mktemp("suite") / "fill", client=MISSING)


def test_what_a_package_is_missing_for_is_skipped_and_never_a_match(lacking, tmp_path):
    reason = "[client] needs no-such-package, which is not installed: pip install no-such-package"
    assert f"Error: {reason}" in command("run", lacking, code=2).stderr
    assert f"hint   not checked: {reason}" in command("check", lacking, code=0).stdout
    asked = ("regress", "--scenarios", lacking.parent)
    alone = command(*asked, code=2)  # nothing was compared
    assert "0 of 1 scenarios match their references; 1 skipped" in alone.stdout
    assert reason in alone.stdout
    refused_update = command(*asked, "--update", code=0)
    assert "skipped, so it cannot become a reference" in refused_update.stderr
    assert not (lacking / "reference.parquet").exists()


def test_a_skipped_scenario_does_not_fail_the_others(lacking, tmp_path):
    suite = tmp_path / "suite"
    shutil.copytree(lacking, suite / "lacking")
    write(suite / "fill")
    asked = ("regress", "--scenarios", suite, "--report", tmp_path / "report")
    assert "1 of 2 scenarios pass; 1 skipped" in command(*asked, code=0).stdout
    found = ET.parse(tmp_path / "report" / "junit.xml").find("testsuite")
    assert {key: found.get(key) for key in ("tests", "failures", "errors", "skipped")} == {
        "tests": "2", "failures": "0", "errors": "0", "skipped": "1"
    }  # fmt: skip
    assert "no-such-package" in found.find("testcase/skipped").get("message")
    words = (sys.executable, "-m", "pytest", "-rs", "-p", "no:cacheprovider")
    tests = ran([*words, "--panda-scenarios", suite / "lacking"], cwd=tmp_path)
    assert "1 skipped" in tests.stdout
    assert "no-such-package" in tests.stdout


def test_a_check_starts_nothing_and_finds_what_is_not_there(tmp_path):
    marked = '[client]\ncommand = ["touch", "started"]\n'
    folder = write(tmp_path / "fill", client=marked)
    command("check", folder, code=0)
    assert not (folder / "started").exists()
    program = CLIENT.replace("filler.py", "missing.py")
    assert "missing.py: no such file" in command(
        "check", write(tmp_path / "file", client=program), code=2
    ).stdout  # fmt: skip
    program = CLIENT.replace('"python"', '"no-such-program"')
    assert "must be a program that can be run" in command(
        "run", write(tmp_path / "program", client=program), code=2
    ).stderr  # fmt: skip


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[client]\ncommand = []", "must name a program"),
        ("[client]\nneeds = []", "key command is missing"),
        ('[client]\ncommand = "python"', "must be a list of texts"),
        ('[client]\ncommand = ["a"]\nport = 3', "key 'port' is unknown"),
    ],
)
def test_a_client_is_checked_when_it_is_read(tmp_path, text, problem):
    folder = write(tmp_path / "fill", client=text)
    assert problem in refused(load_scenario, folder)


@pytest.mark.own_process
def test_a_session_with_a_program_can_be_repeated(tmp_path):
    with Session(write(tmp_path / "fill"), tmp_path / "session") as session:
        assert session.step(50) == 50
        assert session.finish() == 150  # the program leaves
        assert session.is_over
    first = Recording.open(tmp_path / "session")
    assert first.complete
    again = replay(tmp_path / "session", tmp_path / "again")
    assert again.recording.sha256() == first.sha256()


def test_a_program_beside_fmus_that_listen_to_nobody_ends_the_run_too(tmp_path):
    folder = tmp_path / "push"
    shutil.copytree(load_scenario("push").folder, folder)
    (folder / "reference.parquet").unlink()
    text = (folder / "scenario.toml").read_text()
    program = '\n[client]\ncommand = ["sh", "-c", "sleep 0.2; exit {}"]\n'
    (folder / "scenario.toml").write_text(text + program.format(0))
    run = run_scenario(folder, tmp_path / "good", Options(realtime=0.5))
    assert run.recording.complete
    assert run.recording.time[-1] < 1.0
    (folder / "scenario.toml").write_text(text + program.format(4))
    with pytest.raises(SimulationError, match="the client ended with exit code 4: it said nothing"):
        run_scenario(folder, tmp_path / "bad", Options(realtime=0.5))
