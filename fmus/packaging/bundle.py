"""The project's code that an FMU in Python carries, as a package with a unique name.

A host's Python has one table of modules, so an FMU that imported `plant` could get the host's
`plant`, or another FMU's. Each FMU therefore carries its code as one package, whose name contains
a hash of the content; imports are relative and stay inside it.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from .python_source import parse

ROOT: Final = Path(__file__).parents[2]  # the folder of `assets`, `fmus` and the others


@dataclass(frozen=True)
class Bundle:
    """The contents of an FMU in Python.

    Attributes:
        model: Model name of the FMU, such as `PandaPlant`.
        slave: Module and class of the slave.
        law: Module and class whose docstring describes what the FMU computes.
        data: Glob patterns of files that it needs besides its modules.
        needs: Third-party packages that it needs.
        extra: Paths and contents of files that replace the project's.
    """

    model: str
    slave: tuple[str, str]
    law: tuple[str, str]
    data: tuple[str, ...] = ()
    needs: tuple[str, ...] = ("numpy", "mujoco")
    extra: tuple[tuple[str, bytes], ...] = ()

    def files(self) -> dict[str, bytes]:
        """Return contents by path, such as `plant/scene.py`.

        They are the modules that the slave imports, directly or indirectly.
        """
        replaced = dict(self.extra)
        found: dict[str, bytes] = {}
        waiting = [self.slave[0]]
        while waiting:
            path = _module_path(waiting.pop())
            if path is not None and path not in found:
                found[path] = replaced.get(path) or _read(path)
                waiting += _imports(path, found[path].decode())
        for pattern in self.data:
            package, _, rest = pattern.partition("/")
            for file in sorted((ROOT / package).glob(rest)):
                found[f"{package}/{file.name}"] = file.read_bytes()
        return found | replaced

    @property
    def package(self) -> str:
        """Name of the package that holds the FMU's code, with a hash of its content."""
        return package_name(self.model, self.files())

    def resources(self) -> dict[str, bytes]:
        """Contents of the package by path in the FMU's resources."""
        return packed(self.package, self.files())


def package_name(model: str, files: Mapping[str, bytes]) -> str:
    """Name of the package with an FMU's code: the model's name and a hash of the content."""
    content = hashlib.sha256()
    for path, data in sorted(files.items()):
        content.update(f"{path}\0{len(data)}\0".encode())
        content.update(data)
    return f"{model.lower()}_{content.hexdigest()[:12]}"


def packed(package: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Files of a package by path in the FMU's resources, with any missing `__init__.py`."""
    made = {f"{package}/__init__.py": b'"""The code of one FMU."""\n'}
    return made | {f"{package}/{path}": content for path, content in files.items()}


def _read(path: str) -> bytes:
    return (ROOT / path).read_bytes()


def _module_path(module: str) -> str | None:
    """Path of a module, such as `plant/scene.py`; None if there is no such module."""
    stem = module.replace(".", "/")
    names = (f"{stem}.py", f"{stem}/__init__.py")
    return next((name for name in names if (ROOT / name).is_file()), None)


def _imports(path: str, source: str) -> Iterator[str]:
    """Yield the names that a module imports and that may be modules of the project."""
    folders = path.split("/")[:-1]
    yield from (".".join(folders[: i + 1]) for i in range(len(folders)))  # its packages
    for node in ast.walk(parse(source, path)):
        if isinstance(node, ast.ImportFrom) and node.level:
            package = folders[: len(folders) - node.level + 1]
            module = ".".join([*package, *([node.module] if node.module else [])])
            yield module  # a name that is imported from a package may be a module, too
            yield from (f"{module}.{alias.name}" for alias in node.names)


PLANT_BUNDLE = Bundle(
    "PandaPlant",
    ("fmus.slaves.plant", "PlantSlave"),
    ("plant.plant", "Plant"),
    ("assets/*.xml",),
)
CONTROLLER_BUNDLE = Bundle(
    "PandaController",
    ("fmus.slaves.controller", "ControllerSlave"),
    ("controller.controller", "Controller"),
    ("assets/arm.xml", "assets/panda.xml", "assets/shells.xml"),
)
TRAJECTORY_BUNDLE = Bundle(
    "PandaTrajectory",
    ("fmus.slaves.trajectory", "TrajectorySlave"),
    ("fmus.slaves.trajectory", "TrajectorySlave"),
    needs=("numpy",),
)
SENSORS_BUNDLE = Bundle(
    "PandaSensors",
    ("fmus.slaves.sensors", "SensorsSlave"),
    ("controller.sensors", "Sensors"),
    CONTROLLER_BUNDLE.data,
)
BUNDLES = MappingProxyType({"plant": PLANT_BUNDLE, "controller": CONTROLLER_BUNDLE})
