"""Compact columns of numbers: rounded, second differences, deflated.

The browser decodes them in `source/src/data/codec.ts`.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...assets.fields import Array
from ..thinning import NOISE

Json = dict[str, Any]  # what `source/src/data/types.ts` gives a type

LEVEL: Final = 1  # of deflate; 4 takes twice as long for a fifth less
LARGEST: Final = 2**30  # steps from a column's first value; int32 holds the sums
HUGE: Final = 1e300  # larger values are clipped, so that differences are finite
CURVE_STEPS: Final = 2**16  # steps of a curve's range


def pack(content: bytes) -> str:
    """Deflate bytes and return them in base64."""
    return base64.b64encode(zlib.compress(content, LEVEL)).decode("ascii")


def encode(columns: Sequence[Array], steps: Sequence[float | None]) -> Json:
    """Encode columns of the same length for the page."""
    values, gaps = np.array(columns, np.float64), {}
    for index in np.flatnonzero(~(np.abs(values) <= HUGE).all(axis=1)).tolist():
        values[index], missing = _fill(values[index])
        if missing:
            gaps[index] = missing
    empty = np.zeros((2, len(values)))
    low, high = (values.min(axis=1), values.max(axis=1)) if values.size else empty
    curves = np.array([step is None for step in steps])
    noise = curves & (np.maximum(-low, high) < NOISE)
    values[noise] = low[noise] = high[noise] = 0.0
    offsets = values[:, 0].copy() if values.size else empty[0]
    quanta = np.where(curves, (high - low) / CURVE_STEPS, [step or 0.0 for step in steps])
    reach = np.maximum(high - offsets, offsets - low)
    quanta = np.maximum(quanta, reach / LARGEST)  # coarse enough for int32
    quanta[quanta == 0.0] = 1.0
    values -= offsets[:, None]
    values /= quanta[:, None]
    return {
        "rows": values.shape[1],
        "steps": quanta.tolist(),
        "offsets": offsets.tolist(),
        "gaps": gaps,
        "data": pack(_differences(np.rint(values, out=values).astype(np.int32))),
    }


def _fill(values: Array) -> tuple[Array, list[tuple[int, int]]]:
    """Hold the last finite value over gaps; return the values and the gaps."""
    bad = ~np.isfinite(values)
    values = np.clip(values, -HUGE, HUGE)
    if not bad.any():
        return values, []
    rows = np.where(bad, 0, np.arange(len(values)))
    filled = np.nan_to_num(values[np.maximum.accumulate(rows)], posinf=0.0, neginf=0.0)
    edges = np.flatnonzero(np.diff(bad, prepend=False, append=False)).tolist()
    return filled, list(zip(edges[::2], edges[1::2], strict=True))


def _differences(whole: NDArray[np.int32]) -> bytes:
    """Return second differences (mod 2^32, sign in the last bit), byte by byte of all numbers."""
    whole[:, 1:] -= whole[:, :-1].copy()
    whole[:, 1:] -= whole[:, :-1].copy()
    zigzag = ((whole << 1) ^ (whole >> 31)).astype("<u4")
    return zigzag.view(np.uint8).reshape(-1, 4).T.tobytes()


def describe_time(time: Array) -> Json:
    """Return instants for the page: start and step if evenly spaced, else all."""
    if len(time) < 2:
        return {"start": float(time[0]) if len(time) else 0.0, "step": 0.001, "rows": len(time)}
    step = float(time[-1] - time[0]) / (len(time) - 1)
    even = time[0] + step * np.arange(len(time))
    if step > 0 and np.abs(time - even).max() < 1e-7:
        return {"start": float(time[0]), "step": step, "rows": len(time)}
    return {"rows": len(time), "block": encode([time], [1e-6])}
