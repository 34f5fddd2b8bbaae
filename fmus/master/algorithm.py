"""The master: steps slaves side by side at one communication step, and exchanges values.

It knows no FMI, only the `Slave` protocol, so that its algorithm is tested with fakes. The
contract of one run, in order:

1. each slave has been initialized; all outputs are read: they belong to t_0.
2. For each tick k, at t_k = t_0 + k * step_size:
   Gauss-Seidel: the external inputs of t_k are taken. Each leader (a slave that feeds a later
   one) is set, stepped and read: what it answers acts at once. The row of t_k is recorded.
   The followers are set, stepped and read: their outputs belong to t_k+1.
   Jacobi: the external inputs of t_k are taken, the row of t_k is recorded; all slaves are
   set, then all stepped, then all read. What a slave answers acts one tick later.
3. A last row is recorded at the end, with the external inputs of that instant.

Slaves write their outputs straight into the row of the recording that they belong to, and read
their inputs from there; only inputs that do not stand side by side in a row are gathered first.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ..errors import CosimError, InputError, SimulationError
from ..interface.tables import Connection
from .realtime import RealtimePacer, Report
from .row_buffer import BLOCK_ROWS, ExternalInputs, RowBuffer
from .wiring import Exchange, Name, Slave, bind_inputs, find_sources

Array = NDArray[np.float64]
Coupling = Literal["gauss-seidel", "jacobi"]
COUPLINGS: tuple[Coupling, ...] = ("gauss-seidel", "jacobi")
# [s] wall time that complete rows wait here at most; with what the recorder keeps back, a kill
# costs half a second.
FLUSH_INTERVAL = 0.1


class _Ports(NamedTuple):
    """One slave, and what a tick does to it; put and get take the index of a row."""

    name: str
    put: Exchange
    step: Callable[[float, float], None]
    get: Exchange


class Master:
    """Steps slaves and records every exchanged value.

    Args:
        slaves: In the order of stepping.
        outputs: Scalar outputs to read of each slave, by its name.
        connections: Which output feeds which input.
        external: Inputs that the caller gives at each tick.
        step_size: Communication step [s].
        coupling: "gauss-seidel" or "jacobi".
        start: Start time t_0 [s].
        late_check: Look for values that are not finite in many rows at a time, which costs less;
            for slaves that refuse such inputs themselves. Else no slave is ever given one.

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
        step_size: float = STEP_SIZE,
        coupling: Coupling = "gauss-seidel",
        *,
        start: float = 0.0,
        late_check: bool = False,
    ) -> None:
        if coupling not in COUPLINGS:
            raise InputError(f"coupling: {coupling!r}; valid: {', '.join(COUPLINGS)}")
        self.step_size, self.start = step_size, start
        self.coupling = coupling
        self._late_check = late_check
        self.columns: list[Name] = list(external)
        for instance, names in outputs.items():
            self.columns += [(instance, name) for name in names]
        self._index = {name: i for i, name in enumerate(self.columns, start=1)}
        self._buffer = RowBuffer(len(self.columns) - len(external), len(external))
        sources = find_sources(connections, external, self._index, {s.name for s in slaves})
        self._ports = [
            self._bind(slave, outputs.get(slave.name, ()), sources.get(slave.name, {}))
            for slave in slaves
        ]
        self._leaders, self._followers = self._split(sources)
        self._buffer.held = self._columns_of(self._leaders)
        self._delayed = self._columns_of(self._feeding_back(sources))
        self.stop_requested = False
        self._report = Report()
        self._due = 0.0  # when rows are given away next, by the performance counter [s]

    def _bind(self, slave: Slave, outputs: Sequence[str], inputs: Mapping[str, int]) -> _Ports:
        rows = self._buffer.rows
        get: Exchange = _nothing
        put: Exchange = _nothing
        if outputs:
            first = self._index[(slave.name, outputs[0])]
            get = slave.bind_get(outputs, rows[:, first : first + len(outputs)])
        if inputs:
            put = bind_inputs(slave, inputs, rows)
        return _Ports(slave.name, put, slave.step, get)

    def _split(self, sources: Mapping[str, Mapping[str, int]]) -> tuple[list[_Ports], list[_Ports]]:
        """Tell slaves that feed a later one from those that do not."""
        leaders: list[_Ports] = []
        followers: list[_Ports] = []
        for i, ports in enumerate(self._ports):
            later = {p.name for p in self._ports[i + 1 :]}
            leads = self.coupling == "gauss-seidel" and later & self._fed_by(ports, sources)
            (leaders if leads else followers).append(ports)
        return leaders, followers

    def _feeding_back(self, sources: Mapping[str, Mapping[str, int]]) -> list[_Ports]:
        """Leaders that feed themselves or an earlier leader, which gets what is a tick old."""
        return [
            ports
            for i, ports in enumerate(self._leaders)
            if {p.name for p in self._leaders[: i + 1]} & self._fed_by(ports, sources)
        ]

    def _fed_by(self, ports: _Ports, sources: Mapping[str, Mapping[str, int]]) -> set[str]:
        """Names of the slaves that a slave feeds."""
        columns = set(self._columns_of([ports]))
        return {name for name, inputs in sources.items() if columns & set(inputs.values())}

    def _columns_of(self, several: Sequence[_Ports]) -> list[int]:
        """Columns that slaves write."""
        names = {ports.name for ports in several}
        given = self._buffer.external
        return [i for i, (name, _) in enumerate(self.columns, 1) if i > given and name in names]

    def run(
        self,
        steps: int,
        external: ExternalInputs,
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
                tenth of a second; the array is reused.
            realtime: Speed relative to the wall clock; 0: as fast as it goes.
            progress: Is told the number of completed steps, a few times a second.

        Returns:
            How it went. Rows of all completed steps have been given to the sink, also if
            an exception is raised, but for the first that is not finite and what follows it.

        Raises:
            SimulationError: A slave fails, or a value is not finite.
        """
        buffer, self._report = self._buffer, Report()
        report = self._report
        if external.shape != (steps + 1, buffer.external):
            raise ValueError(
                f"external: shape {external.shape}; must be {(steps + 1, buffer.external)}"
            )
        started = clock.perf_counter()
        pacer = RealtimePacer(self.step_size / realtime, report) if realtime > 0 else None
        buffer.begin(sink, external, self.start, self.step_size)
        try:
            self._run(steps, report, pacer, progress)
        except SimulationError as error:
            explained = self._explained(error, report)
            if explained is error:
                raise
            raise explained from error
        finally:
            report.wall_time = clock.perf_counter() - started
            buffer.flush()
        return report

    @property
    def time(self) -> float:
        """Time of the step under way, or at the end [s]."""
        return self.start + self._report.steps * self.step_size

    def save(self) -> None:
        """Give all complete rows to the sink at once, in the middle of a run.

        Raises:
            SimulationError: A value is not finite.
        """
        self._give()

    def _run(
        self,
        steps: int,
        report: Report,
        pacer: RealtimePacer | None,
        progress: Callable[[int], None] | None,
    ) -> None:
        buffer, t_0, h = self._buffer, self.start, self.step_size
        rows, at_once = buffer.rows, not self._late_check
        leaders = [(ports.put, ports.step, ports.get) for ports in self._leaders]
        puts = [ports.put for ports in self._followers]
        follow = [ports.step for ports in self._followers]
        gets = [ports.get for ports in self._followers]
        delayed, now, self._due = self._delayed, clock.perf_counter, 0.0
        for ports in self._ports:
            ports.get(0)
        for k in range(steps):
            if self.stop_requested:
                self._give()
                return
            time, i = t_0 + k * h, k - buffer.first
            for put, step, get in leaders:
                put(i)
                step(time, h)
                get(i)
            if at_once and not np.isfinite(rows[i]).all():
                raise self._not_finite(i)
            buffer.filled = i + 1
            for put in puts:
                put(i)
            for step in follow:
                step(time, h)
            for get in gets:
                get(i + 1)
            if delayed:
                rows[i + 1, delayed] = rows[i, delayed]
            report.steps = k + 1
            if i + 1 == BLOCK_ROWS:
                self._give()
                buffer.turn()
            if pacer is not None or now() >= self._due:  # at each tick, since one may be slow
                self._look_around(k + 1, pacer, progress)
        self._end(steps - buffer.first)
        if progress is not None:
            progress(steps)

    def _look_around(
        self, done: int, pacer: RealtimePacer | None, progress: Callable[[int], None] | None
    ) -> None:
        """Keep pace; now and then give away what is done, and tell of it."""
        if pacer is not None:
            pacer.wait(done)
        if clock.perf_counter() >= self._due:
            self._give()
            if progress is not None:
                progress(done)
            self._due = clock.perf_counter() + FLUSH_INTERVAL

    def _give(self) -> None:
        """Give the complete rows away; they are looked at together, which costs a step little."""
        non_finite = self._buffer.flush()
        if non_finite is not None:
            raise self._not_finite(non_finite)

    def _end(self, row: int) -> None:
        """Record the last row: what leaders answered last is held."""
        if row > 0:  # else `turn` has done so
            self._buffer.hold(row)
        self._buffer.filled = row + 1
        self._give()

    def _not_finite(self, row: int) -> SimulationError:
        values = self._buffer.rows[row]
        column = int(np.flatnonzero(~np.isfinite(values))[0])
        instance, variable = self.columns[column - 1]
        return SimulationError(
            f"value {values[column]} is not finite",
            time=float(values[0]),
            instance=instance,
            variable=variable,
        )

    def _explained(self, error: SimulationError, report: Report) -> SimulationError:
        """Complete an error; a value that is not finite is named first, as the cause."""
        buffer = self._buffer
        row = report.steps - buffer.first
        non_finite = buffer.find_non_finite(row + 1)
        if non_finite is not None:
            report.steps = min(report.steps, buffer.first + non_finite)
            if error.instance and not error.variable:  # not one of the sink's
                return self._not_finite(non_finite)
        if error.time is None:
            return SimulationError(
                error.message,
                time=float(buffer.rows[row][0]),
                instance=error.instance,
                variable=error.variable,
            )
        return error


def _nothing(_row: int, /) -> None:
    """Do nothing: a slave without inputs, or without outputs."""


__all__ = [
    "COUPLINGS",
    "CosimError",
    "Coupling",
    "Exchange",
    "Master",
    "Name",
    "Report",
    "Slave",
]
