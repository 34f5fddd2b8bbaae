"""The master: steps slaves side by side at one communication step, and exchanges values.

It knows no FMI, only the `Slave` protocol, so that its algorithm is tested with fakes. The
contract of one run, in order:

1. each slave has been initialized; all outputs are read: they belong to t_0.
2. For each tick k, at t_k = k * step_size:
   Gauss-Seidel: the external inputs of t_k are taken. Each leader (a slave that feeds a later
   one) is set, stepped and read: what it answers acts at once. The row of t_k is recorded.
   The followers are set, stepped and read: their outputs belong to t_k+1.
   Jacobi: the external inputs of t_k are taken, the row of t_k is recorded; all slaves are
   set, then all stepped, then all read. What a slave answers acts one tick later.
3. A last row is recorded at the end, with the external inputs of that instant.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from fmus.errors import CosimError, InputError, SimulationError
from fmus.tables import Connection

Array = NDArray[np.float64]
Coupling = Literal["gauss-seidel", "jacobi"]
COUPLINGS: tuple[Coupling, ...] = ("gauss-seidel", "jacobi")
FLUSH_INTERVAL = 0.5  # [s] wall time; what a kill may cost
CLOCK_INTERVAL = 32  # [tick] between two looks at the wall clock
Name = tuple[str, str]  # instance and scalar variable


class Slave(Protocol):
    """What the master needs of a slave."""

    name: str

    def bind_get(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        """Make a function that reads variables into a buffer (len(names),)."""

    def bind_set(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        """Make a function that writes variables from a buffer (len(names),)."""

    def step(self, time: float, step_size: float) -> None:
        """Advance from `time` by `step_size` [s]."""


@dataclass
class Report:
    """How a run went.

    Attributes:
        steps: Completed steps.
        wall_time: Time that stepping took [s].
        overruns: Ticks that ended too late for real time.
        worst_lateness: How late the latest was [s].
    """

    steps: int = 0
    wall_time: float = 0.0
    overruns: int = 0
    worst_lateness: float = 0.0


@dataclass
class _Ports:
    """One slave with what a tick does to it."""

    slave: Slave
    pull: Callable[[], None] | None  # gathers scattered inputs, if they are scattered
    put: Callable[[], None] | None
    get: Callable[[], None] | None
    step: Callable[[float, float], None] = field(init=False)

    def __post_init__(self) -> None:
        self.step = self.slave.step

    def feed(self) -> None:
        """Give the slave its inputs."""
        if self.pull is not None:
            self.pull()
        if self.put is not None:
            self.put()


class Master:
    """Steps slaves and records every exchanged value.

    Args:
        slaves: In the order of stepping.
        outputs: Scalar outputs to read of each slave, by its name.
        connections: Which output feeds which input.
        external: Inputs that the caller gives at each tick.
        step_size: Communication step [s].
        coupling: "gauss-seidel" or "jacobi".

    Attributes:
        columns: Instance and variable of each column of a row: external inputs, then the
            outputs, in the order that they are given in.

    Raises:
        InputError: A connection comes from or leads to nowhere, or two feed one input.
    """

    def __init__(  # noqa: PLR0913 - a coupled system has this many parts
        self,
        slaves: Sequence[Slave],
        outputs: Mapping[str, Sequence[str]],
        connections: Sequence[Connection],
        external: Sequence[Name] = (),
        step_size: float = 0.001,
        coupling: Coupling = "gauss-seidel",
    ) -> None:
        if coupling not in COUPLINGS:
            raise InputError(f"coupling: {coupling!r}; valid: {', '.join(COUPLINGS)}")
        self.step_size = step_size
        self.coupling = coupling
        self.columns: list[Name] = list(external)
        for instance, names in outputs.items():
            self.columns += [(instance, name) for name in names]
        self._index = {name: i for i, name in enumerate(self.columns)}
        self._row = np.zeros(len(self.columns))
        self._zeros = np.zeros_like(self._row)
        self._external = self._row[: len(external)]
        sources = _sources(connections, external, self._index, {s.name for s in slaves})
        self._ports = [
            self._bind(slave, outputs.get(slave.name, ()), sources.get(slave.name, {}))
            for slave in slaves
        ]
        self._leaders, self._followers = self._split(sources)
        self.stop_requested = False

    def _bind(self, slave: Slave, outputs: Sequence[str], inputs: Mapping[str, int]) -> _Ports:
        get = pull = put = None
        if outputs:
            first = self._index[(slave.name, outputs[0])]
            get = slave.bind_get(outputs, self._row[first : first + len(outputs)])
        if inputs:
            where = np.array(list(inputs.values()))
            if (np.diff(where) == 1).all():
                buffer = self._row[where[0] : where[-1] + 1]
            else:
                buffer = np.zeros(len(where))
                row, target = self._row, buffer

                def pull() -> None:
                    row.take(where, out=target, mode="clip")

            put = slave.bind_set(list(inputs), buffer)
        return _Ports(slave, pull, put, get)

    def _split(self, sources: Mapping[str, Mapping[str, int]]) -> tuple[list[_Ports], list[_Ports]]:
        """Tell slaves that feed a later one from those that do not."""
        leaders: list[_Ports] = []
        followers: list[_Ports] = []
        for i, ports in enumerate(self._ports):
            later = [p.slave.name for p in self._ports[i + 1 :]]
            feeds = any(
                self.columns[column][0] == ports.slave.name
                for name in later
                for column in sources.get(name, {}).values()
            )
            (leaders if feeds and self.coupling == "gauss-seidel" else followers).append(ports)
        return leaders, followers

    def run(
        self,
        steps: int,
        external: Array,
        sink: Callable[[Array], None],
        *,
        realtime: float = 0.0,
        progress: Callable[[int], None] | None = None,
    ) -> Report:
        """Step from t_0 to the end, or until `stop_requested` is set.

        Args:
            steps: Number of communication steps.
            external: External inputs at each instant (steps + 1, number of external).
            sink: Is given rows (n, columns + 1), first column the time [s], at least every
                half second; the array is reused.
            realtime: Speed relative to the wall clock; 0: as fast as it goes.
            progress: Is told the number of completed steps, a few times a second.

        Returns:
            How it went. Rows of all completed steps have been given to the sink, also if
            an exception is raised.

        Raises:
            SimulationError: A slave fails, or a value is not finite.
        """
        block = _Block(len(self.columns) + 1, sink)
        report = Report()
        pace = _Pace(self.step_size / realtime, report) if realtime > 0 else None
        started = clock.perf_counter()
        try:
            self._run(steps, external, block, report, pace, progress)
        finally:
            report.wall_time = clock.perf_counter() - started
            block.flush()
        return report

    def _run(  # noqa: PLR0913 - the loop and what it tells
        self,
        steps: int,
        external: Array,
        block: _Block,
        report: Report,
        pace: _Pace | None,
        progress: Callable[[int], None] | None,
    ) -> None:
        row, zeros, given = self._row, self._zeros, self._external
        leaders, followers, h = self._leaders, self._followers, self.step_size
        time, k = 0.0, 0
        try:
            for ports in self._ports:
                if ports.get is not None:
                    ports.get()
            for k in range(steps):
                if self.stop_requested:
                    return
                time = k * h
                given[:] = external[k]
                for ports in leaders:
                    ports.feed()
                    ports.step(time, h)
                    if ports.get is not None:
                        ports.get()
                if not math.isfinite(row.dot(zeros)):
                    self._not_finite(time)
                block.append(time, row)
                for ports in followers:
                    ports.feed()
                for ports in followers:
                    ports.step(time, h)
                for ports in followers:
                    if ports.get is not None:
                        ports.get()
                report.steps = k + 1
                if pace is not None:
                    pace.wait(k + 1)
                if k % CLOCK_INTERVAL == 0 and block.flush_if_due() and progress is not None:
                    progress(k + 1)
            time = steps * h
            given[:] = external[steps]
            if not math.isfinite(row.dot(zeros)):
                self._not_finite(time)
            block.append(time, row)
        except SimulationError as error:
            self._explain(error, time)
        if progress is not None:
            progress(report.steps)

    def _not_finite(self, time: float) -> None:
        column = int(np.flatnonzero(~np.isfinite(self._row))[0])
        instance, variable = self.columns[column]
        raise SimulationError(
            f"value {self._row[column]} is not finite",
            time=time,
            instance=instance,
            variable=variable,
        )

    def _explain(self, error: SimulationError, time: float) -> None:
        """Raise the error again; a value that is not finite is named first."""
        if not error.variable and not np.isfinite(self._row).all():
            self._not_finite(time)
        if error.time is None:
            message = str(error)
            raise SimulationError(f"at t = {time:.3f} s: {message}") from error
        raise error


class _Block:
    """Rows on their way to the sink."""

    def __init__(self, width: int, sink: Callable[[Array], None], rows: int = 1024) -> None:
        self._rows = np.empty((rows, width))
        self._sink = sink
        self._count = 0
        self._flushed = clock.perf_counter()

    def append(self, time: float, row: Array) -> None:
        """Add one row."""
        if self._count == len(self._rows):
            self.flush()
        target = self._rows[self._count]
        target[0] = time
        target[1:] = row
        self._count += 1

    def flush_if_due(self) -> bool:
        """Flush after half a second; tell whether a fifth of one has passed."""
        if clock.perf_counter() - self._flushed >= FLUSH_INTERVAL:
            self.flush()
            return True
        return False

    def flush(self) -> None:
        """Give the rows to the sink."""
        if self._count:
            count, self._count = self._count, 0
            self._sink(self._rows[:count])
        self._flushed = clock.perf_counter()


class _Pace:
    """Keeps in step with the wall clock."""

    def __init__(self, period: float, report: Report) -> None:
        self._period = period
        self._report = report
        self._start = clock.perf_counter()

    def wait(self, ticks: int) -> None:
        """Sleep until the tick is due, or count an overrun."""
        ahead = self._start + ticks * self._period - clock.perf_counter()
        if ahead > 0:
            clock.sleep(ahead)
        else:
            self._report.overruns += 1
            self._report.worst_lateness = max(self._report.worst_lateness, -ahead)


def _sources(
    connections: Sequence[Connection],
    external: Sequence[Name],
    index: Mapping[Name, int],
    names: set[str],
) -> dict[str, dict[str, int]]:
    """Column that feeds each input, by instance and variable, in the order of the columns."""
    feeds: dict[str, dict[str, int]] = {name: {} for name in names}
    pairs: list[tuple[Name, Name]] = [(name, name) for name in external]
    pairs += [(c.source, c.target) for c in connections]
    for source, target in pairs:
        if source not in index:
            raise InputError(f"connection from {'.'.join(source)}: no such output")
        if target[0] not in feeds:
            raise InputError(f"connection to {'.'.join(target)}: no such instance")
        if target[1] in feeds[target[0]]:
            raise InputError(f"connection to {'.'.join(target)}: the input is fed twice")
        feeds[target[0]][target[1]] = index[source]
    return {
        name: dict(sorted(inputs.items(), key=lambda item: item[1]))
        for name, inputs in feeds.items()
    }


__all__ = ["COUPLINGS", "CosimError", "Coupling", "Master", "Report", "Slave"]
