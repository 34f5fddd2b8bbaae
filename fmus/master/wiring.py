"""Systems, the slave protocol, and slaves bound to the rows of the recording, kept here."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import SimulationError
from ..interface.units import PLAIN

if TYPE_CHECKING:
    from ..interface.tables import Connection  # an isolated FMU's process needs no tables

Array = NDArray[np.float64]
Exchange = Callable[[int], None]  # of one row, by its index
Name = tuple[str, str]  # instance and scalar variable
Feed = tuple[int, tuple[float, float]]  # column of a value; factor and offset on its way
ROUNDING: Final = 1e-9  # relative, of a time


@dataclass(frozen=True)
class System:
    """The FMUs of a system, and their connections."""

    fmus: Mapping[str, Path]  # by instance, in the order of stepping
    connections: Sequence[Connection]
    external: Sequence[Name] = ()  # external inputs, set at each tick
    outputs: Mapping[str, Sequence[str]] = field(default_factory=dict)  # to read, by instance
    steps: Mapping[str, int] = field(default_factory=dict)  # of FMUs, in the system's
    not_finite: Sequence[Name] = ()  # outputs that may be NaN or infinite
    labels: Mapping[str, str] = field(default_factory=dict)  # what messages call files, not paths

    @property
    def read(self) -> list[Name]:
        """All outputs to read."""
        return [(instance, name) for instance, names in self.outputs.items() for name in names]


class Slave(Protocol):
    """The methods that the master calls."""

    name: str
    stop: float  # [s] up to which it can be stepped
    spent: defaultdict[str, float]  # [s] wall time by name of a call

    def bind_get(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that reads variables into a row of a block (n, len(names))."""

    def bind_set(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that writes variables from a row of a block (n, len(names))."""

    def step(self, time: float, step_size: float) -> None:
        """Advance from `time` by `step_size` [s]."""

    def save_state(self, place: int = 0) -> None:
        """Keep the present state in a place; 0 is that of iterated coupling."""

    def restore_state(self, place: int = 0) -> None:
        """Go back to the state that was kept there."""


class BoundSlave:
    """A slave, bound to the rows (n, columns) that it reads and writes.

    `fed` has, by input, the column that feeds it, with factor and offset; `outputs` are columns by
    variable, which are consecutive. If an input is not fed as it is, `linear` has factor and offset
    of all, as arrays that may be changed.
    """

    def __init__(
        self, slave: Slave, fed: Mapping[str, Feed], outputs: Mapping[str, int], rows: Array
    ) -> None:
        self.slave = slave
        self.inputs, self.outputs = {column for column, _ in fed.values()}, list(outputs.values())
        self.names = list(outputs)
        self.step = slave.step
        self.set_inputs: Exchange = nothing
        self.get_outputs: Exchange = nothing
        self.linear: Mapping[str, Array] = {}
        if outputs:
            block = rows[:, self.outputs[0] : self.outputs[-1] + 1]
            self.get_outputs = slave.bind_get(list(outputs), block)
        if fed:
            # In the order of the connections, which is probably that of the inputs in the slave.
            values = np.zeros((1, len(fed)), rows.dtype)
            put = slave.bind_set(list(fed), values)
            columns, linear = zip(*fed.values(), strict=True)
            self.set_inputs = moved = Moved(put, values, range(len(fed)), rows, columns)
            if {*linear} != {PLAIN}:
                self.linear = dict(zip(fed, moved.convert(linear), strict=True))

    def feeds(self, other: BoundSlave) -> bool:
        """Whether an output of this slave is an input of another."""
        return not other.inputs.isdisjoint(self.outputs)


class SlowSlave:
    """A slave that is stepped once in some ticks: a leader in the first, others in the last."""

    def __init__(self, slave: Slave, multiple: int) -> None:
        self.slave, self.name, self.stop, self.spent = slave, slave.name, slave.stop, slave.spent
        self.leads = False  # its outputs act within the step, see step.py
        self._multiple = multiple
        self._tick = 0  # of the present step
        self._begin, self._is_taken = 0.0, False  # where it begins [s], and whether it was taken
        self._saved: dict[int, tuple[int, float, bool]] = {}

    def bind_set(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that sets the inputs in the first tick."""
        put = self.slave.bind_set(names, block)
        return lambda row: None if self._tick else put(row)

    def bind_get(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that reads the outputs, which are held between two steps."""
        get = self.slave.bind_get(names, block)

        def exchange(row: int) -> None:
            if self._tick == 0 or self.leads:
                get(row)
            else:
                block[row] = block[row - 1]

        return exchange

    def step(self, time: float, step_size: float) -> None:
        """Take the step in one of the ticks, unless it would end beyond the stop."""
        if self._tick == 0:
            self._begin, self._is_taken = time, False
        size = self._multiple * step_size
        is_due = self.leads or self._tick == self._multiple - 1
        if is_due and not self._is_taken and can_step(self, self._begin, size):
            self.slave.step(self._begin, size)
            self._is_taken = True
        self._tick = (self._tick + 1) % self._multiple

    def save_state(self, place: int = 0) -> None:
        """Keep the present state, and where it is in the step."""
        self.slave.save_state(place)
        self._saved[place] = self._tick, self._begin, self._is_taken

    def restore_state(self, place: int = 0) -> None:
        """Go back to the state that was kept there."""
        self.slave.restore_state(place)
        self._tick, self._begin, self._is_taken = self._saved[place]


def can_step(slave: Slave, time: float, size: float) -> bool:
    """Whether a step does not end beyond the slave's stop; times are rounded."""
    return time + size <= slave.stop + ROUNDING * max(size, abs(slave.stop))


def bind(
    slaves: Sequence[Slave], columns: Sequence[Name], system: System, rows: Array
) -> list[BoundSlave]:
    """Bind slaves to the rows of a recording."""
    index = {name: i for i, name in enumerate(columns, start=1)}
    fed: dict[str, dict[str, Feed]] = defaultdict(dict)  # inputs, in the order of the connections
    for instance, variable in system.external:
        fed[instance][variable] = index[instance, variable], PLAIN
    for each in system.connections:
        instance, variable = each.target
        fed[instance][variable] = index[each.source], (each.factor, each.offset)
    outputs: dict[str, dict[str, int]] = defaultdict(dict)
    for instance, variable in system.read:
        outputs[instance][variable] = index[instance, variable]
    return [BoundSlave(slave, fed[slave.name], outputs[slave.name], rows) for slave in slaves]


def nothing(_row: int, /) -> None:
    """Do nothing: a slave without inputs, or without outputs."""


class Moved:
    """Exchanges columns of rows, in any order, through the one row of values that a call takes."""

    linear: Array | None = None  # factor and offset of each value

    def __init__(  # noqa: PLR0913 - both sides of the move
        self,
        call: Exchange,
        values: Array,
        places: Sequence[int],  # of the values that belong to
        rows: Array,
        columns: Sequence[int],
        *,
        reads: bool = False,
    ) -> None:
        self.call, self.values, self.rows, self._reads = call, values, rows, reads
        self.places, self.columns = np.array(places, np.intp), np.array(columns, np.intp)

    def convert(self, linear: Sequence[tuple[float, float]]) -> Array:
        """Apply a factor and an offset to each value; returns them, which may be changed."""
        self.linear = np.array(linear)
        self._converted = np.flatnonzero((self.linear != PLAIN).any(axis=1))
        return self.linear

    def __call__(self, row: int) -> None:
        """Exchange the values of a row."""
        values = self.values[0]
        if self._reads:
            self.call(0)
            self.rows[row, self.columns] = values[self.places]
            return
        values[self.places] = self.rows[row, self.columns]
        if self.linear is not None:
            factors, offsets = self.linear[self._converted].T
            values[self._converted] = factors * values[self._converted] + offsets
        self.call(0)


class Shared:
    """Exchanges a row of values with an FMU in another process: float64 by memory that both have.

    Other values go with the requests of `RemoteSlave`.
    """

    name = "exchange"

    def __init__(self, slave: Any, memory: Array, *, reads: bool) -> None:
        self.slave, self.memory, self._reads = slave, memory, reads

    def __call__(self, _row: int) -> None:
        """Exchange the values."""
        slave = self.slave
        if not self._reads:
            slave.inputs = [] if self.memory.dtype == np.float64 else self.memory[0].tolist()
            slave.outputs = None
            return
        if slave.outputs is None:
            slave.outputs = slave.call("outputs")
        self.memory[0] = slave.outputs or self.memory[0]

    def for_c(self) -> dict[str, int | None]:
        """Return what the kernel calls: nothing, as values need only be copied."""
        return {}


def together(exchanges: Sequence[Exchange]) -> Exchange:
    """Make one function of several."""
    if len(exchanges) == 1:
        return exchanges[0]

    def exchange(row: int) -> None:
        for each in exchanges:
            each(row)

    return exchange if exchanges else nothing


# The rows.

BLOCK_ROWS = 256  # few enough to stay in the processor's cache


class ExternalInputs(Protocol):
    """External inputs of each tick: an array, or an object that computes rows when sliced."""

    def __getitem__(self, rows: slice, /) -> Array:
        """Return some rows."""


class RowBuffer:
    """`BLOCK_ROWS` rows of the recording, and one more for the outputs of the last tick.

    The master makes one for its run. FMUs write into the rows directly, so that they stay where
    they are in memory, and are used again and again.
    """

    rows: Array  # (BLOCK_ROWS + 1, 1 + external + outputs)

    def __init__(
        self,
        columns: Sequence[Name],
        system: System,
        start: float,
        step_size: float,
        objects: Collection[Name] = (),
    ) -> None:
        dtype = object if objects else np.float64
        self.rows = np.zeros((BLOCK_ROWS + 1, 1 + len(columns)), dtype)
        free = {*objects, *system.not_finite}
        # Columns whose values must be finite.
        self.checked = [0, *(i for i, name in enumerate(columns, 1) if name not in free)]
        self._columns = columns
        self.external = len(system.external)
        self._start, self._step_size = start, step_size
        self._begin_at(0)
        self.set_held([])
        self._ahead: Mapping[int, Sequence[int]] = {}
        self._before = self.rows[:0]

    def set_held(self, columns: Sequence[int]) -> None:
        """Choose the output columns that `hold` copies, besides the external inputs."""
        self._held = np.array([*range(1, 1 + self.external), *columns], np.intp)

    def set_ahead(self, columns: Mapping[int, Sequence[int]], row: int) -> None:
        """Choose output columns, by number of rows, that hold values of so many rows later.

        The sink is given each value in the row of its instant. So far, up to `row`, none is ahead.
        """
        if columns == self._ahead:
            return
        self._ahead = columns
        self._before = np.repeat(self.rows[row : row + 1], max(columns, default=0), axis=0)

    def begin(self, sink: Callable[[Array], None]) -> None:
        """Start a recording; the sink is called with complete rows (n, columns)."""
        self._sink = sink
        self.rows[:], self._ahead = 0.0, {}
        self._begin_at(0)

    def _begin_at(self, tick: int) -> None:
        """Have no complete row, and a tick's row as the first."""
        # Tick of the first row, and numbers of complete rows, and of those that were flushed.
        self.first, self.filled, self._flushed = tick, 0, 0
        ticks = np.arange(tick, tick + len(self.rows))
        self.rows[:, 0] = self._start + ticks * self._step_size

    def set_external(self, row: int, values: Array) -> None:
        """Set the external inputs (n, external) of the rows from `row` on."""
        self.rows[row : row + len(values), 1 : 1 + self.external] = values

    def hold(self, row: int) -> None:
        """Copy the held columns from the row before; the first row has them from `turn`."""
        if row > 0:
            self.rows[row, self._held] = self.rows[row - 1, self._held]

    def turn(self) -> None:
        """Reuse the rows after a flush: the last row becomes the first."""
        self.hold(BLOCK_ROWS)
        self.rows[0] = self.rows[BLOCK_ROWS]
        self._begin_at(self.first + BLOCK_ROWS)

    def go_back(self, tick: int, row: Array) -> None:
        """Make a tick's row the first."""
        self.rows[0] = row
        self._before = np.repeat(self.rows[:1], len(self._before), axis=0)
        self._begin_at(tick)

    def complete(self, row: int) -> None:
        """Mark a row as complete; raises SimulationError if a value is not finite."""
        if error := self.non_finite(row):
            raise error
        self.filled = row + 1

    def flush(self) -> None:
        """Pass complete rows to the sink."""
        if self.filled > self._flushed:
            flushed, self._flushed = self._flushed, self.filled
            self._sink(self._at_their_instants(self.rows[flushed : self.filled]))

    def _at_their_instants(self, rows: Array) -> Array:
        if not self._ahead:
            return rows
        before = len(self._before)
        whole, rows = np.concatenate((self._before, rows)), rows.copy()
        for ahead, columns in self._ahead.items():
            rows[:, columns] = whole[before - ahead : len(whole) - ahead, columns]
        self._before = whole[len(whole) - before :]
        return rows

    def non_finite(self, row: int) -> SimulationError | None:
        """Return the error that names the first value of a row that is not finite, if one is."""
        values = self.rows[row]
        if len(self.checked) < len(values):  # a choice of columns takes time
            values = values[self.checked].astype(np.float64)
        is_finite = np.isfinite(values)
        if is_finite.all():
            return None
        first = int(is_finite.argmin())
        instance, variable = self._columns[self.checked[first] - 1]
        return SimulationError(
            f"value {values[first]} is not finite",
            time=float(self.rows[row, 0]),
            instance=instance,
            variable=variable,
        )
