"""The signals of criteria: recorded ones, their norms and differences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.messages import did_you_mean, excerpt
from ..definition.criteria import SignalCriterion
from ..recording import Recording
from ..recording.reader import shapes_of

Array = NDArray[np.float64]


def check_signals(criteria: Iterable[SignalCriterion], units: Mapping[str, str]) -> None:
    """Check that each criterion's signals are recorded, and match in shape and unit.

    Args:
        criteria: The scenario's, in the file's order.
        units: Unit of each recorded column.

    Raises:
        InputError: A signal is unknown, or operands differ in shape or unit.
    """
    shapes = shapes_of(tuple(units))
    for index, criterion in enumerate(criteria, 1):
        try:
            unit_of(criterion, shapes, units)
        except ValueError as error:
            raise InputError(f"[[success.signal]] {index}: signal: {error}") from None


def unit_of(
    criterion: SignalCriterion, shapes: Mapping[str, tuple[int, ...]], units: Mapping[str, str]
) -> str:
    """Return the unit of a criterion's signal.

    Raises:
        ValueError: There is no such signal, or its operands do not match.
    """
    columns = [_columns(name, shapes, units) for name in criterion.names]
    found = {units[column] for parts in columns for column in parts}
    if len({len(parts) for parts in columns}) > 1:
        sizes = " and ".join(
            f"{n} has {len(p)}" for n, p in zip(criterion.names, columns, strict=True)
        )
        raise ValueError(f"{sizes} elements; must have the same number")
    if len(found) > 1:
        shown = ", ".join(sorted(found))
        raise ValueError(f"{' and '.join(criterion.names)}: units {shown}; must have the same unit")
    return found.pop()


def _columns(
    name: str, shapes: Mapping[str, tuple[int, ...]], units: Mapping[str, str]
) -> list[str]:
    if name in units:
        return [name]
    if name not in shapes:
        hint = did_you_mean(name, (*shapes, *units))
        raise ValueError(
            f"value {excerpt(name)} is not recorded; must be a recorded signal{hint} (`panda-cosim "
            "info` lists them)"
        )
    return [c for c in units if c.startswith(f"{name}[")]


def evaluate(criterion: SignalCriterion, recording: Recording) -> Array:
    """Return a criterion's signal (n, k), with one column per element."""
    parts = [recording[name].reshape(recording.rows, -1) for name in criterion.names]
    values: Array = parts[0] if len(parts) == 1 else parts[0] - parts[1]
    if not isinstance(criterion.signal, str) and criterion.signal[0] == "norm":
        values = np.linalg.norm(values, axis=1, keepdims=True)
    return values


__all__ = ["check_signals", "evaluate", "unit_of"]
