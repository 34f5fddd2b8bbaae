"""A recording as a pandas DataFrame or an xarray Dataset."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from ...fmus.errors import CosimError

if TYPE_CHECKING:
    from .reader import Recording


def to_pandas(recording: Recording, signals: Sequence[str] | None = None) -> Any:
    """Return a pandas.DataFrame with one column per scalar, indexed by time [s].

    `attrs` holds units and descriptions by column.

    Raises:
        CosimError: pandas is not installed.
        InputError: There is no such signal.
    """
    pandas = _library("pandas")
    names = [n for signal in signals or recording.signals for n in _columns(recording, signal)]
    index = pandas.Index(recording.time, name="time")
    frame = pandas.DataFrame({name: recording[name] for name in names if name != "time"}, index)
    frame.attrs["units"] = {name: recording.units[name] for name in frame.columns}
    frame.attrs["descriptions"] = {name: recording.descriptions[name] for name in frame.columns}
    return frame


def to_xarray(recording: Recording, signals: Sequence[str] | None = None) -> Any:
    """Return an xarray.Dataset with one variable per signal, whose first dimension is time [s].

    Further dimensions are `NAME_1`, `NAME_2`, with indices from 1. Each variable has a
    `description`, and `units` if all its elements have the same unit.

    Raises:
        CosimError: xarray is not installed.
        InputError: There is no such signal.
    """
    xarray = _library("xarray")
    variables: dict[str, Any] = {}
    indices: dict[str, Any] = {}
    for signal in signals or recording.signals:
        values = recording[signal]
        dimensions = [f"{signal}_{axis}" for axis in range(1, values.ndim)]
        sizes = zip(dimensions, values.shape[1:], strict=True)
        indices |= {dimension: np.arange(1, size + 1) for dimension, size in sizes}
        variables[signal] = (("time", *dimensions), values, _attributes(recording, signal))
    variables.pop("time", None)
    time = ("time", recording.time, {"units": "s"})
    metadata = {k: v for k, v in recording.metadata.items() if isinstance(v, str | float | int)}
    return xarray.Dataset(variables, {"time": time, **indices}, metadata)


def _columns(recording: Recording, signal: str) -> list[str]:
    recording[signal]  # raises InputError if there is none
    if signal in recording.units:
        return [signal]
    return [name for name in recording.columns if name.startswith(f"{signal}[")]


def _attributes(recording: Recording, signal: str) -> dict[str, str]:
    names = _columns(recording, signal)
    units = {recording.units[name] for name in names}
    told = {"units": units.pop()} if len(units) == 1 else {}
    return {**told, "description": recording.descriptions[names[0]]}


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise CosimError(f"{name} is not installed; pip install 'panda-cosim[notebook]'") from None


__all__ = ["to_pandas", "to_xarray"]
