"""The code that an FMU carries: the project's own, under a name that is the FMU's alone.

A host's Python has one table of modules. An FMU that imported `plant` would run the host's
`plant`, or another FMU's. So each FMU carries its code as one package whose name holds the
content's hash. The project's imports are relative and stay inside it; PythonFMU's are made to.
"""

from __future__ import annotations

import ast
import hashlib
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Final

ROOT: Final = Path(__file__).parents[2]  # the folder of `assets`, `fmus` and the others
# Imported by the script, and by name.
_ALWAYS: Final = ("fmus.slaves.hosting", "fmus.slaves.standin")
_PYTHONFMU = ("_version.py", "default_experiment.py", "enums.py",
              "fmi2slave.py", "logmsg.py", "variables.py")  # fmt: skip
_PYTHONFMU_IMPORT = re.compile(r"^(\s*)(from|import) pythonfmu\b", re.MULTILINE)


@dataclass(frozen=True)
class Bundle:
    """What goes into an FMU.

    Attributes:
        model: Model name of the FMU, as `PandaPlant`.
        slave: Module and class of the slave.
        law: Module and class whose docstring tells what is computed.
        data: Glob patterns of files that it needs and does not import.
        needs: Packages from elsewhere that it needs.
        extra: Paths and contents of further files, or in place of the project's.
    """

    model: str
    slave: tuple[str, str]
    law: tuple[str, str]
    data: tuple[str, ...] = ()
    needs: tuple[str, ...] = ("numpy", "mujoco")
    extra: tuple[tuple[str, bytes], ...] = ()

    def files(self) -> dict[str, bytes]:
        """Return contents by path, as `plant/scene.py`, before any rewriting.

        All modules that the slave imports, and those that they import.
        """
        replaced = dict(self.extra)
        found: dict[str, bytes] = {}
        waiting = [self.slave[0], *_ALWAYS]
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
    def digest(self) -> str:
        """Hash of all that decides what the FMU does, as 64 hexadecimal digits."""
        return _digest(self)

    @property
    def package(self) -> str:
        """Name of the package that holds the FMU's code."""
        return f"{self.model.lower()}_{self.digest[:12]}"

    def private_files(self) -> Iterator[tuple[str, bytes]]:
        """Yield paths below the package and contents, imports rewritten."""
        yield "__init__.py", b'"""The code of one FMU."""\n'
        for path, content in self.files().items():
            yield path, self._privatise(path, content)
        yield "pythonfmu/__init__.py", b""  # its own would import the builder
        for name in _PYTHONFMU:
            content = (_pythonfmu_folder() / name).read_bytes()
            yield f"pythonfmu/{name}", self._privatise(name, content)

    def script(self) -> str:
        """Source of the script that PythonFMU starts from."""
        module, name = self.slave
        return f'''"""{self.model}, packaged by panda-cosim.

The importer runs this file twice at each instantiation; the class is made once.
"""

from {self.package}.fmus.slaves import hosting

hosting.enter(globals())
if "{self.model}" in globals():
    {self.model} = globals()["{self.model}"]
else:

    class {self.model}(
        hosting.slave_class("{self.package}.{module}", "{name}", {self.needs!r}, RESOURCES)
    ):
        """The slave, under the name that the importer sees."""
'''

    def _privatise(self, path: str, content: bytes) -> bytes:
        if not path.endswith(".py"):
            return content
        return _PYTHONFMU_IMPORT.sub(rf"\1\2 {self.package}.pythonfmu", content.decode()).encode()


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


def _pythonfmu_folder() -> Path:
    import pythonfmu  # noqa: PLC0415 - heavy, and only needed for a build

    return Path(pythonfmu.__file__).parent


@cache
def _digest(bundle: Bundle) -> str:
    from importlib.metadata import version  # noqa: PLC0415 - 10 ms

    content = hashlib.sha256()
    made_with = (
        bundle.model,
        bundle.needs,
        version("pythonfmu"),
        sys.platform,
        sys.version_info[:2],
    )
    content.update(repr(made_with).encode())
    own = {f"fmus/packaging/{name}": _read(f"fmus/packaging/{name}")
           for name in ("binary.py", "bundle.py", "build.py", "description.py", "document.py",
                        "plant.png", "controller.png", "trajectory.png")}  # fmt: skip
    for path, data in sorted((bundle.files() | own).items()):
        content.update(f"{path}\0{len(data)}\0".encode())
        content.update(data)
    return content.hexdigest()


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
