"""The values of each row, which depend only on the definition and the row's index."""

from __future__ import annotations

import csv
import io
import itertools
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from ...fmus.errors import InputError
from ...fmus.interface.parameters import ParameterValue, literal
from ..files import read_text
from ..running.settings import with_values
from ..running.start import start_values
from .definition import MAX_SAMPLES, Loaded, Sweep
from .distribution import Distribution

Array = NDArray[np.float64]
Values = dict[str, ParameterValue]
_MAX_BYTES = 1 << 30  # of a list
_EDGE = 1e-12  # keeps probabilities off 0 and 1, where the normal quantile is infinite


@dataclass(frozen=True, eq=False)
class Design:
    """The values of all rows.

    Attributes:
        columns: Values by key, each (count,): an array of numbers, or a list.
        count: Rows of one scenario.
        scenarios: Number of scenarios, one after the other.
    """

    columns: Mapping[str, Array | Sequence[Any]]
    count: int
    scenarios: int = 1

    def __len__(self) -> int:
        """Return the number of rows of all scenarios."""
        return self.count * self.scenarios

    def values(self, index: int) -> Values:
        """Return the values of a row by key, as plain numbers, switches or text."""
        return {key: _plain(column[index % self.count]) for key, column in self.columns.items()}

    def scenario(self, index: int) -> int:
        """Return which scenario a row belongs to."""
        return index // self.count


def _plain(value: Any) -> ParameterValue:
    return value if isinstance(value, bool | str) else float(value)


def make_design(sweep: Sweep) -> Design:
    """Return the values of all rows of a sweep that is not a search.

    Raises:
        InputError: The list cannot be used, or a grid is too large.
    """
    columns: Mapping[str, Array | Sequence[Any]]
    if sweep.design == "list":
        assert sweep.file is not None  # Sweep has checked it
        columns = _read_list(sweep.file)
    elif sweep.design == "grid":
        columns = _grid(sweep.vary)
    else:
        u = _probabilities(sweep)
        columns = {
            key: distribution.quantiles(u[:, i])
            for i, (key, distribution) in enumerate(sweep.vary.items())
        }
    count = len(next(iter(columns.values())))
    return Design(columns, count, len(sweep.scenario))


def _probabilities(sweep: Sweep) -> Array:
    """Draw points in the unit cube (n, keys)."""
    rng, dimensions = np.random.default_rng(sweep.seed), len(sweep.vary)
    if sweep.design == "random":
        u = rng.random((sweep.samples, dimensions))
    elif sweep.design == "latin-hypercube":
        u = qmc.LatinHypercube(dimensions, rng=rng).random(sweep.samples)
    else:
        u = _sobol(dimensions, sweep.samples, rng)
    return np.clip(u, _EDGE, 1.0 - _EDGE)


def _sobol(dimensions: int, samples: int, rng: np.random.Generator) -> Array:
    if dimensions > qmc.Sobol.MAXDIM:
        raise InputError(f"vary: {dimensions} keys; must be at most {qmc.Sobol.MAXDIM}")
    with warnings.catch_warnings():  # any number is allowed; a power of 2 covers the cube best
        warnings.simplefilter("ignore", UserWarning)
        drawn: Array = qmc.Sobol(dimensions, scramble=True, rng=rng).random(samples)
    return drawn


def _grid(vary: Mapping[str, Distribution]) -> dict[str, Sequence[Any]]:
    axes = [distribution.grid() for distribution in vary.values()]
    if (size := int(np.prod([float(len(axis)) for axis in axes]))) > MAX_SAMPLES:
        raise InputError(f"the grid has {size} points; must be at most {MAX_SAMPLES}")
    points = zip(*itertools.product(*axes), strict=True)
    return dict(zip(vary, points, strict=True))


def _read_list(path: Path) -> dict[str, Sequence[Any]]:
    """Read a CSV with the keys in its header."""
    (first, header), *rows = _read_csv(path)
    if len(set(header)) != len(header) or not all(header):
        raise InputError(f"{path}: line {first}: names must differ and not be blank")
    if not rows:
        raise InputError(f"{path}: has no rows; must have at least one below the names")
    for line, row in rows:
        if len(row) != len(header) or not all(row):
            raise InputError(f"{path}: line {line}: must be {len(header)} values")
    columns = zip(*(map(literal, row) for _, row in rows), strict=True)
    return dict(zip(header, columns, strict=True))


def _read_csv(path: Path) -> list[tuple[int, list[str]]]:
    """Return the number and the cells of each line that is not blank."""
    reader = csv.reader(io.StringIO(read_text(path, _MAX_BYTES), newline=""))
    try:
        return [(reader.line_num, [cell.strip() for cell in row]) for row in reader if row]
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: {error}") from None


def check_design(design: Design, scenarios: Sequence[Loaded]) -> None:
    """Check that each key exists and takes the values drawn for it, each key by itself.

    Raises:
        InputError: One does not; the message names the key, the value and the bound.
    """
    for loaded in scenarios:
        for key, column in design.columns.items():
            for value in _extremes(column):
                try:
                    start_values(with_values(loaded.scenario, {key: value}))
                except InputError as error:
                    name = loaded.scenario.name
                    raise InputError(f"vary: scenario {name}: {error}") from None


def _extremes(column: Array | Sequence[Any]) -> list[ParameterValue]:
    if all(isinstance(value, str | bool) for value in column):
        return list(dict.fromkeys(column))
    if any(isinstance(value, str | bool) for value in column):
        raise InputError("vary: values of a key must be all numbers, all switches or all text")
    return [float(min(column)), float(max(column))]
