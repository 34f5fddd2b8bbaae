"""Kills commands at random instants, and looks at what they leave.

100 kills of one command with each signal: `python tests/kill_support.py 100 run`; of all commands:
`python tests/kill_support.py 100 --log kills.jsonl`, which continues if it has been stopped.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

import forked
import numpy as np
from bounded import line_of
from fault_support import processes_with, write_scenario
from panda_cosim.fmus.atomic import KEPT
from panda_cosim.fmus.sources.targets import build
from panda_cosim.scenarios.compare.reference import Reference
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.run.journal import JOURNAL_FILE, Journal
from sweep_support import rows_of

PROGRAM = Path(sys.executable).with_name("panda-cosim")
PATIENCE = 60.0  # [s] for a command to end, on a busy machine
WHOLE = 12  # after so many kills, one is left to end
AFRESH = 0.3  # share of builds that find no FMUs in the cache
BESIDE = 0.2  # share of builds beside which another one writes to the same folder
PICTURES = 0.1  # share of runs that draw
REAL = 0.15  # share of attempts that Python starts anew, and does not fork
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
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
            for name, duration in (("first", 0.3), ("other", 0.4))
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

    def fork(self, arguments: Sequence[object]) -> forked.Forked:
        """Start a command likewise, forked from a process that has imported everything."""
        return forked.start(arguments, self.here, self.environment)

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
        return [*self.folder.rglob(".*"), *self.temporary.iterdir()]

    def keep(self, path: Path) -> Path:
        """Copy a file that is not as it should be to where it outlasts the box."""
        kept = self.folder.with_name("odd") / f"{time.time_ns()}-{path.name}"
        kept.parent.mkdir(exist_ok=True)
        shutil.copy(path, kept)
        return kept

    def age(self) -> None:
        """Make temporary files look older, so that the next start need not wait."""
        past = time.time() - 2 * KEPT
        for path in self.left():
            with suppress(OSError):
                os.utime(path, (past, past))


class Command:
    """A command that is killed; what each one has to keep is its `check`.

    Args:
        name: Its name.
        box: Where it is started.
        chance: Source of randomness.

    Attributes:
        kind: What the present attempt does, if attempts take unequally long.
    """

    kind = ""
    ends_by: Callable[[signal.Signals], set[int]] = staticmethod(lambda number: {128 + number})

    def __init__(self, name: str, box: Box, chance: random.Random) -> None:
        self.name, self.box, self.chance = name, box, chance
        self._took: dict[tuple[str, bool], deque[float]] = defaultdict(partial(deque, maxlen=3))
        self.prepare()

    def took(self, seconds: float, *, is_forked: bool) -> None:
        """Note how long the present attempt took."""
        self._took[self.kind, is_forked].append(seconds)

    def length(self, *, is_forked: bool) -> float:
        """Return the time that the present attempt will take: the longest of the last three [s]."""
        like = self._took[self.kind, is_forked] or [t for each in self._took.values() for t in each]
        return max(like)

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
    """FMUs and system are the old ones or the new ones, whole, also if two build side by side."""

    def prepare(self) -> None:
        """Make what it needs."""
        self.out = self.box.folder / "built"
        self.contents: dict[str, list[bytes]] = defaultdict(list)
        self.beside: list[subprocess.Popen[str]] = []
        for arguments in (self.line(scenario, fmi) for scenario in (0, 1) for fmi in (2, 3)):
            self.box.do(*arguments)
            for path in self.out.iterdir():
                self.contents[path.name].append(path.read_bytes())

    @property
    def largest(self) -> int:
        """Size of the smallest of the systems, which are the largest files."""
        return min(map(len, self.contents["Panda.ssp"]))

    def line(self, scenario: int, fmi: int) -> list[object]:
        """Return the command line for one of the scenarios and a version of FMI."""
        place = self.box.scenarios[scenario]
        return ["build", "--scenario", place, "--out", self.out, "--fmi", fmi]

    def arguments(self, number: int) -> list[object]:
        """Return the command line of an attempt."""
        self.kind = "afresh" if self.chance.random() < AFRESH else "cached"
        if self.kind == "afresh":
            shutil.rmtree(self.box.cache, ignore_errors=True)
        lines = [self.line(number % 2, fmi) for fmi in (2, 3)]
        self.chance.shuffle(lines)
        if self.chance.random() < BESIDE:
            self.kind += " beside another"
            self.beside.append(self.box.start(lines[1]))
        return lines[0]

    def check(self, number: int, *, gently: bool) -> None:
        """Check the files after a kill."""
        del number, gently
        while self.beside:
            other = self.beside.pop()
            _, complaint = other.communicate(timeout=5 * PATIENCE)
            assert other.returncode == 0, f"the one beside it: {complaint}"
        found = {path for path in self.out.iterdir() if not path.name.startswith(".")}
        assert {path.name for path in found} == self.contents.keys()
        odd = [
            f"{self.box.keep(path)}: {differences(path.read_bytes(), self.contents[path.name])}"
            for path in found
            if path.read_bytes() not in self.contents[path.name]
        ]
        assert not odd, odd


class Run(Command):
    """What was recorded opens; pictures are whole or not there."""

    def prepare(self) -> None:
        """Make what it needs."""
        super().prepare()
        self.lasting = write_scenario(self.box.folder / "lasting", 5.0)

    def arguments(self, number: int) -> list[object]:
        """Return the command line of an attempt."""
        self.kind = "pictures" if self.chance.random() < PICTURES else "plain"
        scenario, more = self.lasting, ["--no-video"]
        if self.kind == "pictures":
            scenario, more = self.box.scenarios[0], []
        return ["run", scenario, "--out", self.box.folder / f"run{number}", *more]

    def check(self, number: int, *, gently: bool) -> None:
        """Check the files after a kill."""
        folder = self.box.folder / f"run{number}"
        recording = check_recording(folder)
        if recording:
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
            f"time,frame,x,y,z,grip\n0,home,0,0,0,0.08\n0.3,home,{0.01 + 1e-4 * number},0,0,0.08\n"
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
        recording = check_recording(folder)
        if recording and recording.rows:
            Journal.read(folder / JOURNAL_FILE)
        shutil.rmtree(folder, ignore_errors=True)

    def wait(self, process: subprocess.Popen[str]) -> None:
        """Press Ctrl-C once it serves."""
        line_of(process)
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


def differences(content: bytes, expected: Sequence[bytes]) -> str:
    """Tell how an archive differs from that of the expected ones that is closest to it."""
    for one in expected:
        if one.startswith(content):
            return f"cut off after {len(content)} of {len(one)} bytes"
    if not zipfile.is_zipfile(io.BytesIO(content)):
        return f"no archive, {len(content)} bytes"
    return min((_between(content, one) for one in expected), key=len)


def _between(content: bytes, other: bytes) -> str:
    """Name the members of two archives that differ, and, within these, what differs there."""
    ours, theirs = (
        {info.filename: (info, file.read(info)) for info in file.infolist()}
        for file in (zipfile.ZipFile(io.BytesIO(each)) for each in (content, other))
    )
    odd = sorted({*ours} ^ {*theirs})
    for name in sorted({*ours} & {*theirs}):
        (info, member), (other_info, other_member) = ours[name], theirs[name]
        if member == other_member:
            if str(info) != str(other_info):
                odd.append(f"{name}: {info} {other_info}")
        elif name.endswith(".fmu") and zipfile.is_zipfile(io.BytesIO(member)):
            odd.append(f"{name}: ({_between(member, other_member)})")
        else:
            at = next(
                (i for i, (a, b) in enumerate(zip(member, other_member, strict=False)) if a != b),
                -1,
            )
            odd.append(f"{name}: {len(member)} and {len(other_member)} bytes, differ from {at} on")
    return ", ".join(odd) or "order, dates or compression"


def check_recording(folder: Path) -> Recording | None:
    """Return what a run has recorded: rows without a gap that hold numbers; or nothing yet."""
    if not any(path.stat().st_size for path in folder.glob("recording.*")):
        return None  # it was killed before its first byte
    recording = Recording.open(folder)
    times = recording.time
    assert (abs(times - 0.001 * np.arange(len(times))) < 1e-9).all()
    assert abs(recording["plant.qpos"]).max(initial=0.0) < 10.0
    return recording


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
class Kill:
    """One kill.

    Attributes:
        command: What was killed.
        signal: How.
        instant: Time from its start to the signal [s].
        length: Time that the command takes [s].
        group: Whether its whole group got the signal, as from a terminal.
        forked: Whether it was forked, and not started by Python anew.
        code: Its exit code; None: it went on.
        seconds: Time from that instant to its end [s]; negative if it was done by then.
        load: Processes that wanted a core.
        left: Temporary files, folders and processes afterwards.
        fault: What does not hold.
    """

    command: str
    signal: str
    instant: float
    length: float
    group: bool
    forked: bool
    code: int | None = None
    seconds: float = 0.0
    load: float = 0.0
    left: list[str] = field(default_factory=list)
    fault: str = ""

    @property
    def counts(self) -> bool:
        """Whether the signal came before the command's end."""
        return self.code != 0 or self.command == "live"


def kill_often(
    name: str,
    wanted: Mapping[signal.Signals, int],
    folder: Path,
    seed: str = "",
    note: Callable[[Kill], object] = lambda kill: None,
) -> list[Kill]:
    """Kill a command at random instants between its start and its end, the signals in turn.

    Args:
        name: Of the command.
        wanted: How many kills with each signal.
        folder: A new folder.
        seed: Of instants and choices.
        note: Called with each kill.

    Returns:
        Those that came before the end, and all with a fault.
    """
    chance = random.Random(f"{name} {seed}")
    box = Box(folder)
    command = COMMANDS[name](name, box, chance)
    left, kills = Counter(wanted), []
    attempt = 1
    _whole(command, attempt)
    while due := [*left.elements()]:
        attempt += 1
        assert attempt < 20 * (1 + sum(wanted.values())), f"{name} ends before the signals come"
        if attempt % WHOLE == 0:
            box.age()
            _whole(command, attempt)
            continue
        number = max(due, key=lambda each: left[each])
        kill = _kill(command, attempt, number)
        if kill.counts or kill.fault:
            kills.append(kill)
            left[number] -= 1
            note(kill)
    box.age()
    _whole(command, attempt + 1)
    return kills


def _whole(command: Command, attempt: int) -> None:
    """Let an attempt come to its end, after which nothing of the killed ones is left."""
    arguments = command.arguments(attempt)
    began = time.monotonic()
    process = command.box.start(arguments)
    command.wait(process)
    _, complaint = process.communicate(timeout=5 * PATIENCE)
    command.took(time.monotonic() - began, is_forked=False)
    assert process.returncode == 0, complaint
    command.check_whole(attempt)
    assert not command.box.left(), command.box.left()


def _kill(command: Command, attempt: int, number: signal.Signals) -> Kill:
    """Kill an attempt, and see what it leaves."""
    box, chance = command.box, command.chance
    arguments, is_forked = command.arguments(attempt), chance.random() > REAL
    length = command.length(is_forked=is_forked)
    instant = chance.uniform(0.0, 1.05 * length)
    kill = Kill(command.name, number.name, instant, length, chance.random() < 0.5, is_forked)
    before = {*box.left()}
    process = box.fork(arguments) if is_forked else box.start(arguments)
    due = time.monotonic() + instant
    with suppress(subprocess.TimeoutExpired):
        process.wait(instant)
    if process.poll() is None:
        try:
            (os.killpg if kill.group else os.kill)(process.pid, number)
        except ProcessLookupError:  # it has ended; or it was forked, and is not yet a group
            with suppress(ProcessLookupError):
                os.kill(process.pid, number)
    try:
        _, complaint = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        kill.fault = f"goes on: {_kill_all(box)}"
        os.kill(process.pid, signal.SIGKILL)
        return kill
    kill.code, kill.load = process.returncode, os.getloadavg()[0]
    kill.seconds = time.monotonic() - due
    try:
        _check_end(command, process.returncode, complaint, number)
        _wait_for_processes(box)
        if kill.counts:
            command.check(attempt, gently=number != signal.SIGKILL)
        else:
            command.took(instant + kill.seconds, is_forked=is_forked)
            command.check_whole(attempt)
    except Exception as error:
        kill.fault = f"{type(error).__name__}: {error}; stderr: {complaint[-1500:]!r}"
    kill.left = [str(path) for path in box.left() if path not in before]
    if kill.left and number != signal.SIGKILL and not kill.fault:
        kill.fault = f"left {kill.left}; stderr: {complaint[-1500:]!r}"
    return kill


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
    end = time.monotonic() + PATIENCE
    while box.processes():
        assert time.monotonic() < end, f"processes {box.processes()} go on"
        time.sleep(0.02)


def campaign(names: Sequence[str], kills: int, log: Path, seed: str) -> bool:
    """Kill commands until a log has enough kills without a fault; return whether all held."""
    done = Counter[tuple[str, str]]()
    if log.exists():
        before = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
        done.update((kill["command"], kill["signal"]) for kill in before if not kill["fault"])
    held = True
    for name in names:
        wanted = {each: max(0, kills - done[name, each.name]) for each in SIGNALS}
        place = Path(tempfile.mkdtemp(prefix="kills-"))
        with log.open("a", encoding="utf-8", buffering=1) as file:
            made = kill_often(
                name, wanted, place / "box", f"{seed} {wanted}",
                lambda kill: file.write(json.dumps(asdict(kill)) + "\n"),
            ) if any(wanted.values()) else []  # fmt: skip
        shutil.rmtree(place / "box", ignore_errors=True)
        with suppress(OSError):  # it holds odd files
            place.rmdir()
        faults = [kill for kill in made if kill.fault]
        held = held and not faults
        print(f"{name}: {len(made)} kills, {len(faults)} faults", flush=True)
        for kill in faults:
            print(f"  {kill}", flush=True)
    return held


def main() -> int:
    """Read the command line and kill."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kills", type=int, help="of each command with each signal")
    parser.add_argument("commands", nargs="*", default=[*COMMANDS], help="all, if none is named")
    parser.add_argument("--log", type=Path, help="one line of JSON for each kill")
    parser.add_argument("--seed", default="1")
    given = parser.parse_args()
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as in a job in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with tempfile.TemporaryDirectory() as folder:
            log = given.log or Path(folder) / "log"
            return int(not campaign(given.commands, given.kills, log, given.seed))
    finally:
        forked.end()
        print(f"{processor_time():.0f} s of processor time")


def processor_time() -> float:
    """Return the processor time of this process and of those that it has waited for [s]."""
    all_of_it = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in all_of_it)


if __name__ == "__main__":
    sys.exit(main())
