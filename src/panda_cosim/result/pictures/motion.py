"""The motion for pictures: frame times, key moments, poses between rows.

Plain numpy; it needs neither a renderer nor a simulation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter
from textwrap import shorten
from typing import Final

import numpy as np

from ...assets import SCENES
from ...assets.fields import Array
from ...fmus.errors import InputError
from ...fmus.interface.tables import INTERFACES
from ...plant.parameters import PlantParameters
from ...result.judging.holds import Hold, find_holds, first_collision
from ...result.recording import Recording
from ...result.recording.reader import shapes_of
from ...task import rotations
from ...task.fields import check_choice
from ...task.files import model_file

_DRAWN: Final = {"plant": ("qpos", "qvel", "hand_xpos", "actuator_force", "contact_force"),
                 "controller": ("pos_cmd", "grip_cmd")}  # fmt: skip
SHAPES: Final[Mapping[str, tuple[int, ...]]] = {  # of the drawn signals, per row
    f"{fmu}.{n}": INTERFACES[fmu].variable(n).shape for fmu, names in _DRAWN.items() for n in names
}
BLOCK_QUAT = slice(12, 16)  # of the block's orientation in qpos (w, x, y, z)

GRIP_TIME = 0.3  # [s] time the gripper needs to close on the block, or to open
REASON_LENGTH = 80  # characters of an error's message in a title
APART = 0.05  # [s] least distance: closer moments look alike


@dataclass(frozen=True)
class Moment:
    """An instant worth a picture."""

    time: float  # [s]
    label: str = ""  # what happens then


def check_signals(recording: Recording, names: Iterable[str]) -> None:
    """Refuse a recording without rows, or with signals that are smaller than in our own scenes."""
    place = getattr(recording, "path", "recording")
    if not len(recording.time):
        raise InputError(f"{place}: no rows; must have at least one to be drawn")
    shapes = shapes_of(tuple(recording.columns))
    for name in names:
        shape, own = shapes.get(name), SHAPES[name]
        if shape is None or len(shape) != len(own) or shape < own:
            raise InputError(f"{place}: {name}: shape {shape} per row; must be {own}")


def position_columns(recording: Recording) -> list[str]:
    """Columns of the plant's positions that are drawn."""
    names = [name for name in recording.columns if name.partition("[")[0] == "plant.qpos"]
    if model_file(recording) is not None:
        return names
    refuse_without_model(recording)
    check_signals(recording, ["plant.qpos"])
    return names[: SHAPES["plant.qpos"][0]]  # of a scene with further bodies the first


def poses(recording: Recording, at: Array) -> Array:
    """Return qpos (k, nq) at instants (k,), see `interpolate_qpos`; reads a column at a time."""
    time = recording.time
    after = np.clip(np.searchsorted(time, at, side="right"), 1, max(len(time) - 1, 1))
    rows = np.unique(np.minimum([after - 1, after], len(time) - 1))
    columns = [recording[name][rows] for name in position_columns(recording)]
    return interpolate_qpos(time[rows], np.column_stack(columns), at)


def has_model(recording: Recording) -> bool:
    """Whether a run's plant is the project's own, or has a model."""
    fmus = recording.metadata.get("fmus", {})
    is_ours = not fmus or fmus.get("plant", {}).get("model") == INTERFACES["plant"].model
    return is_ours or model_file(recording) is not None


def refuse_without_model(recording: Recording) -> None:
    """Refuse a run that cannot be drawn."""
    if not has_model(recording):
        raise InputError(
            "the run's plant is not the project's own, and its FMU holds no model: nothing can be "
            "drawn but the plot; pictures show the FMU `plant`, if it was made from a MuJoCo model"
        )


def scene_of(recording: Recording) -> str:
    """Return the name of a recording's scene, or the path of its model."""
    if model := model_file(recording):
        return str(model.resolve())
    return check_choice("scene", recording.metadata.get("scene", PlantParameters.scene), SCENES)


def describe_run(recording: Recording) -> tuple[str, str]:
    """Return the title of a run's pictures: what ran, for how long, and whether to its end."""
    metadata = recording.metadata
    title = str(metadata.get("scenario") or "run").replace("_", " ")
    details = [f"{recording.time[-1] - recording.time[0]:.2f} s"]
    details += [str(metadata[key]) for key in ("scene", "coupling") if metadata.get(key)]
    if metadata.get("complete") is False:
        reason = str(metadata.get("reason") or "stopped early")
        details.append(f"incomplete: {shorten(reason, REASON_LENGTH, placeholder='...')}")
    return title, " · ".join(details)


def frame_times(time: Array, fps: float) -> Array:
    """Return the instants (k,) [s] of a video's frames: k/fps from the first row on."""
    # A frame is shown for 1/fps, so 6.5 s at 30 fps are 195 frames, the last of them at 6.467 s.
    count = max(1, round(float(time[-1] - time[0]) * fps))
    return np.asarray(time[0] + np.arange(count) / fps)


def slerp(quat_from: Array, quat_to: Array, share: Array) -> Array:
    """Turn unit quaternions (n, 4) (w, x, y, z) by a share (n,) of the shorter arc to others."""
    turn = rotations.log(rotations.multiply(quat_to, rotations.conjugate(quat_from)))
    quat = rotations.multiply(rotations.exp(share[:, None] * turn), quat_from)
    return np.asarray(quat / np.linalg.norm(quat, axis=1, keepdims=True))


def interpolate_qpos(time: Array, qpos: Array, at: Array) -> Array:
    """Return qpos (k, nq) at instants (k,): linear between rows (n, nq), the block by slerp."""
    if len(time) == 1:
        return np.repeat(qpos, len(at), axis=0)
    row = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    share = np.clip((at - time[row]) / (time[row + 1] - time[row]), 0, 1)
    before, after = qpos[row], qpos[row + 1]
    result = before + share[:, None] * (after - before)
    if qpos.shape[1] == SHAPES["plant.qpos"][0]:  # of our own scenes
        result[:, BLOCK_QUAT] = slerp(before[:, BLOCK_QUAT], after[:, BLOCK_QUAT], share)
    return np.asarray(result)


def key_moments(recording: Recording, count: int) -> list[Moment]:
    """Return up to `count` key instants: labelled ones, then halves of the longest gaps."""
    time = recording.time
    begin, end = float(time[0]), float(time[-1])
    labelled = [Moment(begin, "start"), Moment(end, "end")]
    for hold in find_holds(recording):
        labelled += _hold_moments(time, hold)
    if (collision := first_collision(recording)) is not None:
        labelled.append(Moment(float(time[collision]), "collision"))
    moments: list[Moment] = []
    for moment in sorted(labelled, key=attrgetter("time")):
        since = moment.time - moments[-1].time if moments else math.inf
        if begin <= moment.time <= end and since > APART:
            moments.append(moment)
    if len(moments) > count:
        chosen = np.linspace(0, len(moments) - 1, count).round().astype(int)
        return [moments[index] for index in chosen]
    return _with_more(moments, count)


def _with_more(moments: list[Moment], count: int) -> list[Moment]:
    """Add instants in the middle of the longest gaps."""
    while 2 <= len(moments) < count:
        gaps = [later.time - earlier.time for earlier, later in pairwise(moments)]
        longest = int(np.argmax(gaps))
        if gaps[longest] <= 2 * APART:
            break
        moments.insert(longest + 1, Moment(moments[longest].time + gaps[longest] / 2))
    return moments


def _hold_moments(time: Array, hold: Hold) -> Iterator[Moment]:
    """Yield the moments around one hold of the block; the instants are the summary's."""
    grasp, last = float(time[hold.grasp]), len(time) - 1
    yield Moment(grasp - GRIP_TIME, "reach")
    yield Moment(grasp, "grasp")
    command = float(time[min(hold.let_go, last)])
    if hold.lift is not None:
        lift = float(time[hold.lift])
        yield Moment(lift, "lift")
        yield Moment((lift + command) / 2, "carry")
    if hold.end <= last:
        release = float(time[hold.end])
        if hold.release_command is not None:
            yield Moment(command, "set down")
        yield Moment(release, "release")
        yield Moment(release + GRIP_TIME, "leave")
