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


def contact_forces(model: Any, time: Array, qpos: Array, qvel: Array, ctrl: Array) -> dict:
    """Return the contact forces of a run for the page.

    Args:
        model: The plant's `mujoco.MjModel`, with the run's masses and frictions.
        time: Instants of the rows (n,) [s].
        qpos: Positions (n, nq).
        qvel: Velocities (n, nv).
        ctrl: Controls (n, nu).

    Returns:
        `start` and `interval` [s] of the instants; `counts`, the number of contacts at each;
        `block`, columns of all contacts one after the other: where (x, y, z) [m] and force
        (x, y, z) [N], world frame, on the body that can move freely, else on the second.
    """
    span = float(time[-1] - time[0])
    interval = max(INTERVAL, span / INSTANTS)
    instants = time[0] + interval * np.arange(int(span / interval) + 1)
    rows = np.minimum(np.searchsorted(time, instants - 1e-9), len(time) - 1)
    free = _free_bodies(model)
    data, counts, found = mujoco.MjData(model), [], []
    for row in rows:
        contacts = _contacts_at(model, data, (qpos[row], qvel[row], ctrl[row]), free)
        counts.append(float(len(contacts)))
        found += contacts
    table = np.array(found).reshape(-1, 6)
    return {
        "start": float(time[0]),
        "interval": interval,
        "counts": encode([np.array(counts)], [1.0]),
        "block": encode(list(table.T), STEPS),
        "words": WORDS,
    }


def _free_bodies(model: Any) -> NDArray[np.bool_]:
    """Return which bodies are moved by a free joint (nbody,)."""
    free = np.zeros(model.nbody, dtype=bool)
    free[model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]] = True
    return free[model.body_rootid]


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


__all__ = ["contact_forces"]
