"""A run as an MCAP file of Foxglove's messages, which Foxglove, rerun and MCAP's tools open.

Topics: `/joint_states`, the poses of all bodies in `/tf` (frame `world`), their shapes once in
`/scene`, the signals of each FMU as JSON in `/FMU`, and events and the verdict in `/log`. Times are
simulated ones, from 0. Quaternions are (x, y, z, w) there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from ...fmus.atomic import check_replaceable, replacing
from ...fmus.extras import needing
from ...result.judging.summary import Summary
from ...result.recording import Recording
from ...task.files import model_file
from ..pictures.motion import refuse_without_model
from .columns import Json
from .page import plant_parameters

NS: Final = 1_000_000_000
WORLD: Final = "world"


def write_mcap(recording: Recording, path: Path, rate: float, *, overwrite: bool = False) -> int:
    """Write a run's file, with so many messages a second of each topic; return their instants."""
    with needing("foxglove-sdk", "logs", f"{path}"):
        import foxglove  # noqa: PLC0415 - an extra
        from foxglove import channels  # noqa: PLC0415
    check_replaceable(path, overwrite=overwrite)
    step = float(np.diff(recording.time[:2])[0]) if recording.rows > 1 else 1.0
    rows = range(0, recording.rows, max(round(1.0 / (rate * step)), 1))
    model, context = _model_of(recording), foxglove.Context()
    with replacing(path) as partial, foxglove.open_mcap(
        partial, allow_overwrite=True, context=context
    ):  # fmt: skip
        log = channels.LogChannel("/log", context=context)
        for at, message in _events(recording):
            log.log(message, log_time=at)
        for name, columns in _by_fmu(recording).items():
            channel = foxglove.Channel(f"/{name}", message_encoding="json", context=context)
            for at, message in _values(recording, name, columns, rows):
                channel.log(message, log_time=at)
        if model is not None:
            scene = channels.SceneUpdateChannel("/scene", context=context)
            scene.log(_shapes(model), log_time=_nanoseconds(recording.time[0]))
            joints = channels.JointStatesChannel("/joint_states", context=context)
            poses = channels.FrameTransformsChannel("/tf", context=context)
            for at, states, transforms in _motion(recording, model, rows):
                joints.log(states, log_time=at)
                poses.log(transforms, log_time=at)
    return len(rows)


def _values(
    recording: Recording, fmu: str, columns: Sequence[str], rows: Sequence[int]
) -> Iterator[tuple[int, Json]]:
    """Yield instant [ns] and values of an FMU's columns."""
    values = {column: recording[f"{fmu}.{column}"].tolist() for column in columns}
    for row in rows:
        message = {column: each[row] for column, each in values.items()}
        yield _nanoseconds(recording.time[row]), message


def _model_of(recording: Recording) -> Any:
    """Return the plant's model (`mujoco.MjModel`); None: no plant's motion is recorded."""
    if "plant.qpos[1]" not in recording:
        return None
    from ...fmus.sources.model_fmu import load  # noqa: PLC0415 - imports MuJoCo
    from ...plant.scene import load_scene  # noqa: PLC0415 - imports MuJoCo

    if own := model_file(recording):
        return load(own)
    refuse_without_model(recording)
    return load_scene(plant_parameters(recording.metadata), drawn=True)


def _nanoseconds(time: float) -> int:
    return round(float(time) * NS)


def _stamp(nanoseconds: int) -> Any:
    from foxglove.messages import Timestamp  # noqa: PLC0415 - an extra

    return Timestamp(*divmod(nanoseconds, NS))


def _by_fmu(recording: Recording) -> dict[str, list[str]]:
    """Return the columns of each FMU, without its name."""
    found = defaultdict[str, list[str]](list)
    for column in recording.types:
        instance, dot, name = column.partition(".")
        if dot:
            found[instance].append(name)
    return found


def _events(recording: Recording) -> Iterator[tuple[int, Any]]:
    from foxglove.messages import Log, LogLevel  # noqa: PLC0415 - an extra

    summary = Summary.of(recording)
    for name, time in summary.events.items():
        if time is not None:
            at = _nanoseconds(time)
            yield at, Log(timestamp=_stamp(at), level=LogLevel.Info, message=name, name="event")
    at = _nanoseconds(recording.time[-1])
    level = LogLevel.Info if summary.as_expected else LogLevel.Error
    yield at, Log(timestamp=_stamp(at), level=level, message=summary.brief, name="verdict")


def _motion(
    recording: Recording, model: Any, rows: Sequence[int]
) -> Iterator[tuple[int, Any, Any]]:
    """Yield instant [ns], joints and poses of all bodies, by forward kinematics."""
    import mujoco  # noqa: PLC0415 - slow to import
    from foxglove import messages as fox  # noqa: PLC0415 - an extra

    data = mujoco.MjData(model)
    qpos, qvel = recording["plant.qpos"], recording["plant.qvel"]
    bodies = [model.body(number) for number in range(1, model.nbody)]
    single = [j for j in map(model.joint, range(model.njnt)) if len(j.qpos0) == 1]
    for row in rows:
        at = _nanoseconds(recording.time[row])
        data.qpos[:] = qpos[row]
        mujoco.mj_kinematics(model, data)
        states = [
            fox.JointState(name=joint.name, position=float(qpos[row, joint.qposadr[0]]),
                           velocity=float(qvel[row, joint.dofadr[0]]))
            for joint in single
        ]  # fmt: skip
        transforms = [
            fox.FrameTransform(
                timestamp=_stamp(at), parent_frame_id=WORLD, child_frame_id=_name(body),
                translation=fox.Vector3(**_parts("xyz", data.xpos[body.id])),
                rotation=fox.Quaternion(**_parts("wxyz", data.xquat[body.id])),
            )
            for body in bodies
        ]  # fmt: skip
        joints = fox.JointStates(timestamp=_stamp(at), joints=states)
        yield at, joints, fox.FrameTransforms(transforms=transforms)


def _name(body: Any) -> str:
    return body.name or f"body {body.id}"


def _parts(names: str, values: Any) -> dict[str, float]:
    return dict(zip(names, map(float, values), strict=True))


def _shapes(model: Any) -> Any:
    """Return the shapes of all bodies but planes and meshes, which move with the bodies' frames."""
    from foxglove import messages as fox  # noqa: PLC0415 - an extra

    from .model import describe  # noqa: PLC0415 - imports MuJoCo

    round_ends: dict[str, float] = {"bottom_scale": 1.0, "top_scale": 1.0}
    kinds: dict[str, tuple[str, Any, Sequence[int], dict[str, float]]] = {
        "box": ("cubes", fox.CubePrimitive, (0, 1, 2), {}),  # axes of its size
        "sphere": ("spheres", fox.SpherePrimitive, (0, 0, 0), {}),
        "ellipsoid": ("spheres", fox.SpherePrimitive, (0, 1, 2), {}),
        "cylinder": ("cylinders", fox.CylinderPrimitive, (0, 0, 1), round_ends),
        "capsule": ("cylinders", fox.CylinderPrimitive, (0, 0, 1), round_ends),  # without its ends
    }
    entities = []
    bodies: Any = describe(model)["bodies"]
    for number, body in enumerate(bodies):
        shapes: Any = defaultdict(list)
        for shape in (each for each in body["shapes"] if each["kind"] in kinds):
            name, primitive, axes, ends = kinds[shape["kind"]]
            size = fox.Vector3(**_parts("xyz", [2.0 * shape["size"][axis] for axis in axes]))
            position = fox.Vector3(**_parts("xyz", shape["pos"]))
            turn = fox.Quaternion(**_parts("wxyz", shape["quat"]))
            pose = fox.Pose(position=position, orientation=turn)
            colour = fox.Color(**_parts("rgba", shape["rgba"]))
            shapes[name].append(primitive(size=size, pose=pose, color=colour, **ends))
        frame = _name(model.body(number)) if number else WORLD
        if shapes:
            entities.append(fox.SceneEntity(id=frame, frame_id=frame, frame_locked=True, **shapes))
    return fox.SceneUpdate(entities=entities)
