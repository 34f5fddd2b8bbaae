"""The slave protocol, and the source of each input."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
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


def bind_inputs(slave: Slave, inputs: Mapping[str, int], rows: Array) -> Exchange:
    """Make a function that sets inputs from a row; without a copy if they are consecutive there."""
    names = sorted(inputs, key=inputs.__getitem__)
    columns = [inputs[name] for name in names]
    first, last = columns[0], columns[-1]
    if columns == list(range(first, last + 1)):
        return slave.bind_set(names, rows[:, first : last + 1])
    # In the order of the connections, which is probably that of the inputs in the slave.
    where = np.array(list(inputs.values()))
    values = np.zeros((1, len(inputs)))
    put, target = slave.bind_set(list(inputs), values), values[0].data.cast("B")
    runs = np.split(where, np.flatnonzero(np.diff(where) != 1) + 1)
    parts = [[row[run[0] : run[-1] + 1].data for run in runs] for row in rows]

    def gather(row: int) -> None:
        target[:] = b"".join(parts[row])
        put(0)

    return gather


def find_sources(
    connections: Sequence[Connection],
    external: Sequence[Name],
    index: Mapping[Name, int],
    names: set[str],
) -> dict[str, dict[str, int]]:
    """Column that feeds each input, by instance and variable, in the order of the connections."""
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
    return feeds
