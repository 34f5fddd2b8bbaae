"""The FMU of MuJoCo models: of a file, or of our own plant's scenes."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import mujoco

from ...assets import asset_files
from ...assets.arm import change_arm, saved
from ...assets.arm import written as written_spec
from ...assets.franka import DEFAULT_ROBOT
from ...plant.mujoco_warnings import taken_warnings
from ..atomic import cache_folder, cached, temporary_folder
from ..build.description import NOTHING
from ..build.engines import sparse_fault
from ..build.identity import digest
from ..build.native import NativeFmu
from ..errors import InputError, located, one_line, refuse
from ..interface.variables import Interface, Variable
from ..processes import last_line, run
from .mjcf_interface import (
    SECTIONS,
    TABLES,
    Description,
    default_description,
    interface,
    read_description,
    suggestions,
    written,
)
from .mjcf_sources import Sources

Warn = Callable[[str], object]
MODEL_SUFFIX: Final = ".mjb"
MODEL: Final = f"model{MODEL_SUFFIX}"
MAGIC: Final = (54321).to_bytes(4, "little")  # first bytes of a file of this suffix
STEPS: Final = 1000  # of a model's default experiment
LONGEST_STEP: Final = 1.0  # [s]


@dataclass(frozen=True)
class ModelOptions:
    """Options for the interface of a model's FMU."""

    keyframe: str = ""  # to start at; "": the interface file's, or qpos0
    inputs: Sequence[str] = ()  # sources of further inputs
    outputs: Sequence[str] = ()  # sources of further outputs
    parameters: Sequence[str] = ()  # sources of further parameters
    interface: Path | None = None  # TOML file with the interface, instead of the default one
    step: float = 0.0  # [s]; 0: the model's own


def model_fmu(
    path: Path, options: ModelOptions, name: str = "", warn: Warn | None = None
) -> NativeFmu:
    """Describe the FMU of a model."""
    if not 0.0 <= options.step <= LONGEST_STEP:
        refuse("--step", options.step, f"must be above 0 s, and at most {LONGEST_STEP:g} s")
    model = load(path, warn)
    model.opt.timestep = options.step or model.opt.timestep
    fmu = _fmu(path, model, options, name or path.stem)
    return replace(fmu, again=partial(model_fmu, path, options, name))


def model_part(path: Path, robot: str = DEFAULT_ROBOT, asked: object = "") -> NativeFmu:
    """Describe the FMU of a scenario's model, by the TOML file of the same name beside it."""
    # Without one, it has the default interface and starts at the keyframe `home`, if there is one.
    # Start values are those of the keyframe that the scenario asks for, if it is one of the
    # model's. The arm of `assets` in it is the robot's.
    model = load(path, robot=robot)
    keys = [model.key(i).name for i in range(model.nkey)]
    key = str(asked) if asked in filter(None, keys) else ""
    options = ModelOptions(key or ("home" if "home" in keys else ""))
    if (beside := path.with_suffix(".toml")).is_file():
        options = ModelOptions(key, interface=beside)
    again = partial(model_part, path, robot, asked)
    return replace(_fmu(path, model, options, path.stem), again=again)


def describe(path: Path, options: ModelOptions, warn: Warn | None = None) -> str:
    """The interface that a model's FMU would have, as TOML."""
    model = load(path, warn)
    return written(_described(model, options, path.stem), suggestions(model))


def _fmu(path: Path, model: Any, options: ModelOptions, stem: str) -> NativeFmu:
    if model.nplugin:
        _refuse_plugins(path)
    description = _described(model, options, stem)
    with located(options.interface or path):
        table = interface(description, model)
        fmu = mujoco_fmu(table, {"model": model}, TABLES["law"], description.keyframe)
        _refuse_shared_inputs(fmu.interface)
    return fmu


def _refuse_plugins(path: Path) -> None:
    """Refuse a model with plugins: their libraries know the MuJoCo of this Python alone."""
    names = {"of unknown names"}
    if path.suffix.lower() != MODEL_SUFFIX:
        spec = _spec(path)
        spec.compile()
        names = set(re.findall(' plugin="(.*?)"', spec.to_xml()))
    what = f"uses plugins, {', '.join(sorted(names))}, which FMUs cannot hold"
    raise InputError(f"{path}: {what}; must be a model of MuJoCo's own elements")


def _refuse_shared_inputs(table: Interface) -> None:
    """Refuse two inputs for one element of MuJoCo's data, of which the last would win."""
    by_place: dict[tuple[str, int], str] = {}
    for variable in table.of("input"):
        field, first = variable.source.rsplit(maxsplit=1)
        for i in range(variable.size):
            other = by_place.setdefault((field, int(first) + i), variable.name)
            if other != variable.name:
                what = variable.details[i] if variable.details else variable.source
                must = "must be one of them: an interface file chooses all inputs"
                raise InputError(f"inputs {other} and {variable.name} both set {what}; {must}")


def _described(model: Any, options: ModelOptions, stem: str) -> Description:
    if options.interface is not None:
        description = read_description(options.interface)
    else:
        description = default_description(model, re.sub(r"^(?=\d)|\W", "_", stem, flags=re.A))
    description.keyframe = options.keyframe or description.keyframe
    for section in SECTIONS:
        for source in getattr(options, section):
            description.add(section, source)
    return description


# The FMU.


def mujoco_fmu(
    interface: Interface, models: Mapping[str, Any], law: str, keyframe: str = "",
    stop_time: float = 0.0,
) -> NativeFmu:  # fmt: skip
    """Describe an FMU that steps a MuJoCo model."""
    sources = [Sources(model, keyframe) for model in models.values()]
    key, step = sources[0].key, float(sources[0].model.opt.timestep)  # equal in all
    variables = tuple(_resolved(variable, sources) for variable in interface.variables)
    options = [("model", f"{name}{MODEL_SUFFIX}") for name in models]
    options += [("key", str(key))] if key >= 0 else []
    files = {f"{name}{MODEL_SUFFIX}": saved(model) for name, model in models.items()}
    resolved = replace(interface, variables=variables)
    faults = sparse_fault() if any(map(_is_sparse, models.values())) else ()
    return NativeFmu(resolved, "mujoco", law, files, tuple(options), step_size=step,
                     stop_time=stop_time or STEPS * step, needs=(NOTHING, *faults))  # fmt: skip


def _is_sparse(model: Any) -> bool:
    return bool(mujoco.mj_isSparse(model)) and model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON


def _resolved(variable: Variable, sources: Sequence[Sources]) -> Variable:
    """Replace the names in a source by the ids that the backend reads."""
    first, *others = (source.find(variable.causality, variable.source) for source in sources)
    assert all(other.source == first.source for other in others), variable.source
    size = min(row.size for row in (first, *others))
    if variable.size > size:
        raise InputError(
            f"{variable.name}: {variable.size} elements; {variable.source!r} has {size}"
        )
    words = first.source.split()
    if words[0] == "jac" and len(variable.shape) == 2:  # only as many columns as the table's
        words = words[: 3 + variable.shape[1]]
    return replace(variable, source=" ".join(words))


# The model.


def load(path: Path, warn: Warn | None = None, robot: str = DEFAULT_ROBOT) -> Any:
    """Load a model with all its files; an MJCF may include those of `assets` by their names."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with taken_warnings() as texts:
            if path.suffix.lower() == MODEL_SUFFIX:
                model = load_binary(path.read_bytes(), str(path))
            else:  # files beside the model go first: MuJoCo would take those that it is given
                model = mujoco.MjModel.from_xml_path(str(path), _assets_for(path))
                if robot != DEFAULT_ROBOT:
                    model = _with_arm(path, robot).compile()
                _fill_keyframes(model, path)
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise InputError(f"{path}: MuJoCo cannot load it: {one_line(error)}") from error
    if warn is not None:
        for text in texts:
            warn(f"{path}: MuJoCo warns: {one_line(text)}")
    return model


def _assets_for(path: Path) -> dict[str, bytes]:
    return {n: c for n, c in asset_files().items() if not (path.parent / n).exists()}


def _spec(path: Path) -> Any:
    ours = _assets_for(path)
    return mujoco.MjSpec.from_file(str(path), include=ours, assets=ours)


def _with_arm(path: Path, robot: str) -> Any:
    spec = _spec(path)
    change_arm(spec, robot, asset_files())
    return spec


def mjcf_of(path: Path, robot: str) -> str:
    """Return a model that `load` loads, in one file, for another version of MuJoCo."""
    try:
        spec = _with_arm(path, robot)
        spec.compile()
        text = written_spec(spec, load(path, robot=robot))
        mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        must = "must be MJCF without files of meshes, heights or pictures"
        raise InputError(f"{path}: {must}: {one_line(error)}") from error
    return text


# What a damaged model says is where its parts are can end the process that uses them.
_TRY: Final = """
import sys, mujoco
model = mujoco.MjModel.from_binary_path(sys.argv[1])
mujoco.mj_forward(model, mujoco.MjData(model))
"""


def load_binary(content: bytes, place: str) -> Any:
    """Load a model that MuJoCo saved (.mjb), once a process of its own has tried it."""
    made = int.from_bytes(content[12:16], "little")  # as `mj_version` tells it
    if content.startswith(MAGIC) and made != mujoco.mj_version():
        version = f"{made // 1_000_000}.{made // 1000 % 1000}.{made % 1000}"
        must = f"{mujoco.__version__} reads only what it compiled itself; must be the MJCF"
        raise InputError(f"{place}: compiled by MuJoCo {version}, and {must}")

    mark = cache_folder() / "models" / digest(content, mujoco.__version__)[:24]
    cached(mark, partial(_try, content, place))
    return mujoco.MjModel.from_binary_path(MODEL, {MODEL: content})


def _try(content: bytes, place: str) -> bytes:
    with temporary_folder(cache_folder()) as folder:
        (folder / MODEL).write_bytes(content)
        done = run([sys.executable, "-P", "-c", _TRY, MODEL], folder)
    if done.returncode:
        said = last_line(done.stderr).partition(": ")[2]  # by an exception
        why = said if done.returncode > 0 else f"it ends with signal {-done.returncode}"
        raise InputError(f"{place}: MuJoCo cannot load it: {one_line(why)}")
    return b""


def _fill_keyframes(model: Any, path: Path) -> None:
    """Fill keyframes that are shorter than qpos with qpos0; before 3.15, MuJoCo takes zeros."""
    if model.nkey and mujoco.mj_version() < 3_015_000 and path.suffix.lower() == ".xml":
        spec = _spec(path)  # its keys are gone with it
        for key, row in zip(spec.keys, model.key_qpos, strict=False):  # <size nkey> may add some
            row[len(key.qpos) :] = model.qpos0[len(key.qpos) :]
