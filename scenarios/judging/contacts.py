"""Unwanted contacts: their force, time and bodies."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...plant.parameters import ARM_AND_PALM, PlantParameters
from ..files import model_file
from ..recording import Recording

SIGNAL: Final = "plant.unwanted_contact_force"
SCENE: Final = "tabletop"  # of a recording that does not name its scene
LOOKS: Final = 50  # contacts whose bodies are looked up


def unwanted_contacts(recording: Recording) -> dict[str, Any]:
    """Return the unwanted contacts of arm and palm.

    Returns:
        `unwanted_force_N`, the largest sum of normal forces, and `unwanted`: for each pair of
        bodies, in order of time, `bodies` and `time_s` of the first contact.
    """
    force = recording[SIGNAL]
    touched = force > 0.0
    begins = np.flatnonzero(touched & ~np.concatenate(([False], touched[:-1])))
    peak = float(force.max(initial=0.0))
    pairs: dict[tuple[str, str], float] = {}
    if len(begins):
        for row, pair in _pairs(recording, begins[:LOOKS]):
            pairs.setdefault(pair, float(recording.time[row]))
    told = [{"bodies": list(pair), "time_s": time} for pair, time in pairs.items()]
    return {"unwanted_force_N": peak, "unwanted": told}


def _pairs(recording: Recording, rows: NDArray[np.int64]) -> Iterator[tuple[int, tuple[str, str]]]:
    """Yield rows with the pairs of bodies that touch there.

    A force belongs to the step that ends in its row; its contacts are those of the step's start.
    """
    import mujoco  # noqa: PLC0415 - slow to import

    model, qpos = _model(recording), recording["plant.qpos"]
    if model.nq != qpos.shape[1]:
        return
    data: Any = mujoco.MjData(model)
    for row in rows.tolist():
        data.qpos[:] = qpos[max(row - 1, 0)]
        mujoco.mj_fwdPosition(model, data)
        for geoms in data.contact.geom.tolist():
            bodies = [str(model.body(model.geom_bodyid[geom]).name) for geom in geoms]
            if set(bodies) & set(ARM_AND_PALM):
                first, second = sorted(_name(model, geom) for geom in geoms)
                yield row, (first, second)


def _model(recording: Recording) -> Any:
    """Return the model that the plant simulated."""
    from ...fmus.packaging.model_fmu import load  # noqa: PLC0415 - imports MuJoCo, which is slow
    from ...plant.scene import load_scene  # noqa: PLC0415 - see above

    file = model_file(recording)
    if file is not None:
        return load(file)
    return load_scene(PlantParameters(scene=str(recording.metadata.get("scene", SCENE))))


def _name(model: Any, geom: int) -> str:
    """Name of what a geom belongs to: its own (`floor`, `table`), or its body's."""
    body = model.body(model.geom_bodyid[geom])
    own = str(model.geom(geom).name)
    return own if own and int(body.weldid[0]) == 0 else str(body.name)


__all__ = ["SIGNAL", "unwanted_contacts"]
