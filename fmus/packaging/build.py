"""Builds the project's FMUs, or takes them from the cache."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..atomic import cache_folder, cached, replacing
from ..errors import InputError
from ..interface.trajectory import TRAJECTORY
from ..processes import threads
from .compile import this_platform
from .libraries import own_licences
from .panda import INSTANCES, Recipe, recipe, recipe_of, recipe_of_trajectory

if TYPE_CHECKING:
    from .native import NativeFmu

Kind = Literal["native", "python"]
COMMAND_COLUMNS: Final = sum(variable.size for variable in TRAJECTORY.of("output"))


@dataclass(frozen=True)
class Target:
    """Kind of FMUs, and FMI version and platforms that they are built for.

    Attributes:
        kind: "native": compiled, need nothing; "python": run this project's Python code.
        fmi: Major version of FMI, 2 or 3.
        platforms: Keys of `compile.PLATFORMS`; empty: this one.
    """

    kind: Kind = "native"
    fmi: int = 2
    platforms: tuple[str, ...] = ()


def outdated(names: Iterable[str] = INSTANCES, target: Target | None = None) -> list[str]:
    """Model names of the FMUs that `build` would have to build."""
    found = [recipe(name, target or Target()) for name in names]
    return [fmu.model for fmu in found if not _place(fmu).is_file()]


def build(
    names: Iterable[str] = INSTANCES, out: Path | None = None, target: Target | None = None
) -> dict[str, Path]:
    """Build those FMUs that the cache does not hold.

    Args:
        names: Instances, of `INSTANCES`.
        out: Folder to copy them to; None: they stay in the cache only.
        target: Kind, FMI version and platforms; None: native, FMI 2, this platform.

    Returns:
        The path of each FMU, by instance.

    Raises:
        InputError: The folder cannot be written, or there is no compiler.
        CosimError: An FMU cannot be built.
    """
    fmus = {name: recipe(name, target or Target()) for name in names}
    with threads() as pool:
        paths = dict(zip(fmus, pool.map(_cached, fmus.values()), strict=True))
    if out is None:
        return paths
    return {name: copied(path, out / path.name) for name, path in paths.items()}


def build_trajectory(
    commands: NDArray[np.float64], path: Path | None = None, target: Target | None = None
) -> Path:
    """Build the FMU that plays commands.

    Args:
        commands: Commands (n, 14), one row per millisecond from t = 0 on; the columns are the
            outputs of `fmus.interface.trajectory.TRAJECTORY`.
        path: The file; None: in the cache.
        target: Kind, FMI version and platforms; None: native, FMI 2, this platform.

    Returns:
        Its path.

    Raises:
        InputError: The commands are not finite or not of this shape, or the folder cannot be
            written.
        CosimError: It cannot be built.
    """
    if commands.ndim != 2 or commands.shape[1] != COMMAND_COLUMNS or not len(commands):
        raise InputError(f"commands: shape {commands.shape}; must be (n, {COMMAND_COLUMNS})")
    if not np.isfinite(commands).all():
        row, column = np.argwhere(~np.isfinite(commands))[0]
        raise InputError(f"commands: row {row}, column {column} is not finite")
    table = commands.astype("<f8").tobytes()
    built = _cached(recipe_of_trajectory(table, target or Target()))
    return built if path is None else copied(built, path)


def build_one(fmu: NativeFmu) -> Path:
    """Build an FMU that is not one of the project's own, for FMI 2.0 and this machine.

    Returns:
        Its path in the cache.

    Raises:
        CosimError: It cannot be built.
    """
    return _cached(recipe_of(fmu, Target()))


def write_one(fmu: NativeFmu, path: Path, fmi: int = 2, platforms: Sequence[str] = ()) -> Path:
    """Build an FMU that is not one of the project's own, and write it to a file.

    Args:
        fmu: The FMU.
        path: The file.
        fmi: Major version of FMI, 2 or 3.
        platforms: Keys of `compile.PLATFORMS`; empty: this one.

    Returns:
        The path.

    Raises:
        InputError: The file cannot be written, or there is no compiler for a platform.
        CosimError: It cannot be built.
    """
    content = fmu.build(fmi, tuple(platforms) or (this_platform(),))
    _put(path, content)
    return path


def copied(built: Path, path: Path) -> Path:
    """Copy an FMU out of the cache.

    Returns:
        The copy's path.

    Raises:
        InputError: It cannot be written.
    """
    _put(path, built.read_bytes())
    return path


def _put(path: Path, content: bytes) -> None:
    """Write a file whole or, on a full disk for instance, not at all."""
    folder = next((p for p in path.parents if p.exists()), path.parent)
    if not folder.is_dir():
        raise InputError(f"{folder}: not a folder; must be a folder or a new name")
    with replacing(path) as partial:
        partial.write_bytes(content)


def _place(fmu: Recipe) -> Path:
    """Path of an FMU in the cache."""
    content = hashlib.sha256(b"\0".join((fmu.key.encode(), *own_licences().values())))
    return cache_folder() / content.hexdigest()[:24] / f"{fmu.model}.fmu"


def _cached(fmu: Recipe) -> Path:
    return cached(_place(fmu), fmu.build)
