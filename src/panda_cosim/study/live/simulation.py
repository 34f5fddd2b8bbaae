"""Steps a session in real time, and carries out commands between two rows.

Commands come from a page: small JSON objects, which are checked here.
"""

from __future__ import annotations

import io
import queue
import time
import zipfile
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final, Literal, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, RootModel

from ...fmus.errors import CosimError, InputError, SimulationError
from ...fmus.master.wiring import Array
from ...run.folder import SCENARIO_FOLDER
from ...run.journal import JOURNAL_FILE, Release, Set, SetCoupling
from ...run.session import Session
from ...task.fields import validated
from ...task.tolerances import flattened
from .page import offset_of, plan

ROW: Final = 0.01  # [s] least wall time between two rows
REST: Final = 0.05  # [s] between two checks for commands while paused
KEPT: Final = 6000  # rows kept for pages opened later
LAG: Final = 0.25  # [s] behind the clock beyond which it does not catch up
STATUS: Final = 0.25  # [s] between two reports of the status
QUEUED: Final = 64  # commands
TURN: Final = 8  # most commands between two rows
OVER: Final = "the scenario is over; restart begins another run"

Number = Annotated[float, Field(allow_inf_nan=False)]
Place = Annotated[Number, Field(ge=-10.0, le=10.0)]  # [m]


class _Command(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Act(_Command):
    """Run, pause, restart, or release all held forces, as the user who pushed has left."""

    do: Literal["play", "pause", "restart", "let_go"]


class Step(_Command):
    """Take some ticks, then pause."""

    do: Literal["step"]
    ticks: Annotated[int, Field(ge=1, le=1000)]


class Speed(_Command):
    """Run at a speed relative to the wall clock."""

    do: Literal["speed"]
    factor: Annotated[Number, Field(ge=0.01, le=10.0)]


class Drag(_Command):
    """Move a later row of the table to another position in the world [m]."""

    do: Literal["waypoint"]
    row: Annotated[int, Field(ge=0, le=100_000)]
    position: Annotated[list[Place], Field(min_length=3, max_length=3)]


class Keep(_Command):
    """Write the session so far as a scenario, into a new folder in the working directory."""

    do: Literal["keep"]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]


Command = Act | Step | Speed | Set | Release | SetCoupling | Drag | Keep


class _Message(RootModel[Annotated[Command, Field(discriminator="do")]]):
    """What a page sends."""


def parse_command(text: str | bytes) -> Command:
    """Read a command."""
    with validated("command"):
        return _Message.model_validate_json(text).root


def _row(session: Session) -> Array:
    """Current values (n,) of the page's columns."""
    return np.array(list(session.numbers().values()))


class Viewers(Protocol):
    """Who sees a simulation: the clients of `LiveServer`."""

    def rows(self, rows: Array) -> None:
        """Show rows (n, k) of the page's columns."""

    def status(self, status: dict[str, object]) -> None:
        """Show the simulation's status."""

    def plan(self, plan: dict[str, object]) -> None:
        """Show a new commanded path."""


class Simulation:
    """A session in real time. One thread calls `run`; `ask` may be called from others."""

    def __init__(self, session: Session, speed: float = 1.0, *, playing: bool = True) -> None:
        self.history: deque[Array] = deque([_row(session)], maxlen=KEPT)
        self._session, self._speed = session, speed
        self._rate = 1.0 / session.scenario.step  # steps per second
        self._commands: queue.Queue[tuple[Command, Callable[[str], None]]] = queue.Queue(QUEUED)
        self._playing, self._run, self._message = playing, 1, ""
        self._behind = self._told = 0.0
        self._anchor()

    def ask(self, command: Command, refuse: Callable[[str], None]) -> None:
        """Queue a command."""
        try:
            self._commands.put_nowait((command, refuse))
        except queue.Full:
            refuse("too many commands at once")

    def run(self, viewers: Viewers) -> None:
        """Step and carry out commands until interrupted."""
        while True:
            changed = self._obey(viewers)
            if self._playing:
                self._advance(viewers)
            if changed or time.monotonic() - self._told > STATUS:
                self._told = time.monotonic()
                viewers.status(self.status())

    def status(self) -> dict[str, object]:
        """The simulation's status, in the page's form."""
        session = self._session
        values = dict(flattened(session.parameters))
        return {
            "run": self._run,
            "playing": self._playing,
            "over": session.is_over,
            "speed": self._speed,
            "coupling": session.coupling,
            "values": {name: values[name] for name in session.tunables},
            "behind": round(self._behind, 3),
            "folder": str(session.folder),
            "message": self._message,
        }

    def plan(self) -> dict[str, object]:
        """The commanded path and its waypoints."""
        return plan(self._session)

    def journal(self) -> bytes:
        """Return a zip archive of the current run's journal and scenario; from any thread."""
        folder, archive = self._session.folder, io.BytesIO()
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
            for path in (folder / JOURNAL_FILE, *sorted((folder / SCENARIO_FOLDER).rglob("*"))):
                if path.is_file():
                    packed.write(path, Path(folder.name) / path.relative_to(folder))
        return archive.getvalue()

    def _anchor(self) -> None:
        """Restart the clock from here."""
        self._wall, self._tick = time.monotonic(), self._session.tick
        self._behind = 0.0

    def _advance(self, viewers: Viewers) -> None:
        """Take the steps up to the next row once they are due."""
        size = max(1, round(ROW * self._speed * self._rate))
        due = self._wall + (self._session.tick + size - self._tick) / (self._rate * self._speed)
        wait = due - time.monotonic()
        if wait > 0:
            time.sleep(min(wait, REST))
            if wait > REST:
                return  # to look for commands
        self._step(size, viewers)
        late = max(0.0, time.monotonic() - due)
        if late > LAG:
            self._anchor()
        self._behind = late

    def _step(self, size: int, viewers: Viewers) -> None:
        try:
            self._session.step(size)
        except SimulationError as error:
            self._playing, self._message = False, str(error)
            return
        self._show(viewers)
        if self._session.is_over:
            outcome = self._session.close().summary.brief  # nothing is journalled from now on
            self._playing, self._message = False, f"the scenario is over: {outcome}"

    def _show(self, viewers: Viewers) -> None:
        row = _row(self._session)
        self.history.append(row)
        viewers.rows(row[np.newaxis])

    def _obey(self, viewers: Viewers) -> bool:
        """Carry out queued commands; while paused, wait a little for one."""
        done = False
        for _ in range(TURN):  # a flood of them must not hold up the simulation
            try:
                wait = not (self._playing or done)
                command, refuse = self._commands.get(block=wait, timeout=REST if wait else None)
            except queue.Empty:
                return done
            done = True
            try:
                self._do(command, viewers)
            except CosimError as error:
                session = self._session
                if not (session.is_open or session.is_over):  # after a restart that failed
                    raise
                refuse(str(error))
        return done

    def _do(self, command: Command, viewers: Viewers) -> None:
        session = self._session
        match command:
            case Set() | Release() | SetCoupling() | Drag() | Step() | Act(do="play") if (
                session.is_over
            ):
                raise InputError(OVER)
            case Act():
                self._act(command.do, viewers)
            case Step():
                self._playing = False
                self._step(command.ticks, viewers)
            case Speed():
                self._speed = command.factor
            case Set() | Release() | SetCoupling():
                session.act(command)
            case Drag():
                row, last = command.row, len(session.table.rows) - 1
                if row > last:
                    raise InputError(f"waypoint: row {row}; must be from 0 to {last}")
                session.move_waypoint(row, position=offset_of(session, row, command.position))
                viewers.plan(self.plan())
            case Keep():  # in the working directory
                session.keep(command.name)
                self._message = f"kept as a scenario: panda-cosim run ./{command.name}"
        if isinstance(command, Act | Step | Speed):
            self._anchor()

    def _act(self, do: str, viewers: Viewers) -> None:
        session = self._session
        if do == "restart":
            before = session.folder
            session.restart()
            self._run, self._message = self._run + 1, f"the run before is in {before}"
            self.history.clear()
            viewers.plan(self.plan())
            self._show(viewers)
        elif do == "let_go":
            for name in dict.fromkeys(held.partition("[")[0] for held in session.held):
                if name.endswith("_force"):
                    session.release(name)
        else:
            self._playing = do == "play"
