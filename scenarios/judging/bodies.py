"""Judges positions and orientations of bodies."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from ...fmus.messages import did_you_mean, excerpt
from ..recording import Recording
from ..scenario.success import BLOCK, BOUNDS, BodyCriterion
from .block import POSE
from .criterion import Criterion
from .holds import Events
from .signals import UnmeasuredError, row_at

Array = NDArray[np.float64]
_POSE = "_xquat[4]"  # end of a column's name, where a body's pose is recorded


def check_bodies(criteria: Iterable[BodyCriterion], units: Mapping[str, str]) -> None:
    """Check that the pose of each body is recorded, else raise `InputError`."""
    posed = [n.removeprefix("plant.").removesuffix(_POSE) for n in units if n.endswith(_POSE)]
    bodies = [name for name in posed if f"plant.{name}_xpos[3]" in units]
    bodies += [BLOCK] if "plant.qpos[16]" in units else []
    for index, criterion in enumerate(criteria, 1):
        if criterion.body not in bodies:
            valid = f"one of {', '.join(bodies)}" if bodies else "a body whose pose is recorded"
            raise InputError(
                f"[[success.body]] {index}: body: value {excerpt(criterion.body)}; must be {valid}"
                f"{did_you_mean(criterion.body, bodies)}"
            )


def judge_bodies(
    criteria: Iterable[BodyCriterion], recording: Recording, events: Events
) -> list[Criterion]:
    """Judge a run by each bound of each criterion."""
    return [judged for criterion in criteria for judged in _judge(criterion, recording, events)]


def _judge(criterion: BodyCriterion, recording: Recording, events: Events) -> list[Criterion]:
    values: Mapping[str, float] = {}
    reason = None
    try:
        values = _measure(criterion, recording, row_at(criterion.at, recording.time, events))
    except ValueError as error:
        reason = str(error)
    return [
        Criterion.judge(
            f"{criterion.body} {'position' if name == 'tolerance' else name}",
            values.get(name),
            bound,
            BOUNDS[name],
            "above" if name.startswith("min_") else "below",
            reason,
        )
        for name, bound in criterion.bounds.items()
    ]


def _measure(criterion: BodyCriterion, recording: Recording, row: int) -> dict[str, float]:
    """Return the value of each bound; raise `UnmeasuredError` if the pose is not finite."""
    first, last = np.column_stack([recording[name][[0, row]] for name in _pose(criterion)])
    start, end, (_, x, y, _) = first[:3], last[:3], last[3:].tolist()
    if not (np.isfinite(end).all() and math.isfinite(x * y)):
        raise UnmeasuredError("is not finite")
    target = end if criterion.position is None else np.array(criterion.position)
    return {
        "tolerance": float(np.linalg.norm(end - target)),
        "max_tilt": math.degrees(math.acos(min(1.0, max(-1.0, 1 - 2 * (x * x + y * y))))),
        "max_shift": float(np.linalg.norm(end - start)),
        "min_lift": float(end[2] - start[2]),
    }


def _pose(criterion: BodyCriterion) -> list[str]:
    """Return the columns of a body's position and quaternion (w, x, y, z)."""
    if criterion.body == BLOCK:
        return POSE
    sizes = zip(criterion.signals, (3, 4), strict=True)
    return [f"{name}[{i}]" for name, size in sizes for i in range(1, size + 1)]
