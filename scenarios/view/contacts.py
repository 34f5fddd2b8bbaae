"""Contact forces of a run, had again from what was recorded.

A recording holds no contact forces but the sum on the fingers. `mj_forward` finds them from qpos,
qvel and ctrl. The constraint solver starts there from nothing rather than from the step before
(the warm start is not recorded), so a single tick of an impact may differ from the simulation's.
"""

from __future__ import annotations

from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from .columns import encode

Array = NDArray[np.float64]

INTERVAL: Final = 0.004  # [s] between two instants
INSTANTS: Final = 18_000  # at most
LEAST: Final = 0.05  # [N] a smaller force is not drawn
STEPS: Final = (1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3)  # [m], [N] that they are rounded to
WORDS: Final = (
    "Contact forces are computed again by mj_forward from recorded qpos, qvel and ctrl. The "
    "solver's warm start is not recorded, so single ticks of an impact may differ."
)


def contact_rows(time: Array) -> tuple[float, NDArray[np.int64]]:
    """Return the interval [s] of the instants, and the row of each.

    Args:
        time: Instants of the rows (n,) [s].
    """
    span = float(time[-1] - time[0])
    interval = max(INTERVAL, span / INSTANTS)
    instants = time[0] + interval * np.arange(int(span / interval) + 1)
    return interval, np.minimum(np.searchsorted(time, instants - 1e-9), len(time) - 1)


def contact_forces(model: Any, qpos: Array, qvel: Array, ctrl: Array) -> dict[str, Any]:
    """Return the contact forces at some instants for the page.

    Args:
        model: The plant's `mujoco.MjModel`, with the run's masses and frictions.
        qpos: Positions (k, nq).
        qvel: Velocities (k, nv).
        ctrl: Controls (k, nu).

    Returns:
        `counts`, the number of contacts at each instant; `block`, columns of all contacts one
        after the other: where (x, y, z) [m] and force (x, y, z) [N], world frame, on the body that
        can move freely, else on the second; `words` for the page.
    """
    free = _free_bodies(model)
    data, counts, found = mujoco.MjData(model), [], []
    for state in zip(qpos, qvel, ctrl, strict=True):
        contacts = _contacts_at(model, data, state, free)
        counts.append(float(len(contacts)))
        found += contacts
    table = np.array(found).reshape(-1, 6)
    return {
        "counts": encode([np.array(counts)], [1.0]),
        "block": encode(list(table.T), STEPS),
        "words": WORDS,
    }


def _free_bodies(model: Any) -> NDArray[np.bool_]:
    """Return which bodies are moved by a free joint (nbody,)."""
    free = np.zeros(model.nbody, dtype=bool)
    free[model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]] = True
    return np.asarray(free[model.body_rootid])


def _contacts_at(
    model: Any, data: Any, state: tuple[Array, Array, Array], free: NDArray[np.bool_]
) -> list[list[float]]:
    """Return the contacts of an instant: place and force."""
    data.qpos[:], data.qvel[:], data.ctrl[:] = state
    data.qacc_warmstart[:] = 0.0
    if not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
        return []
    mujoco.mj_forward(model, data)
    result, found = np.zeros(6), []
    for index in range(data.ncon):
        contact = data.contact[index]
        mujoco.mj_contactForce(model, data, index, result)
        force = result[:3] @ contact.frame.reshape(3, 3)  # of the first geom on the second
        first, second = model.geom_bodyid[contact.geom]
        if free[first] and not free[second]:
            force = -force
        if np.linalg.norm(force) > LEAST:
            found.append([*contact.pos.tolist(), *force.tolist()])
    return found


__all__ = ["contact_forces", "contact_rows"]
