"""Compact columns of numbers: rounded, second differences, deflated; of long runs, fewer rows.

The browser decodes them in `source/src/data/codec.ts`. Up to `ALL_ROWS` rows, all are kept. Of a
longer run, every k-th pose is kept, and the smallest and largest value of each curve in each of
`STRETCHES` stretches, so that no peak is lost.

A recording holds only sums of contact forces. `mj_forward` computes the forces from qpos, qvel and
ctrl. The constraint solver has no warm start there (it is not recorded), so single ticks of an
impact may differ from the simulation.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEVEL: Final = 1  # of deflate; 4 takes twice as long for a fifth less
LARGEST: Final = 2**30  # steps from a column's first value; int32 holds the sums
HUGE: Final = 1e300  # larger values are clipped, so that differences are finite
CURVE_STEPS: Final = 2**16  # steps of a curve's range
ALL_ROWS: Final = 30_001  # 30 s at 1 ms
POSES: Final = 120_000  # of a longer run
STRETCHES: Final = 4_000  # of a longer run's curves; each gives two points
NOISE: Final = 1e-12  # a curve that stays below is rounding noise, and shown as 0


def pack(content: bytes, level: int = LEVEL) -> str:
    """Deflate bytes and return them in base64."""
    return base64.b64encode(zlib.compress(content, level)).decode("ascii")


def encode(columns: Sequence[Array], steps: Sequence[float | None]) -> dict[str, Any]:
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


@dataclass(frozen=True)
class Thinning:
    """The kept rows of a run."""

    time: Array  # instants of all rows (n,) [s]
    every: int = 1  # rows from one pose to the next
    stretches: int = 0  # of curves; 0: all rows are kept

    @classmethod
    def of(cls, time: Array) -> Thinning:
        """Choose the rows to keep of a run with these instants (n,) [s]."""
        if len(time) <= ALL_ROWS:
            return cls(time)
        return cls(time, every=-(-len(time) // POSES), stretches=STRETCHES)

    @property
    def pose_time(self) -> Array:
        """Instants of the poses (k,) [s]; the last row is among them."""
        return self.poses(self.time)

    @property
    def curve_time(self) -> Array:
        """Instants of the curves' points (k,) [s]."""
        if not self.stretches:
            return self.time
        first, end = self._edges()
        return np.ravel(np.column_stack((self.time[first], self.time[(first + end - 1) // 2])))

    def poses(self, values: Array) -> Array:
        """Return the rows (k, ...) of poses."""
        if self.every == 1:
            return values
        return np.concatenate((values[: -1 : self.every], values[-1:]))

    def curve(self, values: Array) -> Array:
        """Return a column's points (k,): all, or minimum and maximum of each stretch, in order."""
        if not self.stretches:
            return values
        first, _ = self._edges()
        low = np.minimum.reduceat(values, first)
        high = np.maximum.reduceat(values, first)
        rising = values[first] <= (low + high) / 2
        pairs = np.column_stack((np.where(rising, low, high), np.where(rising, high, low)))
        return np.ravel(pairs)

    def _edges(self) -> tuple[Any, Any]:
        """Return the first and end row of each stretch."""
        edges = np.linspace(0, len(self.time), self.stretches + 1).astype(np.int64)
        return edges[:-1], edges[1:]

    def words(self) -> str:
        """Describe what was left out, or ""."""
        if not self.stretches:
            return ""
        span = float(self.time[-1] - self.time[0])
        return (
            f"Thinned from {len(self.time)} rows: poses every "
            f"{1e3 * span * self.every / (len(self.time) - 1):.3g} ms, linear in between; curves "
            f"show the least and the greatest value of every "
            f"{1e3 * span / self.stretches:.3g} ms. Paths are drawn around the present."
        )


def describe_time(time: Array) -> dict[str, Any]:
    """Return instants for the page: start and step if evenly spaced, else all."""
    if len(time) < 2:
        return {"start": float(time[0]) if len(time) else 0.0, "step": 0.001, "rows": len(time)}
    step = float(time[-1] - time[0]) / (len(time) - 1)
    even = time[0] + step * np.arange(len(time))
    if step > 0 and np.abs(time - even).max() < 1e-7:
        return {"start": float(time[0]), "step": step, "rows": len(time)}
    return {"rows": len(time), "block": encode([time], [1e-6])}


INTERVAL: Final = 1 / 60  # [s] between two instants: that of a screen
INSTANTS: Final = 18_000  # at most
LEAST: Final = 0.05  # [N] smaller forces are not drawn
STEPS: Final = (1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3)  # [m], [N] rounding steps
FREE_JOINT: Final = mujoco.mjtJoint.mjJNT_FREE
# Columns of a table of contacts: geoms, place, axes row by row, force and torque along these.
GEOMS, POS, FRAME, FORCE = slice(0, 2), slice(2, 5), slice(5, 14), slice(14, 20)
CONTACT: Final = 20  # columns
WORDS: Final = (
    "Contact forces are computed again by mj_forward from recorded qpos, qvel and ctrl. The "
    "solver's warm start is not recorded, so single ticks of an impact may differ."
)


def contact_rows(time: Array) -> tuple[float, NDArray[np.int64]]:
    """Return the interval [s] of the instants, and the row of each."""
    span = float(time[-1] - time[0])
    interval = max(INTERVAL, span / INSTANTS)
    instants = time[0] + interval * np.arange(int(span / interval) + 1)
    return interval, np.minimum(np.searchsorted(time, instants - 1e-9), len(time) - 1)


def contact_forces(model: Any, qpos: Array, qvel: Array, ctrl: Array) -> dict[str, Any]:
    """Return the contact forces at some instants for the page."""
    usable = np.flatnonzero(np.isfinite(np.column_stack([qpos, qvel])).all(axis=1))

    def at(instants: NDArray[np.int64]) -> list[Array]:
        data = mujoco.MjData(model)
        return [_contacts_at(model, data, (qpos[k], qvel[k], ctrl[k])) for k in instants]

    with ThreadPoolExecutor(2) as both:  # mj_forward computes without Python's lock
        each = [*chain.from_iterable(both.map(at, np.array_split(usable, 2)))]
    instant = np.repeat(usable, list(map(len, each)))
    contacts = np.concatenate([np.empty((0, CONTACT)), *each])
    force = _on_the_free_body(model, contacts)
    drawn = np.linalg.norm(force, axis=1) > LEAST
    counts = np.bincount(instant[drawn], minlength=len(qpos)).astype(np.float64)
    table = np.column_stack([contacts[:, POS], force])[drawn]
    return {
        "counts": encode([counts], [1.0]),
        "block": encode(list(table.T), STEPS),
        "words": WORDS,
    }


def _contacts_at(model: Any, data: Any, state: tuple[Array, Array, Array]) -> Array:
    """Return the contacts of an instant, one per row: geoms, position, axes, force along these."""
    data.qpos, data.qvel, data.ctrl = state
    data.qacc_warmstart = 0.0
    mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_NONE, 1)  # no sensors
    contact, rows = data.contact, np.empty((data.ncon, CONTACT))
    rows[:, GEOMS], rows[:, POS], rows[:, FRAME] = contact.geom, contact.pos, contact.frame
    for index, row in enumerate(rows[:, FORCE]):
        mujoco.mj_contactForce(model, data, index, row)
    return rows


def _on_the_free_body(model: Any, contacts: Array) -> Array:
    """Return the forces (k, 3) [N], world frame, on the body that moves freely, or the second."""
    free = np.isin(model.body_rootid, model.jnt_bodyid[model.jnt_type == FREE_JOINT])
    # Of the first geom on the second.
    axes = contacts[:, FRAME].reshape(-1, 3, 3)
    force = np.einsum("ki,kij->kj", contacts[:, FORCE][:, :3], axes)
    first, second = model.geom_bodyid[contacts[:, GEOMS].astype(int)].T
    force[free[first] & ~free[second]] *= -1.0
    return np.asarray(force)
