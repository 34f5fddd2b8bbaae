"""The code that an FMU in Python carries: the project's own, under a name that is the FMU's alone.

A host's Python has one table of modules. An FMU that imported `plant` would run the host's
`plant`, or another FMU's. So each FMU carries its code as one package whose name holds the
content's hash; imports are relative and stay inside it.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

ROOT: Final = Path(__file__).parents[2]  # the folder of `assets`, `fmus` and the others


@dataclass(frozen=True)
class Bundle:
    """What goes into an FMU.

    Attributes:
        model: Model name of the FMU, as `PandaPlant`.
        slave: Module and class of the slave.
        law: Module and class whose docstring tells what is computed.
        data: Glob patterns of files that it needs and does not import.
        needs: Packages from elsewhere that it needs.
        extra: Paths and contents of files in place of the project's.
    """

    model: str
    slave: tuple[str, str]
    law: tuple[str, str]
    data: tuple[str, ...] = ()
    needs: tuple[str, ...] = ("numpy", "mujoco")
    extra: tuple[tuple[str, bytes], ...] = ()

    def files(self) -> dict[str, bytes]:
        """Return contents by path, as `plant/scene.py`.

        All modules that the slave imports, and those that they import.
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
    """Name of the package that holds an FMU's code: the model's, and a hash of the content."""
    content = hashlib.sha256()
    for path, data in sorted(files.items()):
        content.update(f"{path}\0{len(data)}\0".encode())
        content.update(data)
    return f"{model.lower()}_{content.hexdigest()[:12]}"


def packed(package: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Files of a package by path in the FMU's resources, with those that make it a package."""
    made = {f"{package}/__init__.py": b'"""The code of one FMU."""\n'}
    return made | {f"{package}/{path}": content for path, content in files.items()}


def _read(path: str) -> bytes:
    return (ROOT / path).read_bytes()


def _module_path(module: str) -> str | None:
    """Path of a module, as `plant/scene.py`; None if there is none of this name."""
    stem = module.replace(".", "/")
    names = (f"{stem}.py", f"{stem}/__init__.py")
    return next((name for name in names if (ROOT / name).is_file()), None)


def _imports(path: str, source: str) -> Iterator[str]:
    """Names of what may be modules of the project that one of its modules imports."""
    folders = path.split("/")[:-1]
    yield from (".".join(folders[: i + 1]) for i in range(len(folders)))  # its packages
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.level:
            package = folders[: len(folders) - node.level + 1]
            module = ".".join([*package, *([node.module] if node.module else [])])
            yield module  # and what is imported from a package may be a module
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
    ("assets/panda.xml", "assets/shells.xml"),
)
TRAJECTORY_BUNDLE = Bundle(
    "PandaTrajectory",
    ("fmus.slaves.trajectory", "TrajectorySlave"),
    ("fmus.slaves.trajectory", "TrajectorySlave"),
    needs=("numpy",),
)
BUNDLES = MappingProxyType({"plant": PLANT_BUNDLE, "controller": CONTROLLER_BUNDLE})
