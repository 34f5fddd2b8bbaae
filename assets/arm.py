"""The MJCF of arm and scenes, with the numbers of one of the robots."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np

from . import asset_files
from .franka import DEFAULT_ROBOT

DIGITS: Final = 17  # that tell all numbers apart
NOT_USED = [float("nan")] * 6  # of `fullinertia`, where a body has principal axes


def read_spec(name: str, robot: str) -> Any:
    """Read an MJCF file (`mujoco.MjSpec`) with the arm of a robot."""
    files = asset_files()
    spec = mujoco.MjSpec.from_string(files[name].decode(), include=files, assets=files)
    change_arm(spec, robot, files)
    return spec


def saved(model: Any) -> bytes:
    """Return a model as MJB, which includes its meshes and textures."""
    embed = getattr(mujoco, "mj_embedAssets", lambda whole: whole)  # always embedded before 3.15
    whole = embed(model)
    buffer = np.empty(mujoco.mj_sizeModel(whole), np.uint8)
    mujoco.mj_saveModel(whole, None, buffer)
    return buffer.tobytes()


def written(spec: Any, model: Any) -> str:
    """Return a compiled spec as MJCF that gives the same model, bit for bit, elsewhere."""
    for key, row in zip(spec.keys, model.key_qpos, strict=False):  # <size nkey> may add some
        key.qpos = row
    library = ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("*mujoco.*"))))
    usual = library._mjPRIVATE__get_xml_precision()
    library._mjPRIVATE__set_xml_precision(DIGITS)
    try:
        return str(spec.to_xml())
    finally:
        library._mjPRIVATE__set_xml_precision(usual)


def change_arm(spec: Any, robot: str, files: Mapping[str, bytes]) -> None:
    """Put a robot's numbers, from its own MJCF file, in place of the Panda's, if there is one."""
    if robot == DEFAULT_ROBOT or spec.body("link7") is None:
        return
    numbers = mujoco.MjSpec.from_string(files[f"{robot}.xml"].decode())
    for i in range(1, 8):
        body, own = spec.body(f"link{i}"), numbers.body(f"link{i}")
        body.fullinertia = NOT_USED
        body.mass, body.inertia, body.ipos, body.iquat = own.mass, own.inertia, own.ipos, own.iquat
        joint, own = spec.joint(f"joint{i}"), numbers.joint(f"joint{i}")
        joint.range, joint.armature = own.range, own.armature
        joint.damping, joint.frictionloss = own.damping, own.frictionloss
        servo = spec.actuator(f"actuator{i}")
        if servo is not None and servo.biastype != mujoco.mjtBias.mjBIAS_NONE:
            servo.ctrlrange = own.range
