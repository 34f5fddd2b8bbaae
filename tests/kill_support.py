"""Kills commands at random instants, and looks at what they leave.

100 kills of one command with one signal: `python tests/kill_support.py run SIGTERM 100`
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from fault_support import processes_with, write_scenario
from panda_cosim.fmus.packaging.build import build
from panda_cosim.fmus.packaging.scratch import PREFIXES
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.regression.reference import Reference
from panda_cosim.scenarios.running.journal import JOURNAL_FILE, Journal
from sweep_support import rows_of

PROGRAM = Path(sys.executable).with_name("panda-cosim")
PATIENCE = 60.0  # [s] for a command to end, on a busy machine
WHOLE = 8  # after so many kills, one is left to end
PAST_GRACE = 60.0  # [s] age at which a temporary file without a lock counts as left behind
SMALL, LARGE = "64x48", "96x64"
NEVER = ("Traceback", "Exception ignored", "unexpected ")
PYTHON_STARTS = "init_import_site"  # Python says this if Ctrl-C comes before it runs any program


class Box:
    """A folder in which one command is started again and again.

    Attributes:
        folder: Of all its files.
        cache: Of FMUs.
        temporary: The folder for temporary files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cache, self.temporary = folder / "cache", folder / "tmp"
        self.here = folder / "here"
        for made in (self.temporary, self.here, self.cache):
            made.mkdir(parents=True)
        for fmu in build().values():
            shutil.copytree(fmu.parent, self.cache / fmu.parent.name)
        self.scenarios = [
            write_scenario(folder / "mine" / name, duration)
            for name, duration in (("first", 1.0), ("other", 1.1))
        ]
        self.environment = os.environ | {
            "PANDA_COSIM_CACHE": str(self.cache),
            "TMPDIR": str(self.temporary),
            "KILL_BOX": str(folder),
        }

    def start(self, arguments: Sequence[object]) -> subprocess.Popen[str]:
        """Start a command in a process group of its own."""
        return subprocess.Popen(
            [str(PROGRAM), *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=self.here,
            env=self.environment,
            start_new_session=True,
        )

    def do(self, *arguments: object) -> str:
        """Run a command to its end; returns what it says."""
        process = self.start(arguments)
        said, complaint = process.communicate(timeout=5 * PATIENCE)
        assert process.returncode == 0, f"{arguments}: {process.returncode}\n{complaint}"
        return said

    def processes(self) -> list[int]:
        """Living processes of its commands."""
        return list(processes_with(f"KILL_BOX={self.folder}"))

    def left(self) -> list[Path]:
        """Temporary files and folders."""
        scratch = [p for prefix in PREFIXES for p in self.folder.rglob(f"{prefix}*")]
        hidden = [p for p in self.folder.rglob(".*") if p not in scratch]
        return [*scratch, *hidden, *self.temporary.iterdir()]

    def age(self) -> None:
        """Make temporary files look older, so that the next start need not wait."""
        past = time.time() - PAST_GRACE
        for path in self.left():
            with suppress(OSError):
                os.utime(path, (past, past))


class Command:
    """A command that is killed; what each one has to keep is its `check`.

    Args:
        box: Where it is started.
        chance: Source of randomness.
    """

    ends_by: Callable[[signal.Signals], set[int]] = staticmethod(lambda number: {128 + number})

    def __init__(self, box: Box, chance: random.Random) -> None:
        self.box, self.chance = box, chance
        self.prepare()

    def prepare(self) -> None:
        """Make what it needs."""
        self.box.do("run", self.box.scenarios[0], "--no-video", "--out", self.box.folder / "made")

    def arguments(self, number: int) -> list[object]:
        """Return the command line of an attempt."""
        raise NotImplementedError

    def check(self, number: int, *, gently: bool) -> None:
        """Check the files after an attempt was killed.

        Args:
            number: Of the attempt.
            gently: Whether it was asked to end, so that it could clear up.
        """
        raise NotImplementedError

    def check_whole(self, number: int) -> None:
        """Check the files after an attempt came to its end."""
        self.check(number, gently=True)

    def wait(self, process: subprocess.Popen[str]) -> None:
        """Wait for an attempt that is not killed."""


class Build(Command):
    """FMUs and system are the old ones or the new ones, whole."""

    def prepare(self) -> None:
        """Make what it needs."""
        self.out = self.box.folder / "built"
        self.contents: dict[str, set[bytes]] = {}
        for scenario in self.box.scenarios:
            self.box.do("build", "--scenario", scenario, "--out", self.out)
            for path in self.out.iterdir():
                self.contents.setdefault(path.name, set()).add(path.read_bytes())

    def arguments(self, number: int) -> list[object]:
        """Return the command line of an attempt."""
        if self.chance.random() < 0.3:  # now they have to be made again
            shutil.rmtree(self.box.cache, ignore_errors=True)
        return ["build", "--scenario", self.box.scenarios[number % 2], "--out", self.out]

    def check(self, number: int, *, gently: bool) -> None:
        """Check the files after a kill."""
        del number, gently
        found = {path for path in self.out.iterdir() if not path.name.startswith(".")}
        assert {path.name for path in found} == self.contents.keys()
        for path in found:
            assert path.read_bytes() in self.contents[path.name], path


class Run(Command):
    """What was recorded opens; pictures are whole or not there."""

    def prepare(self) -> None:
        """Make what it needs."""
        super().prepare()
        self.lasting = write_scenario(self.box.folder / "lasting", 10.0)

    def arguments(self, number: int) -> list[object]:
        """Return the command line of an attempt."""
        pictures = self.chance.random() < 0.15
        scenario = self.box.scenarios[0] if pictures else self.lasting
        more = [] if pictures else ["--no-video"]
        return ["run", scenario, "--out", self.box.folder / f"run{number}", *more]

    def check(self, number: int, *, gently: bool) -> None:
        """Check the files after a kill."""
        folder = self.box.folder / f"run{number}"
        if any(folder.glob("recording.*")):
            recording = Recording.open(folder)
            check_rows(recording)
            summary = folder / "summary.json"
            assert summary.exists() or not gently, "no summary"
            if summary.exists():
                assert json.loads(summary.read_text())["complete"] == recording.complete
        check_pictures(folder)
        shutil.rmtree(folder, ignore_errors=True)


class Update(Command):
    """The reference is the old one or the new one, whole."""

    def prepare(self) -> None:
        """Make what it needs."""
        self.mine = self.box.folder / "mine"
        shutil.rmtree(self.box.scenarios[1])
        self.reference = self.box.scenarios[0] / "reference.parquet"
        self.box.do("regress", "--scenarios", self.mine, "--update", "--yes")
        self.before = self.reference.read_bytes()

    def arguments(self, number: int) -> list[object]:
        """Return the command line of an attempt."""
        self.before = self.reference.read_bytes()
        table = (
            f"time,frame,x,y,z,grip\n0,home,0,0,0,0.08\n1,home,{0.01 + 1e-4 * number},0,0,0.08\n"
        )
        (self.box.scenarios[0] / "trajectory.csv").write_text(table)
        return ["regress", "--scenarios", self.mine, "--update", "--yes"]

    def check(self, number: int, *, gently: bool) -> None:
        """Check the files after a kill."""
        del number, gently
        assert Reference.read(self.reference).metadata["scenario"] == "first"

    def check_whole(self, number: int) -> None:
        """Check the files after an attempt came to its end."""
        self.check(number, gently=True)
        assert self.reference.read_bytes() != self.before


class Sweep(Command):
    """The same command goes on, and comes to the table of a sweep that nobody disturbed."""

    def prepare(self) -> None:
        """Make what it needs."""
        self.count = 0
        self.box.do(*self.arguments(0))
        self.rows = rows_of(self._out)
        self.count = 1

    @property
    def _out(self) -> Path:
        return self.box.folder / f"sweep{self.count}"

    def arguments(self, number: int) -> list[object]:
        """Return the command line of an attempt."""
        del number
        vary = ["--vary", "plant.block_mass=0.05:2:8"]
        return ["sweep", self.box.scenarios[0], *vary, "--jobs", "2", "--out", self._out]

    def check(self, number: int, *, gently: bool) -> None:
        """Check the files after a kill."""
        del number, gently
        if (self._out / "results").is_dir() and any((self._out / "results").glob("part-*")):
            rows = rows_of(self._out)
            assert rows == [row for row in self.rows if row in rows]

    def check_whole(self, number: int) -> None:
        """Check the files after an attempt came to its end."""
        del number
        assert rows_of(self._out) == self.rows
        shutil.rmtree(self._out)
        self.count += 1


class Live(Command):
    """Recording and journal open."""

    # Ctrl-C is how it is ended while it serves.
    ends_by = staticmethod(lambda number: {128 + number, *([0] if number == signal.SIGINT else [])})

    def arguments(self, number: int) -> list[object]:
        """Return the command line of an attempt."""
        return ["live", self.box.scenarios[0], "--out", self.box.folder / f"live{number}"]

    def check(self, number: int, *, gently: bool) -> None:
        """Check the files after a kill."""
        folder = self.box.folder / f"live{number}"
        if any(folder.glob("recording.*")):
            recording = Recording.open(folder)
            check_rows(recording)
            if recording.rows or gently:
                Journal.read(folder / JOURNAL_FILE)
        shutil.rmtree(folder, ignore_errors=True)

    def wait(self, process: subprocess.Popen[str]) -> None:
        """Press Ctrl-C once it serves."""
        assert process.stdout
        process.stdout.readline()
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)


class Render(Command):
    """Video and contact sheet are the old ones or the new ones, whole."""

    def prepare(self) -> None:
        """Make what it needs."""
        super().prepare()
        self.out = self.box.folder / "pictures"
        self.box.do(*self.arguments(0))

    def arguments(self, number: int) -> list[object]:
        """Return the command line of an attempt."""
        size = (SMALL, LARGE)[number % 2]
        run = self.box.folder / "made"
        return ["render", run, "--out", self.out, "--size", size, "--fps", "20"]

    def check(self, number: int, *, gently: bool) -> None:
        """Check the files after a kill."""
        del number, gently
        names = {path.name for path in self.out.iterdir() if not path.name.startswith(".")}
        assert names == {"video.mp4", "contact_sheet.png"}
        check_pictures(self.out)


COMMANDS: dict[str, type[Command]] = {
    "build": Build,
    "run": Run,
    "regress": Update,
    "sweep": Sweep,
    "live": Live,
    "render": Render,
}


def check_rows(recording: Recording) -> None:
    """Rows follow each other without a gap, and hold numbers."""
    times = recording.time
    assert (abs(times - 0.001 * np.arange(len(times))) < 1e-9).all()
    assert abs(recording["plant.qpos"]).max(initial=0.0) < 10.0


def check_pictures(folder: Path) -> None:
    """No picture, page or video in a folder is cut short."""
    for path in folder.glob("[!.]*.png"):
        assert path.read_bytes().endswith(b"IEND\xaeB`\x82"), path
    for path in folder.glob("[!.]*.html"):
        assert path.read_text(encoding="utf-8").rstrip().endswith("</html>"), path
    for path in folder.glob("[!.]*.mp4"):
        assert {b"ftyp", b"moov", b"mdat"} <= set(boxes(path.read_bytes())), path


def boxes(content: bytes) -> list[bytes]:
    """Return the types of an MP4's outermost boxes, which must fill it."""
    found, at = [], 0
    while at < len(content):
        size, kind = struct.unpack(">I4s", content[at : at + 8])
        assert 8 <= size <= len(content) - at, f"box {kind!r} is cut short"
        found.append(kind)
        at += size
    return found


@dataclass
class Tally:
    """What the kills came to.

    Attributes:
        killed: Attempts that a signal ended.
        finished: Attempts that were done before the signal came, or were left to end.
        faults: What did not hold.
        slowest: Longest time from a signal to the end [s].
    """

    killed: int = 0
    finished: int = 0
    faults: list[str] = field(default_factory=list)
    slowest: float = 0.0


def kill_often(name: str, number: signal.Signals, kills: int, folder: Path, seed: int = 1) -> Tally:
    """Kill a command at random instants between its start and its end.

    Args:
        name: Of the command.
        number: The signal. Half of the time the whole group gets it, as from a terminal.
        kills: How many.
        folder: A new folder.
        seed: Of instants and choices.
    """
    chance = random.Random(f"{name} {number} {seed}")
    box = Box(folder)
    command = COMMANDS[name](box, chance)
    tally = Tally()
    attempt, length = 1, _whole(command, 1)
    while tally.killed < kills:
        attempt += 1
        if attempt % WHOLE == 0:
            box.age()
            length = _whole(command, attempt)
            continue
        fault = _kill(command, attempt, number, chance.uniform(0.0, 1.05 * length), tally)
        if fault:
            tally.faults.append(f"{name} {number.name} {attempt}: {fault}")
            print(tally.faults[-1], flush=True)
    box.age()
    _whole(command, attempt + 1)
    return tally


def _whole(command: Command, attempt: int) -> float:
    """Let an attempt come to its end, after which nothing of the killed ones is left."""
    began = time.monotonic()
    process = command.box.start(command.arguments(attempt))
    command.wait(process)
    _, complaint = process.communicate(timeout=5 * PATIENCE)
    length = time.monotonic() - began
    assert process.returncode == 0, complaint
    command.check_whole(attempt)
    assert not command.box.left(), command.box.left()
    return length


def _kill(
    command: Command, attempt: int, number: signal.Signals, delay: float, tally: Tally
) -> str:
    """Kill an attempt; returns what does not hold."""
    gently = number != signal.SIGKILL
    process = command.box.start(command.arguments(attempt))
    to_group = command.chance.random() < 0.5
    with suppress(subprocess.TimeoutExpired):
        process.wait(delay)
    began = time.monotonic()
    if process.poll() is None:
        (os.killpg if to_group else os.kill)(process.pid, number)
    try:
        _, complaint = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        tally.killed += 1
        return f"{delay:.3f} s: goes on: {_kill_all(command.box)}"
    tally.slowest = max(tally.slowest, time.monotonic() - began)
    code = process.returncode
    try:
        _check_end(command, code, complaint, number)
        _wait_for_processes(command.box)
        if code == 0 and not isinstance(command, Live):
            tally.finished += 1
            command.check_whole(attempt)
        else:
            tally.killed += 1
            command.check(attempt, gently=gently)
        assert not (gently and command.box.left()), f"left {command.box.left()}"
    except Exception as error:
        group = " (group)" if to_group else ""
        said = f"{type(error).__name__}: {error}"
        return f"{delay:.3f} s{group}, code {code}: {said}; stderr: {complaint[-1500:]!r}"
    return ""


def _kill_all(box: Box) -> list[str]:
    """Kill all living processes of a box; returns their command lines."""
    found = []
    for process in box.processes():
        with suppress(OSError):
            found.append(Path(f"/proc/{process}/cmdline").read_text().replace("\0", " "))
            os.kill(process, signal.SIGKILL)
    return found


def _check_end(command: Command, code: int, complaint: str, number: signal.Signals) -> None:
    """Check exit code and standard error."""
    allowed = {0, -number}  # it was done; or it had not yet begun
    if number != signal.SIGKILL:
        allowed |= command.ends_by(number)
        if PYTHON_STARTS in complaint:
            return
        for word in NEVER:
            assert word not in complaint, word
    assert code in allowed, f"exit code {code}"


def _wait_for_processes(box: Box) -> None:
    end = time.monotonic() + PATIENCE / 2
    while box.processes():
        assert time.monotonic() < end, f"processes {box.processes()} go on"
        time.sleep(0.02)


if __name__ == "__main__":
    chosen, kind, count = sys.argv[1], signal.Signals[sys.argv[2]], int(sys.argv[3])
    place = Path(tempfile.mkdtemp(prefix="kills-"))
    done = kill_often(chosen, kind, count, place / "box", int((sys.argv[4:] or ["1"])[0]))
    shutil.rmtree(place)
    print(
        f"{chosen} {kind.name}: {done.killed} killed, {done.finished} finished, "
        f"{len(done.faults)} faults, {done.slowest:.2f} s to end at most"
    )
    sys.exit(bool(done.faults))
