"""Makes a native FMU from MuJoCo models and a description of its interface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import mujoco
import numpy as np

from ..build.native import NativeFmu
from ..errors import InputError
from ..interface.variables import Interface, Variable
from .mjcf_sources import Sources

MODEL_SUFFIX: Final = ".mjb"
STEP_MIN: Final = 1e-9  # [s] an FMU takes as many steps as its master's is long
STEP_MAX: Final = 1e6  # [s]


def mujoco_fmu(
    interface: Interface, models: Mapping[str, Any], law: str, keyframe: str = ""
) -> NativeFmu:
    """Describe an FMU that steps a MuJoCo model."""
    for name, model in models.items():
        _check_model(name, model)
    keys = {_key(name, model, keyframe) for name, model in models.items()}
    steps = {float(model.opt.timestep) for model in models.values()}
    if len(keys) > 1 or len(steps) > 1:
        raise InputError("models of one FMU must have equal time steps and numbers of keyframes")
    key = keys.pop()
    sources = [Sources(model, key) for model in models.values()]
    variables = tuple(_resolved(variable, sources) for variable in interface.variables)
    options = [("model", f"{name}{MODEL_SUFFIX}") for name in models]
    options += [("key", str(key))] if key >= 0 else []
    files = {f"{name}{MODEL_SUFFIX}": saved(model) for name, model in models.items()}
    resolved = replace(interface, variables=variables)
    return NativeFmu(resolved, "mujoco", law, files, tuple(options), step_size=steps.pop())


def saved(model: Any) -> bytes:
    """Return a model as MJB, which includes its meshes and textures."""
    whole = mujoco.mj_embedAssets(model)
    buffer = np.empty(mujoco.mj_sizeModel(whole), np.uint8)
    mujoco.mj_saveModel(whole, None, buffer)
    return buffer.tobytes()


def _check_model(name: str, model: Any) -> None:
    if model.nplugin:
        raise InputError(f"{name}: uses {model.nplugin} plugins, which FMUs do not support")
    step = float(model.opt.timestep)
    if not STEP_MIN <= step <= STEP_MAX:
        raise InputError(
            f"{name}: timestep: value {step!r} s; must be a number from {STEP_MIN:g} to "
            f"{STEP_MAX:g} s"
        )


def _key(name: str, model: Any, keyframe: str) -> int:
    if not keyframe:
        return -1
    key = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, keyframe))
    if key < 0:
        keys = (mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_KEY, i) for i in range(model.nkey))
        valid = ", ".join(filter(None, keys)) or "none"
        raise InputError(f"{name}: no keyframe {keyframe!r}; valid: {valid}")
    return key


def _resolved(variable: Variable, sources: Sequence[Sources]) -> Variable:
    """Replace the names in a source by the ids that the backend reads."""
    first, *others = (source.find(variable.causality, variable.source) for source in sources)
    if any(other.source != first.source for other in others):
        raise InputError(f"{variable.name}: {variable.source!r} differs between the models")
    size = min(row.size for row in (first, *others))
    if variable.size > size:
        raise InputError(
            f"{variable.name}: {variable.size} elements; {variable.source!r} has {size}"
        )
    words = first.source.split()
    if words[0] == "jac" and len(variable.shape) == 2:  # only as many columns as the table's
        words = words[: 3 + variable.shape[1]]
    return replace(variable, source=" ".join(words))
