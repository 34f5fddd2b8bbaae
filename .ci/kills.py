"""Kills commands at random, and looks at what they leave: `python .ci/kills.py 100 [COMMAND]`."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from panda_cosim.fmus.atomic import KEPT
from panda_cosim.result.recording import Recording
from panda_cosim.run.journal import JOURNAL_FILE, Journal
from panda_cosim.study.compare.reference import Reference

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from bounded import line_of
from fault_support import processes_with, write_scenario
from sweep_support import rows_of

PROGRAM = Path(sys.executable).with_name("panda-cosim")
PATIENCE = 60.0  # [s] for a command to end, on a busy machine
WHOLE = 12  # after so many kills, one is left to end
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
# Python says one of these if Ctrl-C comes before the program runs: in its own start, or in the line
# that imports the program.
PYTHON_STARTS = ("Fatal Python error: init_", "import main\n")


class Command:
    """A command that is started again and again in a folder.

    Of each attempt, `arguments` returns the command line, and `check` what it has to keep.
    """

    is_ended = False  # whether an attempt that is not killed has to be ended by Ctrl-C

    def __init__(self, folder: Path) -> None:
        self.folder, self.temporary, self.here = folder, folder / "tmp", folder / "here"
        for place in (self.temporary, self.here):
            place.mkdir(parents=True)
        self.scenarios = [
            write_scenario(folder / "mine" / name, duration)
            for name, duration in (("first", 0.3), ("other", 0.4))
        ]
        self.prepare()

    def start(self, arguments: Sequence[object]) -> subprocess.Popen[str]:
        """Start a command in a process group of its own."""
        places = {"TMPDIR": str(self.temporary), "PANDA_COSIM_CACHE": str(self.folder / "cache")}
        return subprocess.Popen(
            [PROGRAM, *map(str, arguments)], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True, cwd=self.here, env=os.environ | places,
            start_new_session=True,
        )  # fmt: skip

    def do(self, *arguments: object) -> None:
        """Run a command to its end."""
        process = self.start(arguments)
        _, complaint = process.communicate(timeout=5 * PATIENCE)
        assert process.returncode == 0, f"{arguments}: {process.returncode}\n{complaint}"

    def left(self) -> list[Path]:
        """Temporary files and folders."""
        return [*self.folder.rglob(".*"), *self.temporary.iterdir()]

    def age(self) -> None:
        """Make temporary files look so old that the next start removes them."""
        past = time.time() - 2 * KEPT
        for path in self.left():
            with suppress(OSError):
                os.utime(path, (past, past))

    def prepare(self) -> None:
        """Make what it needs."""
        self.do("run", self.scenarios[0], "--no-video", "--out", self.folder / "made")


class Build(Command):
    """FMUs and system are the old ones or the new ones, whole."""

    def prepare(self) -> None:
        self.out, self.contents = self.folder / "built", dict[str, set[bytes]]()
        for number in range(4):
            self.do(*self.arguments(number))
            for path in self.out.iterdir():
                self.contents.setdefault(path.name, set()).add(path.read_bytes())

    def arguments(self, number: int) -> list[object]:
        if number % 4 == 3:
            shutil.rmtree(self.folder / "cache", ignore_errors=True)
        scenario, fmi = self.scenarios[number % 2], 2 + number // 2 % 2
        return ["build", "--scenario", scenario, "--out", self.out, "--fmi", fmi]

    def check(self, number: int, *, is_whole: bool) -> None:
        files = {p.name: p.read_bytes() for p in self.out.iterdir() if p.name[0] != "."}
        assert files.keys() == self.contents.keys()
        assert not [name for name in files if files[name] not in self.contents[name]]


class Run(Command):
    """What was recorded opens; pictures are whole or not there."""

    def arguments(self, number: int) -> list[object]:
        pictures = [] if number // (2 * WHOLE) % 2 else ["--no-video"]
        return ["run", self.scenarios[0], "--out", self.folder / f"run{number}", *pictures]

    def check(self, number: int, *, is_whole: bool) -> None:
        folder = self.folder / f"run{number}"
        recording = check_recording(folder)
        if recording and (folder / "summary.json").exists():
            summary = json.loads((folder / "summary.json").read_text())
            assert summary["complete"] == recording.complete
        assert not is_whole or (recording and recording.complete)
        check_pictures(folder)
        shutil.rmtree(folder, ignore_errors=True)


class Regress(Command):
    """The reference is the old one or the new one, whole."""

    def arguments(self, number: int) -> list[object]:
        end = f"0.3,home,{0.01 + 1e-4 * number},0,0,0.08"
        table = f"time,frame,x,y,z,grip\n0,home,0,0,0,0.08\n{end}\n"
        (self.scenarios[0] / "trajectory.csv").write_text(table)
        return ["regress", "--scenarios", self.folder / "mine", "--update", "--yes"]

    def check(self, number: int, *, is_whole: bool) -> None:
        if number > 1:
            reference = Reference.read(self.scenarios[0] / "reference.parquet")
            assert reference.metadata["scenario"] == "first"


class Sweep(Command):
    """The same command goes on, and comes to the table of a sweep that nobody disturbed."""

    def prepare(self) -> None:
        self.out = self.folder / "undisturbed"
        self.do(*self.arguments(0))
        self.rows, self.out = rows_of(self.out), self.folder / "sweep"

    def arguments(self, number: int) -> list[object]:
        vary = ["--vary", "plant.block_mass=0.05:2:8"]
        return ["sweep", self.scenarios[0], *vary, "--jobs", "2", "--out", self.out]

    def check(self, number: int, *, is_whole: bool) -> None:
        if is_whole or any(self.out.glob("results/part-*")):
            rows = rows_of(self.out)
            assert rows == [row for row in self.rows if is_whole or row in rows]
        if is_whole:
            shutil.rmtree(self.out)


class Live(Command):
    """Recording and journal open."""

    is_ended = True

    def arguments(self, number: int) -> list[object]:
        return ["live", self.scenarios[0], "--out", self.folder / f"live{number}"]

    def check(self, number: int, *, is_whole: bool) -> None:
        folder = self.folder / f"live{number}"
        recording = check_recording(folder)
        if recording and recording.rows:
            Journal.read(folder / JOURNAL_FILE)
        shutil.rmtree(folder, ignore_errors=True)


class Render(Command):
    """Video and contact sheet are the old ones or the new ones, whole."""

    def arguments(self, number: int) -> list[object]:
        size, self.out = ("64x48", "96x64")[number % 2], self.folder / "pictures"
        return ["render", self.folder / "made", "--out", self.out, "--size", size, "--fps", "20"]

    def check(self, number: int, *, is_whole: bool) -> None:
        names = {path.name for path in self.out.iterdir() if path.name[0] != "."}
        assert names == {"video.mp4", "contact_sheet.png"}
        check_pictures(self.out)


def check_recording(folder: Path) -> Recording | None:
    """Return what was recorded, rows without a gap; None if it had not written a byte."""
    if not any(path.stat().st_size for path in folder.glob("recording.*")):
        return None
    recording = Recording.open(folder)
    assert np.allclose(recording.time, 0.001 * np.arange(recording.rows), rtol=0, atol=1e-9)
    return recording


def check_pictures(folder: Path) -> None:
    """No picture, page or video in a folder is cut short."""
    for path in folder.glob("[!.]*.png"):
        assert path.read_bytes().endswith(b"IEND\xaeB`\x82"), path
    for path in folder.glob("[!.]*.html"):
        assert path.read_text(encoding="utf-8").rstrip().endswith("</html>"), path
    for path in folder.glob("[!.]*.mp4"):
        content, at = path.read_bytes(), 0
        while at < len(content):  # its outermost boxes fill it
            at += int.from_bytes(content[at : at + 4])
        assert at == len(content), path


def attempt(command: Command, number: int, instant: float, by: signal.Signals | None) -> float:
    """Start a command, kill it at an instant [s] or let it end; returns how long it took [s]."""
    arguments, before, began = command.arguments(number), {*command.left()}, time.monotonic()
    process = command.start(arguments)
    if command.is_ended and not by:
        line_of(process)
    with suppress(subprocess.TimeoutExpired):
        process.wait(instant)
    if process.poll() is None:
        os.killpg(process.pid, by or signal.SIGINT)
    _, complaint = process.communicate(timeout=5 * PATIENCE)
    took, code = time.monotonic() - began, process.returncode
    allowed = {0} if by is None else {0, -by, *([128 + by] if by != signal.SIGKILL else [])}
    is_early = by == signal.SIGINT and any(words in complaint for words in PYTHON_STARTS)
    assert code in allowed or is_early, f"exit code {code}: {complaint}"
    assert by == signal.SIGKILL or is_early or "Traceback" not in complaint, complaint
    while processes_with(f"TMPDIR={command.temporary}"):
        assert time.monotonic() - began < took + PATIENCE, "a process goes on"
        time.sleep(0.02)
    command.check(number, is_whole=code == 0)
    left = [*command.left()] if by is None else {*command.left()} - before
    assert by == signal.SIGKILL or not left, f"left {left}: {complaint}"
    return took


def campaign(kind: type[Command], kills: int, folder: Path) -> None:
    """Kill a command so often with each signal, at instants between its start and its end."""
    command, chance, length = kind(folder), random.Random(kind.__name__), 0.0
    for number in range(3 * kills + 1):
        if number % WHOLE == 0:
            command.age()
            end = 1.0 if command.is_ended else 5 * PATIENCE
            length = attempt(command, 2 * number, end, None)
        attempt(command, 2 * number + 1, chance.uniform(0.0, length), SIGNALS[number % 3])
    print(f"{kind.__name__}: {3 * kills} kills, all in order", flush=True)


if __name__ == "__main__":
    kinds = {kind.__name__.lower(): kind for kind in Command.__subclasses__()}
    for name in sys.argv[2:] or kinds:
        with tempfile.TemporaryDirectory(prefix="kills-") as place:
            campaign(kinds[name], int(sys.argv[1]), Path(place, "box"))
