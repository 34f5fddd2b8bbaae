"""State-space models of closed loops, from their responses to pulses (Ho and Kalman)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ...fmus.master.wiring import Array
from .responses import Responses

if TYPE_CHECKING:
    import control


ORDER: Final = 40  # largest of a model
HANKEL: Final = 80  # rows and columns of Hankel's matrix; more are slow, and seldom better
FIT: Final = 1e-3  # of the peak, by which a model's response may differ from the measured one


def realised(responses: Responses) -> tuple[control.StateSpace, float]:
    """Return the smallest model that gives the responses, and by how much it differs."""
    import control  # noqa: PLC0415 - brings matplotlib and scipy

    n, peaks = len(responses.inputs), np.abs(responses.pulses).max(axis=(0, 2))
    peaks[peaks == 0.0] = 1.0
    pulses = responses.pulses / peaks[:, None]
    pulses = np.pad(pulses, ((0, max(4 - len(pulses), 0)), (0, 0), (0, 0)))  # the fewest it takes
    rows = max(min(HANKEL, len(pulses) // 2 - 1), 1)
    order = min(ORDER, rows)
    with np.errstate(divide="ignore", invalid="ignore"):  # of states that are left out below
        # Its own sampling time would scale B: it is for responses to pulses of area 1.
        whole, _ = control.eigensys_realization(pulses.transpose(1, 2, 0), order, rows, rows)
    best, error = 0, math.inf
    for size in range(order + 1):
        misfit = _misfit(whole.A[:size, :size], whole.B[:size], whole.C[:, :size], pulses)
        if misfit < error:
            best, error = size, misfit
        if error <= FIT:
            break
    parts = whole.A[:best, :best], whole.B[:best], whole.C[:, :best] * peaks[:, None]
    inputs, outputs = responses.inputs, (*responses.inputs, *responses.positions)
    direct = responses.pulses[0] + np.eye(len(outputs), n)  # what is added, itself
    return system(*parts, direct, responses.period, inputs, outputs), error


def _misfit(a: Array, b: Array, c: Array, pulses: Array) -> float:
    """Largest difference between a model's response to a pulse and the measured one."""
    state, error = b, 0.0
    for answer in pulses[1:]:
        error = float(np.maximum(error, np.abs(c @ state - answer).max()))
        state = a @ state
        if not error < 1.0:  # a model that diverges
            break
    return error


def system(*parts: Any) -> Any:
    """Return a `control.StateSpace` of A, B, C, D, period, and names of inputs and outputs."""
    import control  # noqa: PLC0415 - brings matplotlib and scipy

    *matrices, inputs, outputs = parts
    ends = [[name.replace(".", "_") for name in names] for names in (inputs, outputs)]
    return control.StateSpace(*matrices, inputs=ends[0], outputs=ends[1])
