"""Makes an FMU from a model's file, for `panda-cosim mjcf2fmu` and for scenarios."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import mujoco

from ...assets import asset_files
from ..errors import InputError
from ..messages import one_line
from ..processes import SAFE_PATH, run
from .build import write_one
from .mjcf import mujoco_fmu
from .mjcf_interface import (
    SECTIONS,
    Description,
    default_description,
    interface,
    read_description,
    suggestions,
    written,
)
from .mujoco_warnings import taken_warnings
from .native import NativeFmu

Warn = Callable[[str], object]


def ignore(_text: str) -> None:
    """Do nothing with a warning."""


LAW: Final = """\
The MuJoCo model that is packed in resources/, stepped at its own time step.

Outputs belong to the instant of qpos, except for those that the acceleration stage computes
(actuator forces, accelerations, sensors of these): they belong to the last step, and are 0 at the
start.
"""


@dataclass(frozen=True)
class ModelOptions:
    """Options for the interface of a model's FMU.

    Attributes:
        keyframe: Keyframe to start at; "": the interface file's, or qpos0.
        inputs: Sources of further inputs.
        outputs: Sources of further outputs.
        parameters: Sources of further parameters.
        interface: TOML file with the interface, instead of the default one.
    """

    keyframe: str = ""
    inputs: Sequence[str] = ()
    outputs: Sequence[str] = ()
    parameters: Sequence[str] = ()
    interface: Path | None = None


def model_fmu(  # noqa: PLR0913 - a build has this many options
    path: Path,
    out: Path,
    options: ModelOptions,
    fmi: int = 2,
    platforms: Sequence[str] = (),
    warn: Warn = ignore,
) -> Path:
    """Make an FMU of a model.

    Args:
        path: MJCF, URDF or MJB file.
        out: The FMU to write. Its name is the model's, unless the interface file names another.
        options: Options for the interface.
        fmi: Major version of FMI.
        platforms: Keys of `compile.PLATFORMS`; empty: this one.
        warn: Is called with each of MuJoCo's warnings about the model.

    Returns:
        The FMU.

    Raises:
        InputError: A file cannot be read or written, or MuJoCo refuses the model.
        CosimError: The FMU cannot be built.
    """
    model = load(path, warn)
    description = _described(model, options, out.stem)
    made = interface(description, model)
    fmu = mujoco_fmu(made, {"model": model}, LAW, description.keyframe)
    return write_one(fmu, out, fmi, platforms)


def model_part(path: Path) -> NativeFmu:
    """Describe the FMU of a model that a scenario names.

    A TOML file of the same name beside it describes the interface. Without one, the FMU has the
    default interface and starts at the keyframe `home`, if there is one.

    Raises:
        InputError: A file cannot be read, or MuJoCo refuses the model.
    """
    model = load(path)
    beside = path.with_suffix(".toml")
    keys = [model.key(i).name for i in range(model.nkey)]
    options = ModelOptions(
        "home" if "home" in keys and not beside.is_file() else "",
        interface=beside if beside.is_file() else None,
    )
    description = _described(model, options, path.stem)
    made = interface(description, model)
    return mujoco_fmu(made, {"model": model}, LAW, description.keyframe)


def describe(path: Path, options: ModelOptions, warn: Warn = ignore) -> str:
    """The interface that a model's FMU would have, as TOML."""
    model = load(path, warn)
    return written(_described(model, options, path.stem), suggestions(model))


def load(path: Path, warn: Warn = ignore) -> Any:
    """Load a model with all its files; an MJCF may include those of `assets` by their names.

    Args:
        path: MJCF, URDF or MJB file.
        warn: Is called with each of MuJoCo's warnings.

    Raises:
        InputError: MuJoCo refuses it.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    binary = path.suffix.lower() == ".mjb"
    if binary:
        state = path.stat()
        _try_binary(path, state.st_size, state.st_mtime_ns)
    try:
        with taken_warnings() as texts:
            if binary:
                model = mujoco.MjModel.from_binary_path(str(path))
            else:  # files beside the model go first: MuJoCo would take those that it is given
                ours = {n: c for n, c in asset_files().items() if not (path.parent / n).exists()}
                model = mujoco.MjModel.from_xml_path(str(path), ours)
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        if not binary and not _is_xml(path):
            raise InputError(f"{path}: is not an MJCF file (XML)") from error
        raise InputError(f"{path}: MuJoCo refuses it: {one_line(error)}") from error
    for text in texts:
        warn(f"{path}: MuJoCo warns: {one_line(text)}")
    return model


_TRIAL: Final = """
import resource, sys
limits = {resource.RLIMIT_AS: 4 << 30, resource.RLIMIT_CPU: 10, resource.RLIMIT_CORE: 0}
for kind, most in limits.items():
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (most if hard < 0 else min(most, hard), hard))
import mujoco
mujoco.set_mju_user_warning(str)
try:
    model = mujoco.MjModel.from_binary_path(sys.argv[1])
    mujoco.mj_step(model, mujoco.MjData(model), 10)
except Exception as error:
    sys.exit(str(error))
"""


@lru_cache
def _try_binary(path: Path, _size: int, _changed: int) -> None:
    """Load and step a binary model in another process, with 4 GB of memory and 10 s.

    MuJoCo trusts such files: a damaged one may crash it, or take all memory.

    Raises:
        InputError: It does not end well.
    """
    command = [sys.executable, "-c", _TRIAL, str(path.absolute())]
    done = run(command, environment=os.environ | SAFE_PATH)
    if done.returncode > 0:
        raise InputError(f"{path}: MuJoCo refuses it: {one_line(done.stderr)}")
    if done.returncode:
        end = signal.Signals(-done.returncode).name
        raise InputError(f"{path}: is damaged: MuJoCo ends with {end} when it loads it")


def _is_xml(path: Path) -> bool:
    """Whether a file begins as XML does."""
    with path.open("rb") as file:
        return file.read(4096).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")


def _described(model: Any, options: ModelOptions, stem: str) -> Description:
    if options.interface is not None:
        description = read_description(options.interface)
    else:
        name = re.sub(r"\W", "_", stem, flags=re.A)
        description = default_description(model, name if not name[:1].isdigit() else f"_{name}")
    description.keyframe = options.keyframe or description.keyframe
    for section in SECTIONS:
        for source in getattr(options, section):
            description.add(section, source)
    return description
