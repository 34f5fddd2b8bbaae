"""Builds FMUs into the cache, where later calls find them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import NDArray

from ...assets import SCENES, STEP_SIZE
from ...assets.franka import ROBOTS
from ...assets.limits import LIMIT_FILES
from ...plant.parameters import PlantParameters
from ..atomic import cache_folder, cached
from ..build.description import STOP_TIME, Layout
from ..build.engines import made_with
from ..build.identity import code_digest, digest
from ..build.libraries import own_licences
from ..build.platforms import this_platform
from ..errors import InputError
from ..interface.controller import CONTROLLER
from ..interface.franka import FRANKA
from ..interface.plant import PLANT
from ..interface.sensors import SENSORS
from ..interface.tables import TABLE_FILE, TRAJECTORY
from ..interface.variables import Interface
from ..twins import ROOT, changed

if TYPE_CHECKING:
    from ..build.native import NativeFmu

Kind = Literal["auto", "native", "python", "pythonfmu"]
INSTANCES: Final = ("plant", "controller")
ONLY_PYTHON: Final = ("sensors", "franka")
HOSTED: Final = ("franka",)  # not by PythonFMU, whose wrapper does not end a simulation


@dataclass(frozen=True)
class Target:
    """Kind of FMUs, and FMI version and platforms that they are built for."""

    # "native": compiled, and needs nothing; "python": runs this project's Python code, as does
    # "pythonfmu" in PythonFMU's wrapper; "auto": native while it is proven equal, see `twins`.
    kind: Kind = "auto"
    fmi: int = 2  # major version of FMI, 2 or 3
    platforms: tuple[str, ...] = ()  # keys of `platforms.PLATFORMS`; empty: this one
    scalars: bool = False  # FMI 3.0 without arrays
    flat: bool = False  # names such as `q_1` instead of `q[1]`
    mujoco: str = ""  # version of MuJoCo in those that have one; empty: the installed one

    def __post_init__(self) -> None:
        """Refuse what PythonFMU cannot make."""
        if self.kind == "pythonfmu" and (self.fmi != 2 or self.platforms):
            raise InputError(
                "kind pythonfmu: PythonFMU makes FMUs of FMI 2.0, for its own platforms; kind "
                "python has others"
            )

    def kind_of(self, name: str) -> Kind:
        """Kind of one of the project's own FMUs; some run Python code in any."""
        if self.kind in ("python", "pythonfmu") and name not in HOSTED:
            return self.kind
        is_python = name in ONLY_PYTHON or (self.kind == "auto" and changed(name))
        return "python" if is_python else "native"

    def make(self, fmu: NativeFmu) -> bytes:
        """Make the .fmu file."""
        if self.mujoco and fmu.again is not None:
            return made_with(
                self.mujoco, partial(replace(self, mujoco="")._make_described, fmu.again)
            )
        layout = Layout(self.fmi, self.scalars, self.flat)
        return fmu.build(layout, self.platforms or (this_platform(),))

    def _make_described(self, describe: Callable[[], NativeFmu]) -> bytes:
        return self.make(describe())


def build(names: Iterable[str] = INSTANCES, target: Target | None = None) -> dict[str, Path]:
    """Build those of the project's own FMUs that the cache does not hold."""
    return {name: _own(name, target or Target()) for name in names}


def build_trajectory(commands: NDArray[np.float64], target: Target | None = None) -> Path:
    """Build the FMU that plays commands (n, 14), in the cache."""
    return _own("trajectory", target or Target(), commands.astype("<f8").tobytes())


def build_fmu(fmu: NativeFmu, target: Target | None = None) -> Path:
    """Build an FMU that is not one of the project's own, in the cache."""
    chosen = target or Target()
    place = _place(fmu.model, chosen, fmu.digest, repr(fmu.recorded))
    return cached(place, lambda: chosen.make(fmu))


def outdated(target: Target | None = None) -> list[str]:
    """Model names of the project's own FMUs that `build` would have to build."""
    places = {name: _own_place(name, target or Target()) for name in INSTANCES}
    return [OWN[name].interface.model for name, place in places.items() if not place.is_file()]


def _own(name: str, target: Target, commands: bytes = b"") -> Path:
    def make() -> bytes:
        fmu = own_fmu(name, target.kind_of(name), commands=commands)
        rows = len(commands) // (8 * sum(v.size for v in TRAJECTORY.of("output")))
        return target.make(replace(fmu, stop_time=(rows - 1) * STEP_SIZE) if rows > 1 else fmu)

    return cached(_own_place(name, target, commands), make)


def _own_place(name: str, target: Target, commands: bytes = b"") -> Path:
    """Place in the cache; found without making the description, which takes time."""
    python = ""
    if target.kind_of(name) != "native":
        from .python_fmu import recorded_python, require_pythonfmu  # noqa: PLC0415 - few have one

        python = target.kind_of(name) + require_pythonfmu() + repr(recorded_python())
    return _place(OWN[name].interface.model, target, code_digest(), commands, python)


def _place(model: str, target: Target, *content: str | bytes) -> Path:
    """Place in the cache of an FMU that depends on the content."""
    shape = (target.fmi, target.platforms or (this_platform(),), target.scalars, target.flat,
             target.mujoco)  # fmt: skip
    name = digest(model, repr(shape), own_licences(), *content)
    return cache_folder() / name[:24] / f"{model}.fmu"


# What the project's own FMUs consist of.


@dataclass(frozen=True)
class Own:
    """One of the project's own FMUs; modules and classes are by name, as few calls load them."""

    interface: Interface
    slave: tuple[str, str]  # module and class of the slave in Python
    # Files of `assets` that the slave needs.
    assets: tuple[str, ...] = ("arm.xml", "panda.xml", "fr3.xml", "shells.xml")
    needs: tuple[str, ...] = ("numpy", "mujoco")  # packages that the slave needs
    is_restorable: bool = True  # whether its state can be saved and restored


OWN: Final = MappingProxyType({
    "plant": Own(PLANT, ("fmus.inside.plant", "PlantSlave"), ("*.xml",)),
    "controller": Own(CONTROLLER, ("fmus.inside.controller", "ControllerSlave")),
    "sensors": Own(SENSORS, ("fmus.inside.sensors", "SensorsSlave")),
    "franka": Own(FRANKA, ("fmus.inside.franka", "FrankaSlave"), is_restorable=False),
    "trajectory": Own(TRAJECTORY, ("fmus.inside.trajectory", "TrajectorySlave"), (), ("numpy",)),
})  # fmt: skip


def own_fmu(name: str, kind: Kind = "native", *, commands: bytes = b"") -> NativeFmu:
    """Describe one of the project's own FMUs."""
    # These modules take time to import, and are needed only for what the cache has not.
    own = OWN[name]
    table = {TABLE_FILE: commands} if commands else {}
    if kind != "native":
        from .packed_fmu import packed_fmu  # noqa: PLC0415 - see above
        from .python_fmu import PYTHONFMU, python_fmu  # noqa: PLC0415 - see above

        code = own_code(name)
        if kind == PYTHONFMU:
            return packed_fmu(own.interface, code, own.slave, own.needs, table)
        needs = (*own.needs, PYTHONFMU)
        made = python_fmu(own.interface, "", code, own.slave, needs, resources=table)
        return replace(made, is_restorable=own.is_restorable)
    again = partial(own_fmu, name)
    if name == "plant":
        from ...plant.scene import load_scene  # noqa: PLC0415 - see above
        from .model_fmu import mujoco_fmu  # noqa: PLC0415 - see above

        chosen = product(ROBOTS, SCENES)  # as the parameters `scene` and `robot` choose
        models = {f"{r}_{s}": load_scene(PlantParameters(robot=r, scene=s)) for r, s in chosen}
        return replace(mujoco_fmu(PLANT, models, "", "home", STOP_TIME), again=again)
    from ..build.native import NativeFmu  # noqa: PLC0415 - see above

    if name == "controller":
        from ...controller.model import arm_mjb  # noqa: PLC0415 - see above

        arms = {f"{robot}.mjb": arm_mjb(robot) for robot in ROBOTS}
        return NativeFmu(CONTROLLER, "controller", "", arms, again=again)
    return NativeFmu(TRAJECTORY, "player", "", table, (("table", TABLE_FILE),))


def own_code(name: str) -> dict[str, bytes]:
    """Contents by path, such as `plant/scene.py`, of what the slave of an own FMU needs."""
    from .python_fmu import code_of  # noqa: PLC0415 - see `own_fmu`

    own = OWN[name]
    code = code_of(ROOT / f"{own.slave[0].replace('.', '/')}.py", ROOT)
    assets = map("assets/{}".format, (*own.assets, *map("{}.toml".format, LIMIT_FILES)))
    beside = (str(Path(file).with_suffix(".toml")) for file in code)  # a module's table
    files = (file for name in (*assets, *beside) for file in sorted(ROOT.glob(name)))
    return code | {file.relative_to(ROOT).as_posix(): file.read_bytes() for file in files}
