"""State-space models from responses to pulses, by python-control (Ho and Kalman).

States have a meaning as far as possible: they are positions and speeds among the model's outputs.
What the responses need beside these is identified, and has no meaning.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ...fmus.master.wiring import Array

if TYPE_CHECKING:
    import control


ORDER: Final = 40  # largest of a model
ROWS: Final = 15  # of Hankel's matrix, as blocks; more are slow, and seldom better
COLUMNS: Final = 80  # likewise
FIT: Final = 1e-3  # of the peak, by which a model's response may differ from the measured one
INDEPENDENT: Final = 1e-3  # share of a state that does not follow from those before it


def realised(
    pulses: Array, physical: Sequence[int], *about: Any
) -> tuple[control.StateSpace, float]:
    """Return the smallest model that gives the responses, and by how much it differs.

    Args:
        pulses: Responses (ticks, outputs, inputs) to a pulse of 1 in the first tick.
        physical: Outputs that are states, if the model has room for them.
        about: Period of a tick [s], and names of the inputs, outputs and the model.
    """
    import control  # noqa: PLC0415 - brings matplotlib and scipy

    peaks = np.abs(pulses[1:]).max(axis=(0, 2), initial=0.0)
    peaks[peaks == 0.0] = 1.0
    scaled = pulses / peaks[:, None]
    scaled = np.pad(scaled, ((0, max(4 - len(scaled), 0)), (0, 0), (0, 0)))  # the fewest it takes
    rows = min(ROWS, len(scaled) // 2 - 1)
    columns = min(COLUMNS, len(scaled) - 1 - rows)
    order = min(ORDER, rows * pulses.shape[1], columns * pulses.shape[2])
    with np.errstate(divide="ignore", invalid="ignore"):  # of states that are left out below
        # Its own sampling time would scale B: it is for responses to pulses of area 1.
        whole, _ = control.eigensys_realization(scaled.transpose(1, 2, 0), order, rows, columns)
    errors: list[float] = []  # by order
    while len(errors) <= order and min(errors, default=math.inf) > FIT:
        errors.append(_misfit(*_first(whole, len(errors)), scaled))
    size = int(np.argmin(errors))
    a, b, c = _first(whole, size)
    c = c * peaks[:, None]
    period, inputs, outputs, name = about
    states = _independent(c, physical)
    names = [outputs[i] for i in states]
    names += [f"identified[{i}]" for i in range(1, size - len(states) + 1)]
    basis = np.linalg.svd(c[states])[2]  # the last rows are orthogonal to these outputs
    basis[: len(states)] = c[states]
    inverse = np.linalg.inv(basis)
    matrices = basis @ a @ inverse, basis @ b, c @ inverse, pulses[0]
    return system(*matrices, period, inputs, outputs, name, names), errors[size]


def _first(balanced: control.StateSpace, states: int) -> tuple[Array, Array, Array]:
    return balanced.A[:states, :states], balanced.B[:states], balanced.C[:, :states]


def _misfit(a: Array, b: Array, c: Array, pulses: Array) -> float:
    """Largest difference between a model's response to a pulse and the measured one."""
    state, error = b, 0.0
    for answer in pulses[1:]:
        error = float(np.maximum(error, np.abs(c @ state - answer).max()))
        state = a @ state
        if not error < 1.0:  # a model that diverges
            break
    return error


def _independent(c: Array, wanted: Sequence[int]) -> list[int]:
    """Those of the wanted outputs that do not follow from the ones before (Gram and Schmidt)."""
    chosen: list[int] = []
    basis = np.empty((0, c.shape[1]))
    for output in wanted:
        rest = c[output] - basis.T @ (basis @ c[output])
        size = np.linalg.norm(rest)
        if len(chosen) < c.shape[1] and size > INDEPENDENT * np.linalg.norm(c[output]):
            basis = np.vstack((basis, rest / size))
            chosen.append(output)
    return chosen


def system(*parts: Any) -> Any:
    """Return a `control.StateSpace` of A, B, C, D, period, and its names: `_` stands for a point.

    The names are those of inputs, outputs, the system and, if they have any, the states.
    """
    import control  # noqa: PLC0415 - brings matplotlib and scipy

    *matrices, inputs, outputs, name, states = parts
    ends = [[text.replace(".", "_") for text in texts] for texts in (inputs, outputs, states)]
    return control.ss(*matrices, inputs=ends[0], outputs=ends[1], states=ends[2], name=name)
