"""The slave protocol, the source of each input, and slaves bound to the rows of the recording."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..interface.tables import Connection

Array = NDArray[np.float64]
Exchange = Callable[[int], None]  # of one row, by its index
Name = tuple[str, str]  # instance and scalar variable


class Slave(Protocol):
    """The methods that the master calls."""

    name: str

    def bind_get(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that reads variables into a row of a block (n, len(names))."""

    def bind_set(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that writes variables from a row of a block (n, len(names))."""

    def step(self, time: float, step_size: float) -> None:
        """Advance from `time` by `step_size` [s]."""


class BoundSlave:
    """A slave, bound to the rows (n, columns) that it reads and writes.

    `inputs` has the column that feeds each input, `outputs` that of each output; these are
    consecutive.
    """

    def __init__(
        self, slave: Slave, inputs: Mapping[str, int], outputs: Mapping[str, int], rows: Array
    ) -> None:
        self.inputs, self.outputs = set(inputs.values()), list(outputs.values())
        self.step = slave.step
        self.set_inputs: Exchange = nothing
        self.get_outputs: Exchange = nothing
        if outputs:
            block = rows[:, self.outputs[0] : self.outputs[-1] + 1]
            self.get_outputs = slave.bind_get(list(outputs), block)
        if inputs:
            self.set_inputs = _bind_inputs(slave, inputs, rows)

    def feeds(self, other: BoundSlave) -> bool:
        """Whether an output of this slave is an input of another."""
        return not other.inputs.isdisjoint(self.outputs)


def bind(
    slaves: Sequence[Slave],
    columns: Sequence[Name],
    external: Sequence[Name],
    connections: Sequence[Connection],
    rows: Array,
) -> list[BoundSlave]:
    """Bind slaves to the rows of a recording."""
    index = {name: i for i, name in enumerate(columns, start=1)}
    sources = _find_sources(connections, external, index)
    outputs: dict[str, dict[str, int]] = defaultdict(dict)
    for instance, variable in columns[len(external) :]:
        outputs[instance][variable] = index[(instance, variable)]
    return [BoundSlave(s, sources[s.name], outputs[s.name], rows) for s in slaves]


def nothing(_row: int, /) -> None:
    """Do nothing: a slave without inputs, or without outputs."""


def _bind_inputs(slave: Slave, inputs: Mapping[str, int], rows: Array) -> Exchange:
    """Make a function that sets inputs from a row; without a copy if they are consecutive there."""
    names = sorted(inputs, key=inputs.__getitem__)
    columns = [inputs[name] for name in names]
    first, last = columns[0], columns[-1]
    if columns == list(range(first, last + 1)):
        return slave.bind_set(names, rows[:, first : last + 1])
    # In the order of the connections, which is probably that of the inputs in the slave.
    values = np.zeros((1, len(inputs)))
    return Gather(slave.bind_set(list(inputs), values), list(inputs.values()), rows, values)


class Gather:
    """Sets inputs from columns of a row that are not beside each other."""

    def __init__(self, put: Exchange, columns: Sequence[int], rows: Array, values: Array) -> None:
        self.put, self.columns = put, np.array(columns)
        self._rows, self._values = rows, values

    def __call__(self, row: int) -> None:
        """Set the inputs from a row."""
        self._rows[row].take(self.columns, out=self._values[0], mode="clip")
        self.put(0)


def _find_sources(
    connections: Sequence[Connection],
    external: Sequence[Name],
    index: Mapping[Name, int],
) -> dict[str, dict[str, int]]:
    """Column that feeds each input, by instance and variable, in the order of the connections."""
    feeds: dict[str, dict[str, int]] = defaultdict(dict)
    for name in external:
        feeds[name[0]][name[1]] = index[name]
    for connection in connections:
        instance, variable = connection.target
        feeds[instance][variable] = index[connection.source]
    return feeds
