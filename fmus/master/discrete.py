"""Outputs that are not Real: read into a row of the recording as float64."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

if TYPE_CHECKING:
    from .fmu import FmuSlave

Array = NDArray[np.float64]
# C type of an FMI getter's values, by the type in the getter's name. FMI 2.0's Boolean is an int.
FMI2_GETTERS: Final[dict[str, tuple[str, DTypeLike]]] = {
    "Integer": ("Integer", np.int32),
    "Enumeration": ("Integer", np.int32),
    "Boolean": ("Boolean", np.int32),
}
FMI3_GETTERS: Final[dict[str, tuple[str, DTypeLike]]] = {
    "Enumeration": ("Int64", np.int64),
    "Boolean": ("Boolean", np.bool_),
    "Float32": ("Float32", np.float32),
    **{f"Int{bits}": (f"Int{bits}", f"i{bits // 8}") for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": (f"UInt{bits}", f"u{bits // 8}") for bits in (8, 16, 32, 64)},
}


def bind_get_by_type(slave: FmuSlave, names: Sequence[str], block: Array) -> Callable[[int], None]:
    """Make a function that reads variables of several types into a row of a block.

    Args:
        slave: The instance to read from.
        names: Scalar variables.
        block: Where their values go (n, len(names)).
    """
    reads = []
    first = 0
    for kind, group in groupby(names, lambda name: slave.fmu.variable(name).fmi_type):
        part = list(group)
        columns = block[:, first : first + len(part)]
        first += len(part)
        reads.append(_bind_get_of_type(slave, kind, part, columns))
    if len(reads) == 1:
        return reads[0]

    def read(row: int) -> None:
        for each in reads:
            each(row)

    return read


def _bind_get_of_type(
    slave: FmuSlave, kind: str, names: Sequence[str], block: Array
) -> Callable[[int], None]:
    if slave.fmu.variable(names[0]).type == "Real":
        return slave.bind_get(names, block)
    read = slave.bind_get_discrete(kind, names)

    def convert(row: int) -> None:
        block[row] = read()

    return convert
