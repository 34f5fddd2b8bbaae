"""The project's own FMUs: the plant, the controller and the trajectory, of either kind."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ...assets import SCENES, asset_files
from ...plant.parameters import PlantParameters
from ..interface.controller import CONTROLLER
from ..interface.plant import PLANT
from ..interface.trajectory import TABLE_FILE, TRAJECTORY
from .compile import this_platform
from .libraries import mujoco_version, sources_digest

if TYPE_CHECKING:
    from .build import Target
    from .native import NativeFmu

INSTANCES: Final = ("plant", "controller")
KEYFRAME: Final = "home"  # start of the scenes


@dataclass(frozen=True)
class Recipe:
    """An FMU for one target; its description is made only if it has to be built.

    Attributes:
        model: Model name.
        content: Hash of the description's sources.
        describe: Function that makes the description.
        target: Kind, FMI version and platforms.
    """

    model: str
    content: str
    describe: Callable[[], NativeFmu]
    target: Target

    @property
    def platforms(self) -> tuple[str, ...]:
        """Platforms that it contains libraries for."""
        return self.target.platforms or (this_platform(),)

    @property
    def key(self) -> str:
        """Hash of everything that its bytes depend on."""
        parts = (self.content, self.target.fmi, self.platforms)
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    def build(self) -> bytes:
        """Make the .fmu file."""
        return self.describe().build(self.target.fmi, self.platforms)


def recipe(name: str, target: Target) -> Recipe:
    """Return the FMU of an instance, for `build`.

    Args:
        name: One of `INSTANCES`, or "sensors", which is in Python for either kind.
        target: Kind, FMI version and platforms.
    """
    if name == "sensors" or target.kind == "python":
        return _python(name, target)
    backend, table, describe = _NATIVE[name]
    described_from = _digest(backend, repr(table), *asset_files().values(), _code(f"../../{name}"))
    return Recipe(table.model, described_from, describe, target)


def recipe_of_trajectory(table: bytes, target: Target) -> Recipe:
    """Return the FMU that plays commands, for `build_trajectory`.

    Args:
        table: Rows of commands as little-endian doubles.
        target: Kind, FMI version and platforms.
    """
    if target.kind == "python":
        return _python("trajectory", target, {TABLE_FILE: table})

    def describe() -> NativeFmu:
        from ..slaves.trajectory import TrajectorySlave  # noqa: PLC0415 - rarely built
        from .native import NativeFmu  # noqa: PLC0415 - only to build

        law = TrajectorySlave.__doc__ or ""
        return NativeFmu(TRAJECTORY, "player", law, {TABLE_FILE: table}, (("table", TABLE_FILE),))

    return Recipe(TRAJECTORY.model, _digest("player", repr(TRAJECTORY), table), describe, target)


def recipe_of(fmu: NativeFmu, target: Target) -> Recipe:
    """Return an FMU that is not one of the project's own, for `build_one`."""
    return Recipe(
        fmu.model, _digest(fmu.backend, fmu.digest, repr(fmu.options)), lambda: fmu, target
    )


def _python(name: str, target: Target, resources: Mapping[str, bytes] | None = None) -> Recipe:
    """An FMU of the Python kind."""
    from .bundle import BUNDLES, SENSORS_BUNDLE, TRAJECTORY_BUNDLE  # noqa: PLC0415 - rarely built
    from .python_fmu import bundle_fmu, python_key  # noqa: PLC0415 - see above

    bundle = {**BUNDLES, "sensors": SENSORS_BUNDLE, "trajectory": TRAJECTORY_BUNDLE}[name]
    given = resources or {}
    content = _digest("python", bundle.package, python_key(), *given, *given.values())
    return Recipe(bundle.model, content, lambda: bundle_fmu(bundle, given), target)


def _plant() -> NativeFmu:
    from ...plant.plant import Plant  # noqa: PLC0415 - MuJoCo takes 0.1 s
    from ...plant.scene import load_scene  # noqa: PLC0415 - see above
    from .mjcf import mujoco_fmu  # noqa: PLC0415 - see above

    models = {scene: load_scene(PlantParameters(scene=scene)) for scene in SCENES}
    return mujoco_fmu(PLANT, models, Plant.__doc__ or "", KEYFRAME)


def _controller() -> NativeFmu:
    from ...controller.controller import Controller  # noqa: PLC0415 - MuJoCo takes 0.1 s
    from ...controller.model import arm_mjb  # noqa: PLC0415 - see above
    from .native import NativeFmu  # noqa: PLC0415 - only to build

    return NativeFmu(CONTROLLER, "controller", Controller.__doc__ or "", {"arm.mjb": arm_mjb()})


_NATIVE: Final = {
    "plant": ("mujoco", PLANT, _plant),
    "controller": ("controller", CONTROLLER, _controller),
}


def _digest(backend: str, *parts: str | bytes) -> str:
    """Hash of an FMU's sources, of the code that packs it and of the packages used."""
    content = hashlib.sha256(sources_digest(backend).encode())
    versions = (version("panda-cosim"), mujoco_version())
    for part in (*parts, *versions, _code("."), _code("../interface")):
        content.update(part.encode() if isinstance(part, str) else part)
        content.update(b"\0")
    return content.hexdigest()


@cache
def _code(folder: str) -> bytes:
    """Hash of the files in one of the project's folders."""
    content = hashlib.sha256()
    for path in sorted((Path(__file__).parent / folder).rglob("*")):
        if path.suffix in (".py", ".j2", ".png"):
            content.update(path.name.encode() + b"\0" + path.read_bytes())
    return content.digest()
