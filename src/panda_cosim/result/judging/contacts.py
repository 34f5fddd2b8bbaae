"""Unwanted contacts: their force, times and bodies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from ...assets import ELASTIC
from ...plant.parameters import BLOCK, PlantParameters
from ...task.files import model_file
from ..recording import Recording
from .summary import Metrics

SIGNAL: Final = "plant.unwanted_contact_force"


@dataclass(frozen=True)
class Touch:
    """An unwanted contact of two bodies."""

    bodies: tuple[str, str]  # their names, in alphabetical order
    time_s: float  # the first row with a force [s]
    end_s: float  # the last one, possibly of a later contact of the two [s]
    # Largest sum of all unwanted forces on rows on which they touch [N].
    force_N: float  # noqa: N815 - the key in summary.json, with its unit

    def __str__(self) -> str:
        a, b = self.bodies
        span = f"at t = {self.time_s:.3f} s"
        if self.end_s > self.time_s:
            span = f"from t = {self.time_s:.3f} to {self.end_s:.3f} s"
        return f"{a} and {b} touch {span}; unwanted contacts then have up to {self.force_N:.3g} N"


def unwanted_contacts(recording: Recording) -> Metrics:
    """Return the largest sum of the unwanted normal forces, and a `Touch` for each pair."""
    force = recording[SIGNAL]
    touches: dict[tuple[str, str], Touch] = {}
    for touch in _touches(recording) if force.any() else ():
        first = touches.get(touch.bodies, touch)
        most = max(first.force_N, touch.force_N)
        touches[touch.bodies] = Touch(touch.bodies, first.time_s, touch.end_s, most)
    return {
        "unwanted_force_N": float(force.max(initial=0.0)),
        "unwanted": [asdict(touch) for touch in touches.values()],
    }


def _touches(recording: Recording) -> Iterator[Touch]:
    """Yield the unwanted contacts, row by row."""
    # A force belongs to the step that ends in its row; its contacts are those of the step's start.
    import mujoco  # noqa: PLC0415 - slow to import

    from ...plant.contacts import UNWANTED, contacts_of, kinds_of  # noqa: PLC0415 - see above

    model = _model(recording)
    kinds, data = kinds_of(model), mujoco.MjData(model)
    force = recording[SIGNAL]
    rows = np.flatnonzero(force > 0.0)
    before = recording["plant.qpos"][np.maximum(rows - 1, 0)]
    if model.nq != before.shape[1]:
        return
    for time, strength, qpos in zip(recording.time[rows], force[rows], before, strict=True):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        for pair, kind in zip(data.contact.geom.tolist(), contacts_of(kinds, data), strict=True):
            if kind & UNWANTED:
                first, second = sorted(_name(model, geom) for geom in pair)
                yield Touch((first, second), float(time), float(time), float(strength))


def _model(recording: Recording) -> Any:
    """Return the model of the plant, without rotors of elastic joints, which no output tells."""
    from ...fmus.sources.model_fmu import load  # noqa: PLC0415 - imports MuJoCo, which is slow
    from ...plant.scene import load_scene  # noqa: PLC0415 - see above

    file = model_file(recording)
    if file is not None:
        return load(file)
    scene = str(recording.metadata.get("scene", PlantParameters.scene))
    return load_scene(PlantParameters(scene=PlantParameters.scene if scene == ELASTIC else scene))


def _name(model: Any, geom: int) -> str:
    """Name of what a geom belongs to: its own (`floor`, `table`), `block`, or its body's."""
    body = model.body(model.geom_bodyid[geom])
    own = str(model.geom(geom).name)
    if own and int(body.weldid[0]) == 0:
        return own
    return "block" if body.name == BLOCK else str(body.name)
