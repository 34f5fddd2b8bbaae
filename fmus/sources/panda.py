"""The project's own FMUs, of either kind: plant, controller, trajectory and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Final

from ...assets import SCENES
from ...plant.parameters import PlantParameters
from ..build.native import NativeFmu
from ..interface.controller import CONTROLLER
from ..interface.plant import PLANT
from ..interface.sensors import SENSORS
from ..interface.trajectory import TABLE_FILE, TRAJECTORY
from ..interface.variables import Interface
from .python_fmu import code_of, python_fmu

KEYFRAME: Final = "home"  # start of the scenes
ROOT: Final = Path(__file__).parents[2]  # the folder of `assets`, `fmus` and the others
_ARM: Final = ("arm.xml", "panda.xml", "shells.xml")


@dataclass(frozen=True)
class _Own:
    """One of the project's own FMUs."""

    interface: Interface
    slave: tuple[str, str]  # module and class of the slave in Python
    law: tuple[str, str]  # module and class whose docstring says what the FMU computes
    assets: tuple[str, ...] = _ARM  # files of `assets` that the slave needs besides its modules
    needs: tuple[str, ...] = ("numpy", "mujoco")  # packages that the slave needs

    @property
    def text(self) -> str:
        module, name = self.law
        return getattr(import_module(f"panda_cosim.{module}"), name).__doc__ or ""


_TRAJECTORY_SLAVE: Final = ("fmus.inside.trajectory", "TrajectorySlave")
_FMUS: Final = MappingProxyType({
    "plant": _Own(PLANT, ("fmus.inside.plant", "PlantSlave"), ("plant.plant", "Plant"),
                  ("*.xml",)),
    "controller": _Own(CONTROLLER, ("fmus.inside.controller", "ControllerSlave"),
                       ("controller.controller", "Controller")),
    "sensors": _Own(SENSORS, ("fmus.inside.sensors", "SensorsSlave"),
                    ("controller.sensors", "Sensors")),
    "trajectory": _Own(TRAJECTORY, _TRAJECTORY_SLAVE, _TRAJECTORY_SLAVE, (), ("numpy",)),
})  # fmt: skip


def own_fmu(
    name: str, *, in_python: bool, commands: bytes = b"", changed: Mapping[str, bytes] | None = None
) -> NativeFmu:
    """Describe one of the project's own FMUs."""
    own = _FMUS[name]
    table = {TABLE_FILE: commands} if commands else {}
    if in_python:
        code = own_code(name) | dict(changed or {})
        return python_fmu(own.interface, own.text, code, own.slave, own.needs, resources=table)
    if name == "plant":
        return _plant(own)
    if name == "controller":
        from ...controller.model import arm_mjb  # noqa: PLC0415 - MuJoCo takes 0.1 s

        return NativeFmu(CONTROLLER, "controller", own.text, {"arm.mjb": arm_mjb()})
    return NativeFmu(TRAJECTORY, "player", own.text, table, (("table", TABLE_FILE),))


def own_code(name: str) -> dict[str, bytes]:
    """Contents by path, such as `plant/scene.py`, of what the slave of an own FMU needs."""
    own = _FMUS[name]
    code = code_of(ROOT / f"{own.slave[0].replace('.', '/')}.py", ROOT)
    files = (file for pattern in own.assets for file in sorted((ROOT / "assets").glob(pattern)))
    return code | {f"assets/{file.name}": file.read_bytes() for file in files}


def _plant(own: _Own) -> NativeFmu:
    from ...plant.scene import load_scene  # noqa: PLC0415 - MuJoCo takes 0.1 s
    from .model_fmu import mujoco_fmu  # noqa: PLC0415 - see above

    models = {scene: load_scene(PlantParameters(scene=scene)) for scene in SCENES}
    return mujoco_fmu(PLANT, models, own.text, KEYFRAME)
