"""Shows a reference as a run in the view, usually as a ghost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ..definition.scenario import shipped_scenarios
from ..view.export import show_source
from ..view.run import RunData, Shown
from .reference import REFERENCE_FILE, Reference, how_to_make

Array = NDArray[np.float64]

ROUNDED: Final = "The reference is rounded to a tenth of its tolerances."


class ReferenceSource:
    """A reference's compared columns, in the form the view reads.

    Attributes:
        quanta: Rounding step of each column, in its unit.
    """

    def __init__(self, reference: Reference) -> None:
        self._reference = reference
        self.descriptions: Mapping[str, str] = {}
        self.quanta = reference.quanta

    @property
    def time(self) -> Array:
        """Instants of the rows (n,) [s]."""
        return self._reference.time

    @property
    def metadata(self) -> Mapping[str, Any]:
        """Origin of the reference."""
        return self._reference.metadata

    @property
    def columns(self) -> Sequence[str]:
        """Names of the compared columns."""
        return tuple(self._reference.values)

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column."""
        return self._reference.units

    def __getitem__(self, name: str) -> Array:
        """Return a column (n,), or a signal's columns side by side (n, k).

        Raises:
            InputError: The reference does not hold it.
        """
        values = self._reference.values
        if name in values:
            return values[name]
        columns = [values[column] for column in values if column.partition("[")[0] == name]
        if not columns:
            raise InputError(f"the reference holds no {name}")
        return np.column_stack(columns)


def shown_reference(path: Path, name: str = "reference") -> Shown:
    """Return a reference for the view.

    Args:
        path: The file `reference.parquet`.
        name: Its name on the page.

    Raises:
        InputError: There is no reference, or it is damaged.
    """
    reference = Reference.read(path)
    run = show_source(ReferenceSource(reference), name, summary=dict(reference.summary))
    return replace(run, notes=(ROUNDED,))


def reference_of(source: RunData) -> Path:
    """Return the reference of a run's scenario.

    Raises:
        InputError: It has none, or the recording does not say where the scenario is.
    """
    name, folder = (source.metadata.get(key) for key in ("scenario", "scenario_folder"))
    place = Path(str(folder)) if folder else shipped_scenarios().get(str(name))
    if place is None:
        raise InputError(
            f"--against reference: scenario {name!r} is not one of the shipped ones, and the "
            f"recording does not say where it is; give the path of its {REFERENCE_FILE}"
        )
    if not (place / REFERENCE_FILE).is_file():
        raise InputError(
            f"--against reference: {place} has no {REFERENCE_FILE}; "
            f"{how_to_make(place / REFERENCE_FILE)} records one"
        )
    return place / REFERENCE_FILE


__all__ = ["ReferenceSource", "reference_of", "shown_reference"]
