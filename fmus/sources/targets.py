"""Builds FMUs into the cache, where later calls find them, or into files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..atomic import cache_folder, cached, replacing
from ..build.compile import this_platform
from ..build.libraries import code_digest, digest, own_licences
from ..interface.controller import CONTROLLER
from ..interface.plant import PLANT
from ..interface.sensors import SENSORS
from ..interface.trajectory import TRAJECTORY

if TYPE_CHECKING:
    from ..build.native import NativeFmu

Kind = Literal["native", "python"]
INSTANCES: Final = ("plant", "controller")
MODELS: Final = {"plant": PLANT.model, "controller": CONTROLLER.model, "sensors": SENSORS.model,
                 "trajectory": TRAJECTORY.model}  # fmt: skip


@dataclass(frozen=True)
class Target:
    """Kind of FMUs, and FMI version and platforms that they are built for."""

    kind: Kind = "native"  # compiled, and needs nothing; "python": runs this project's Python code
    fmi: int = 2  # major version of FMI, 2 or 3
    platforms: tuple[str, ...] = ()  # keys of `compile.PLATFORMS`; empty: this one

    def in_python(self, name: str) -> bool:
        """Whether one of the project's own FMUs runs Python code; the sensors do in either kind."""
        return self.kind == "python" or name == "sensors"

    def make(self, fmu: NativeFmu) -> bytes:
        """Make the .fmu file."""
        return fmu.build(self.fmi, self.platforms or (this_platform(),))


def build(
    names: Iterable[str] = INSTANCES, out: Path | None = None, target: Target | None = None
) -> dict[str, Path]:
    """Build those of the project's own FMUs that the cache does not hold."""
    fmus = {name: _own(name, target or Target()) for name in names}
    if out is None:
        return fmus
    return {name: _put(out / path.name, path.read_bytes()) for name, path in fmus.items()}


def build_trajectory(
    commands: NDArray[np.float64], path: Path | None = None, target: Target | None = None
) -> Path:
    """Build the FMU that plays commands (n, 14), in the cache or as a file."""
    built = _own("trajectory", target or Target(), commands.astype("<f8").tobytes())
    return built if path is None else _put(path, built.read_bytes())


def build_fmu(fmu: NativeFmu, path: Path | None = None, target: Target | None = None) -> Path:
    """Build an FMU that is not one of the project's own, in the cache or as a file."""
    chosen = target or Target()
    if path is not None:
        return _put(path, chosen.make(fmu))
    place = _place(fmu.model, chosen, fmu.digest, repr(fmu.recorded))
    return cached(place, lambda: chosen.make(fmu))


def outdated(names: Iterable[str] = INSTANCES, target: Target | None = None) -> list[str]:
    """Model names of the project's own FMUs that `build` would have to build."""
    places = {name: _own_place(name, target or Target()) for name in names}
    return [MODELS[name] for name, place in places.items() if not place.is_file()]


def _own(name: str, target: Target, commands: bytes = b"") -> Path:
    def make() -> bytes:
        from .panda import own_fmu  # noqa: PLC0415 - only to build

        return target.make(own_fmu(name, in_python=target.in_python(name), commands=commands))

    return cached(_own_place(name, target, commands), make)


def _own_place(name: str, target: Target, commands: bytes = b"") -> Path:
    """Place in the cache; found without making the description, which takes time."""
    python = ""
    if target.in_python(name):
        from .python_fmu import recorded_python  # noqa: PLC0415 - few runs have one

        python = repr(recorded_python())
    return _place(MODELS[name], target, code_digest(), target.kind, commands, python)


def _place(model: str, target: Target, *content: str | bytes) -> Path:
    """Place in the cache of an FMU that depends on the content."""
    platforms = target.platforms or (this_platform(),)
    name = digest(model, repr((target.fmi, platforms)), own_licences(), *content)
    return cache_folder() / name[:24] / f"{model}.fmu"


def _put(path: Path, content: bytes) -> Path:
    """Write a file whole or, on a full disk for instance, not at all."""
    with replacing(path) as partial:
        partial.write_bytes(content)
    return path
