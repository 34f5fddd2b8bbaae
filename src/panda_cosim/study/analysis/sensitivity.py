"""The sensitivity of closed loops, and the margins that follow from it.

Loops that are stable when closed reach the limit of stability where det(I + c L) becomes 0 for a
change c of all loops, that is where an eigenvalue of c L is -1. Those of L follow from those of S:
1 / s - 1. So |L| = 1 where Re s = 1/2, and L is real where Im s = 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.master.wiring import Array

Response = NDArray[np.complex128]

FINER: Final = 4  # points of the grid per wave that fits into the responses
RESOLVED: Final = 1e-2  # smallest gain that is told from 0, and smallest of an open loop
REAL: Final = 1e-9  # imaginary part of what is real, but for rounding
ZERO: Final = 1e-6  # a value that is 0 at the frequency found
BALANCING: Final = 10  # rounds
DESCENT: Final = 100  # steps


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """S = 1 / (1 + L) of n loops, at any frequency, from what returns after a pulse of 1."""

    pulses: Array  # (ticks, n, n) by tick, answer and input
    period: float  # [s] of a tick

    def loop(self, index: int) -> Sensitivity:
        """That of one loop, with the others closed."""
        return Sensitivity(self.pulses[:, index, index, None, None], self.period)

    def at(self, omega: Array) -> Response:
        """S (m, n, n) at frequencies (m,) [rad/s]."""
        angles = np.outer(omega * self.period, np.arange(len(self.pulses)))
        n = self.pulses.shape[1]
        flat = self.pulses.reshape(len(self.pulses), -1)
        returned = np.cos(angles) @ flat - 1j * (np.sin(angles) @ flat)
        return np.asarray(np.eye(n) + returned.reshape(-1, n, n), complex)

    @cached_property
    def grid(self) -> tuple[Array, Response]:
        """Frequencies (m,) from 0 to Nyquist's, and S there (m, n, n)."""
        points = 2 * FINER * math.ceil(len(self.pulses) / 2)
        omega = np.linspace(0.0, math.pi / self.period, points // 2 + 1)
        returned = np.fft.rfft(self.pulses, points, axis=0)
        return omega, np.eye(self.pulses.shape[1]) + returned

    @cached_property
    def eigenvalues(self) -> Response:
        """Eigenvalues of S on the grid (m, n), in no order."""
        return _eigenvalues(self.grid[1])

    def where(self, part: Callable[[Response], Array]) -> tuple[Array, Response]:
        """Frequencies at which a real function of an eigenvalue of S is 0, and that eigenvalue.

        The k-th smallest value is continuous over the frequency, whatever order eigenvalues come
        in. Those of closed loops that hardly answer (S near 1) are left out: they come last.
        """
        from scipy.optimize import elementwise  # noqa: PLC0415 - slow to import

        def ordered(s: Response) -> tuple[Response, Array]:
            values = np.where(np.abs(s - 1.0) > RESOLVED, part(s), math.inf)
            order = np.argsort(values, axis=1)
            return np.take_along_axis(s, order, 1), np.take_along_axis(values, order, 1)

        def exact(omega: Array, which: NDArray[Any]) -> tuple[Response, Array]:
            s, values = ordered(_eigenvalues(self.at(omega)))
            rows = np.arange(len(s)), which.astype(int)
            return s[rows], values[rows]

        omega, (_, values) = self.grid[0], ordered(self.eigenvalues)
        # Twice between two points, if their neighbours' parabola comes close to 0.
        size = np.abs(values)
        least = (size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:])
        row, which = np.nonzero(least & np.isfinite(size[:-2] + size[2:]))
        before, here, after = (values[row + i, which] for i in range(3))
        bend = before - 2.0 * here + after
        shift = np.clip(0.5 * (before - after) / np.where(bend, bend, math.inf), -1.0, 1.0)
        between = omega[row + 1] + shift * omega[1]
        omega, order = np.unique(np.concatenate((omega, between)), return_index=True)
        more = ordered(_eigenvalues(self.at(between)))[1]
        values = np.concatenate((values, more))[order]
        turns = np.diff(values >= 0.0, axis=0) & np.isfinite(values[:-1]) & np.isfinite(values[1:])
        row, which = np.nonzero(turns)
        if not row.size:
            return np.empty(0), np.empty(0, complex)
        found = elementwise.find_root(
            lambda w, k: exact(w, k)[1], (omega[row], omega[row + 1]), args=(which,)
        ).x
        s, left = exact(np.nan_to_num(found), which)
        is_one = np.abs(left) < ZERO  # else an eigenvalue is left out from there on
        return found[is_one], s[is_one]


def _eigenvalues(matrices: Response) -> Response:
    return np.asarray(np.linalg.eigvals(matrices), complex)


@dataclass(frozen=True)
class Limits:
    """Smallest changes of all loops alike that make them unstable; infinite: none does."""

    gain_margin_db: float = 0.0  # up or down
    gain_up_db: float = 0.0
    gain_down_db: float = 0.0
    phase_margin_deg: float = 0.0
    delay_margin_ms: float = 0.0
    crossover_hz: float = 0.0
    bandwidth_hz: float = 0.0


def crossings(sensitivity: Sensitivity) -> tuple[Array, Array]:
    """Frequencies at which an eigenvalue l of L has |l| = 1, and arg(-l) there."""
    omega, s = sensitivity.where(lambda s: s.real - 0.5)
    return omega, np.angle(1.0 - 1.0 / s)


def limits(sensitivity: Sensitivity) -> Limits:
    """Find what n loops bear; definitions.toml says what each number is."""
    omega, angles = crossings(sensitivity)
    delays = np.mod(angles, 2.0 * math.pi) / omega
    ends = sensitivity.eigenvalues[[0, -1]].ravel()  # there, S is real
    real = np.append(sensitivity.where(np.imag)[1], ends[np.abs(ends.imag) < REAL]).real
    real = real[(real < -RESOLVED) | (real > 1.0 + RESOLVED)]
    gains = 20.0 * np.log10(real / (real - 1.0))
    wide = sensitivity.where(lambda s: np.abs(1.0 - s) ** 2 - 0.5)[0]
    hertz = (float(each.max(initial=0.0)) / (2.0 * math.pi) for each in (omega, wide))
    return Limits(
        float(np.abs(gains).min(initial=math.inf)),
        float(gains[gains > 0.0].min(initial=math.inf)),
        float(-gains[gains < 0.0].max(initial=-math.inf)),
        float(np.degrees(np.abs(angles).min(initial=math.inf))),
        1e3 * float(delays.min(initial=math.inf)),
        *hertz,
    )


def disk_margin(sensitivity: Sensitivity) -> tuple[float, float, Array]:
    """Size of the largest disk of simultaneous changes that leaves all loops stable [1].

    Returns also the frequency, and the phases (n,) of the changes at the disk's edge that reach the
    limit there. The size is 1 / max |(S - T) / 2|, the largest singular value over all frequencies,
    with that scaling of rows against columns which makes it smallest, as each loop changes by
    itself: a lower bound of the margin.

    Source: P. Seiler, A. Packard, P. Gahinet, "An Introduction to Disk Margins", IEEE Control
    Systems Magazine 40(5), 2020.
    """
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - slow to import

    omega, values = sensitivity.grid
    bounds = np.linalg.norm(_balanced(_skew(values)), ord=2, axis=(1, 2))
    largest = scaled_norms(_skew(values[[bounds.argmax()]]))[0][0]
    rows = np.flatnonzero(bounds >= largest * (1.0 - REAL))  # at others it is smaller than there
    top = rows[scaled_norms(_skew(values[rows]))[0].argmax()]

    def at(frequency: float) -> tuple[Array, Array]:
        return scaled_norms(_skew(sensitivity.at(np.array([frequency]))))

    refined = minimize_scalar(
        lambda w: -at(w)[0][0],
        bounds=(max(omega[top] - omega[1], 0.0), min(omega[top] + omega[1], omega[-1])),
        method="bounded",
    )
    worst = float(refined.x if -refined.fun > largest else omega[top])
    (norm,), (phases,) = at(worst)
    return float(1.0 / norm), worst, phases


def _skew(s: Response) -> Response:
    """(S - T) / 2 = S - 1 / 2."""
    return np.asarray(s - 0.5 * np.eye(s.shape[1]))


def _balanced(matrices: Response) -> Response:
    """Scale rows against columns, so that they have the same size (Osborne)."""
    for _ in range(BALANCING):
        rows, columns = (np.linalg.norm(matrices, axis=axis) for axis in (2, 1))
        scale = np.sqrt(columns / rows)
        matrices = matrices * scale[:, :, None] / scale[:, None, :]
    return matrices


def scaled_norms(matrices: Response) -> tuple[Array, Array]:
    """Return the smallest largest singular value (m,) of D M D^-1 over diagonal D, of (m, n, n).

    It is convex in log D; its gradient follows from the singular vectors. Phases (m, n) of d are
    those with which 1 is an eigenvalue of M diag(d), if |d| is the inverse of this value.
    """
    matrices, least = _balanced(matrices), np.full(len(matrices), math.inf)
    phases = np.zeros(matrices.shape[:2])
    for step in range(DESCENT):
        left, values, right = np.linalg.svd(matrices)
        better = values[:, 0] < least
        least[better] = values[better, 0]
        phases[better] = -np.angle(right[better, 0] * left[better, :, 0])
        slope = np.abs(left[:, :, 0]) ** 2 - np.abs(right[:, 0, :]) ** 2
        scale = np.exp(-slope / (1.0 + 0.1 * step))
        matrices = matrices * scale[:, :, None] / scale[:, None, :]
    return least, phases
