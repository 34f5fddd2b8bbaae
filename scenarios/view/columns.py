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

Array = NDArray[np.float64]

LEVEL: Final = 4  # of deflate; 6 takes twice as long for 3 % less
LARGEST: Final = 2**30  # steps from a column's first value; int32 holds the sums
HUGE: Final = 1e300  # larger values are clipped, so that differences are finite
CURVE_STEPS: Final = 2**16  # steps of a curve's range
NOISE: Final = 1e-12  # a curve that stays below is rounding noise, and shown as 0


def pack(content: bytes) -> str:
    """Deflate bytes and return them in base64."""
    return base64.b64encode(zlib.compress(content, LEVEL)).decode("ascii")


def encode(columns: Sequence[Array], steps: Sequence[float | None]) -> dict[str, Any]:
    """Encode columns for the page.

    Args:
        columns: Each (n,). Values that are not finite become gaps.
        steps: Rounding step of each, in its unit; None: 1/65536 of its range, and 0 for noise.

    Returns:
        `rows`; `steps` and `offsets` of the columns; `gaps`, pairs (first, end) of rows for each
        column that has any; `data`, the packed whole numbers, column after column.
    """
    quanta, offsets, gaps, whole = [], [], {}, []
    for index, (values, step) in enumerate(zip(columns, steps, strict=True)):
        filled, missing = _fill(values)
        if step is None and np.abs(filled).max(initial=0.0) < NOISE:
            filled = np.zeros_like(filled)
        if missing:
            gaps[index] = missing
        offset = float(filled[0]) if len(filled) else 0.0
        quantum = _quantum(filled, offset, step)
        quanta.append(quantum)
        offsets.append(offset)
        whole.append(np.rint((filled - offset) / quantum).astype(np.int64))
    return {
        "rows": len(columns[0]) if columns else 0,
        "steps": quanta,
        "offsets": offsets,
        "gaps": gaps,
        "data": pack(_differences(whole)),
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


def _quantum(values: Array, offset: float, step: float | None) -> float:
    """Return the rounding step: the given one, or one coarse enough for int32."""
    reach = float(np.abs(values - offset).max(initial=0.0))
    if step is None:
        step = float(np.ptp(values)) / CURVE_STEPS if len(values) else 0.0
    return max(step, reach / LARGEST) or 1.0


def _differences(whole: Sequence[NDArray[np.int64]]) -> bytes:
    """Return second differences (mod 2^32, sign in the last bit), byte by byte of all numbers."""
    parts = [np.diff(np.diff(column, prepend=0), prepend=0).astype(np.int32) for column in whole]
    numbers = np.concatenate(parts) if parts else np.empty(0, np.int32)
    zigzag = ((numbers << 1) ^ (numbers >> 31)).astype("<u4")
    return zigzag.view(np.uint8).reshape(-1, 4).T.tobytes()
