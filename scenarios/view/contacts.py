"""Contact forces of a run, recomputed from its recording.

A recording holds only sums of contact forces. `mj_forward` computes the forces from qpos, qvel and
ctrl. The constraint solver has no warm start there (it is not recorded), so single ticks of an
impact may differ from the simulation.
"""

from __future__ import annotations

from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from .columns import encode

Array = NDArray[np.float64]

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
    data = mujoco.MjData(model)
    usable = np.flatnonzero(np.isfinite(np.column_stack([qpos, qvel])).all(axis=1))
    each = [_contacts_at(model, data, (qpos[k], qvel[k], ctrl[k])) for k in usable]
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
