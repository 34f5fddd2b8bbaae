"""Damaged and odd files: each is used, or refused in one line with exit code 2.

Every kind of file that a command reads is mutated at random, from a seed: bits flipped, cut, NUL,
UTF-16, homoglyphs, denormals, duplicate keys, symlinks, nested archives, 10^6 rows.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from random import Random

import mutations
import pytest
import sweep_support
from fmu_support import JobError, Worker
from mjcf_jobs import BOX
from mutation_jobs import attempt
from panda_cosim import Options, Session, run_scenario
from panda_cosim.fmus.sources.model_fmu import ModelOptions, describe
from panda_cosim.scenarios.cli.app import app
from sweep_support import made_up
from typer.testing import CliRunner

SEED = 20261122
SHORT, LONG = 5, 200  # mutations of each kind of file
LAW = '''\
class Law:
    """Drives the position error out."""

    gain = 20.0  # 1/s, a tunable parameter

    def update(self, time, pos_cmd, hand_xpos, qpos):
        ctrl = [0.0] * 8
        for i in range(7):
            ctrl[i] = qpos[i] + 0.001 * self.gain * (pos_cmd[2] - hand_xpos[2])
        return ctrl
'''
MISMATCH = """
[mismatch]
joint_friction = [2.0, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0]
joint_viscous = 2.0
link_mass_scale = 1.1
servo_scale = 0.9
seed = 3
block_position_error = [0.0, 0.001, 0.0]
block_yaw_error = 0.01
"""
RUN = ["--no-video", "--no-view", "--out", "out"]
# File to mutate, how, and the commands that read it; they take turns.
KINDS: dict[str, tuple[str, mutations.Mutation, list[list[str]]]] = {
    "recording": (
        "run/recording.parquet",
        mutations.parquet_file,
        [
            ["export", "run", "out.csv"],
            ["view", "run", "--out", "out.html"],
            ["compare", "other", "run", "--out", "out"],
            ["compare", "run", "other"],
            ["plot", "run", "--out", "out"],
        ],
    ),
    "summary": (
        "run/summary.json",
        mutations.json_file,
        [
            ["compare", "other", "run", "--out", "out"],
            ["view", "run", "--out", "out.html"],
            ["compare", "run", "other"],
            ["plot", "run", "--out", "out"],
        ],
    ),
    "reference": (
        "short/reference.parquet",
        mutations.parquet_file,
        [
            ["check", "short"],
            ["view", "run", "--against", "short", "--out", "out.html"],
            ["regress", "short", "--jobs", "1"],
            ["view", "run", "--against", "reference", "--out", "out.html"],
        ],
    ),
    "scenario": (
        "short/scenario.toml",
        mutations.text_file,
        [["check", "short"], ["run", "short", *RUN], ["list"], ["info", "short"]],
    ),
    "mismatch": (
        "worn/scenario.toml",
        mutations.text_file,
        [["check", "worn"], ["run", "worn", *RUN]],
    ),
    "trajectory": (
        "short/trajectory.csv",
        mutations.text_file,
        [
            ["check", "short"],
            ["run", "short", *RUN],
            ["retime", "short", "--out", "out"],
            ["inputs", "short", "out.csv"],
        ],
    ),
    "sweep": ("sweep.toml", mutations.text_file, [["sweep", "sweep.toml", "--out", "out"]]),
    "sweep.json": (
        "swept/sweep.json",
        mutations.json_file,
        [
            ["sweep", "report", "swept", "--out", "out.html"],
            ["sweep", "promote", "swept", "3", "o"],
        ],
    ),
    "interface": (
        "box.toml",
        mutations.text_file,
        [["mjcf2fmu", "box.xml", "--interface", "box.toml", "--out", "out.fmu"]],
    ),
    "mjcf": (
        "box.xml",
        mutations.text_file,
        [["mjcf2fmu", "box.xml", "--out", "out.fmu"]],
    ),
    "results": (
        "swept/results/part-00000001.parquet",
        mutations.parquet_file,
        [["sweep", "report", "swept", "--out", "out.html"]],
    ),
    "session": (
        "session/session.jsonl",
        mutations.json_file,
        [["run", "--session", "session", *RUN]],
    ),
    "fmu": (
        "law.fmu",
        mutations.archive(["modelDescription.xml"], ["resources/variables.txt"]),
        [["info", "law.fmu"], ["run", "short", "--controller", "law.fmu", *RUN]],
    ),
    "ssp": (
        "Panda.ssp",
        mutations.archive(["SystemStructure.ssd"]),
        [["info", "Panda.ssp"], ["run", "--system", "Panda.ssp", "--duration", "0.02", *RUN]],
    ),
    "law": (
        "law.py",
        mutations.text_file,
        [["run", "short", "--controller", "law.py:Law", *RUN]],
    ),
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one good file of each kind."""
    folder = tmp_path_factory.mktemp("good")
    short = sweep_support.short_scenario(folder / "short")
    made_up(folder / "swept", 200)
    sweep_support.write_sweep(folder, 4, 'design = "random"\nkeep = "failures"\n')
    _record(folder, short)
    updated = CliRunner().invoke(app, ["regress", str(short), "--update", "--yes", "--jobs", "1"])
    assert (short / "reference.parquet").is_file(), updated.output
    worn = sweep_support.short_scenario(folder / "worn") / "scenario.toml"
    worn.write_text(worn.read_text(encoding="utf-8") + MISMATCH, encoding="utf-8")
    (folder / "law.py").write_text(LAW, encoding="utf-8")
    (folder / "box.xml").write_text(BOX, encoding="utf-8")
    (folder / "box.toml").write_text(
        describe(folder / "box.xml", ModelOptions(outputs=["site tip jacobian"])), encoding="utf-8"
    )
    assert CliRunner().invoke(app, ["build", "--out", str(folder)]).exit_code == 0
    (folder / "PandaController.fmu").rename(folder / "law.fmu")
    return folder


def _record(folder: Path, short: Path) -> None:
    """Record two runs and a session."""
    run_scenario(str(short), folder / "run")
    run_scenario(str(short), folder / "other", Options({"controller": {"kp": 6}}))
    with Session(str(short), folder / "session") as session:
        session.set("controller.kp", 6)
        session.set("plant.push_force", (0, 5, 0))
        session.step(40)
        session.release("plant.push_force")
        session.set_coupling("jacobi")
        session.move_waypoint(1, position=(0, 0, 0.006))
        session.step(40)


@pytest.fixture(scope="module")
def hands(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hands]:
    """What runs commands in a process beside."""
    working = Hands(tmp_path_factory)
    yield working
    working.worker.close()


class Hands:
    """A worker that is replaced when a command has ended it."""

    def __init__(self, folders: pytest.TempPathFactory) -> None:
        self._folders = folders
        self.worker = Worker(folders.mktemp("hands"))

    def do(self, folder: Path, arguments: list[str]) -> str:
        """Run a command; returns what is wrong with how it ended."""
        try:
            return str(self.worker.do(attempt, str(folder), arguments))
        except JobError as error:
            self.worker = Worker(self._folders.mktemp("hands"))
            return f"died or hung: {error}"


def _mutated(good: Path, case: Path, name: str, number: int) -> list[str]:
    """Make a folder in which one file is mutated; returns the command that reads it."""
    file, mutate, commands = KINDS[name]
    command = commands[number % len(commands)]
    needed = {word.partition(":")[0] for word in (file.partition("/")[0], *command)}
    if "sweep.toml" in needed or "run" in needed:
        needed.add("short")
    case.mkdir()
    for each in sorted(needed):
        if (good / each).is_dir():
            shutil.copytree(good / each, case / each)
        elif (good / each).is_file():
            shutil.copy(good / each, case / each)
    mutate(Random(f"{SEED} {name} {number}"), case / file)
    return command


def _faults(good: Path, folder: Path, name: str, numbers: range, hands: Hands) -> list[str]:
    faults = []
    for number in numbers:
        case = folder / str(number)
        command = _mutated(good, case, name, number)
        if wrong := hands.do(case, command):
            faults.append(f"{name} {number}, {' '.join(command)}: {wrong}")
        shutil.rmtree(case)
    return faults


@pytest.mark.parametrize("name", KINDS)
def test_a_damaged_file_is_used_or_refused(
    good: Path, tmp_path: Path, name: str, hands: Hands
) -> None:
    faults = _faults(good, tmp_path, name, range(SHORT), hands)
    assert not faults, "\n\n".join(faults)


@pytest.mark.long
@pytest.mark.parametrize("name", KINDS)
def test_many_damaged_files_are_used_or_refused(
    good: Path, tmp_path: Path, name: str, hands: Hands
) -> None:
    faults = _faults(good, tmp_path, name, range(LONG), hands)
    assert not faults, "\n\n".join(faults)
