"""How an FMU's code starts in any host: run first, before anything that is not pure Python.

PythonFMU's wrapper runs the slave script of an FMU twice at each instantiation, in whatever
process the importer is. This module makes that safe, and finds numpy and MuJoCo there.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import ExtensionFileLoader, ModuleSpec

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import MutableMapping

# Nothing else is imported here: most of the standard library loads extension modules, which
# some hosts cannot do before _open_python.

MIN_PYTHON = (3, 11)
NEEDS = {"numpy": (2, 3), "mujoco": (4, 0)}  # lowest versions, as in pyproject.toml
PATHS_FILE = "python_packages.txt"  # in resources/: package folders of the Python that built
PATHS_VARIABLE = "PANDA_COSIM_PYTHONPATH"


def enter(namespace: dict[str, object]) -> None:
    """Begin a slave script.

    Args:
        namespace: The script's globals.
    """
    _open_python()
    resources = _take_path(str(namespace["__name__"]))
    namespace.setdefault("RESOURCES", resources)
    _keep(namespace)


def slave_class(module: str, name: str, needs: tuple[str, ...], resources: str) -> type:
    """Import a slave's class, or one that tells why it cannot be.

    Args:
        module: The module's full name.
        name: Name of the class.
        needs: Packages that it needs, keys of `NEEDS`.
        resources: The FMU's resources folder.
    """
    try:
        _find_packages(needs, resources)
        found: type = getattr(import_module(module), name)
    except Exception as error:
        standin = import_module(f"{__package__}.standin")
        trace = import_module("traceback").format_exc()
        found = standin.stand_in(_reason(error, needs, resources), trace)
    return found


def _open_python() -> None:
    """Let extension modules see Python's symbols in a host that has loaded them privately.

    The wrapper's library brings libpython along, but for itself alone: numpy and even the
    standard library's extension modules would not load. Opening it again makes it global.
    """
    if not sys.platform.startswith("linux"):
        return
    name = f"/libpython{sys.version_info[0]}.{sys.version_info[1]}"
    with open("/proc/self/maps", "rb") as maps:  # noqa: PTH123 - pathlib is not safe yet
        mapped = [line.split(maxsplit=5)[-1] for line in maps if name.encode() in line]
    if not mapped:  # Python is part of the host's executable, and global
        return
    path = mapped[0].decode().strip()
    flags = sys.getdlopenflags()
    sys.setdlopenflags(0x102)  # RTLD_GLOBAL | RTLD_NOW; os is not safe yet
    try:
        loader = ExtensionFileLoader("libpython", path)
        loader.create_module(ModuleSpec("libpython", loader, origin=path))
    except ImportError:
        pass  # it is no extension module, but it is open now
    finally:
        sys.setdlopenflags(flags)


def _take_path(module: str) -> str:
    """Remove the resources folder from sys.path, where the wrapper puts it each time.

    Submodules are found through their package, so it is not needed there.
    """
    taken = ""
    while sys.path and _is_resources(sys.path[0], module):
        taken = sys.path[0]
        sys.path = sys.path[1:]  # a new list: another thread may be looking through this one
    return taken


def _is_resources(folder: str, module: str) -> bool:
    """Tell whether a folder is where the wrapper has just found this script."""
    try:
        # slavemodule.txt names the script; PythonFMU's builder has not written it yet.
        with open(f"{folder}/slavemodule.txt", encoding="utf-8") as file:  # noqa: PTH123
            return file.readline().strip() == module
    except (OSError, ValueError):
        return False


def _keep(namespace: dict[str, object]) -> None:
    """Balance a reference to the script's globals that the wrapper drops each time.

    It releases one that it does not own; without this, the second instantiation of the process
    finds the module's names gone.
    """
    import ctypes  # noqa: PLC0415 - not before _open_python

    ctypes.pythonapi.Py_IncRef(ctypes.py_object(namespace))


def _find_packages(needs: tuple[str, ...], resources: str) -> None:
    """Put packages on sys.path where they are not, and make sure they are new enough."""
    import os  # noqa: PLC0415 - not before _open_python
    from importlib import util  # noqa: PLC0415 - likewise

    if sys.version_info < MIN_PYTHON:
        raise ImportError(f"Python {_dotted(MIN_PYTHON)} or newer is needed")
    chosen = os.environ.get(PATHS_VARIABLE)
    # An interpreter that was started as a program has a command line, an embedded one has not.
    embedded = not sys.orig_argv
    if chosen:
        sys.path[:0] = [p for p in chosen.split(os.pathsep) if p and p not in sys.path]
    elif embedded or any(name not in sys.modules and not util.find_spec(name) for name in needs):
        new = [p for p in _recorded(resources) if p not in sys.path]
        sys.path[:] = [*new, *sys.path] if embedded else [*sys.path, *new]
    versions = _import_quietly(needs, os.environ) if embedded else _import_needs(needs)
    for name, version in zip(needs, versions, strict=True):
        if tuple(int(part) for part in version.split(".")[:2]) < NEEDS[name]:
            raise ImportError(f"{name} {version} is too old")


def _import_needs(needs: tuple[str, ...]) -> list[str]:
    return [str(import_module(name).__version__) for name in needs]


def _import_quietly(needs: tuple[str, ...], environment: MutableMapping[str, str]) -> list[str]:
    """Import without OpenGL, which would start the host's program as if it were Python."""
    before = environment.get("MUJOCO_GL")
    environment["MUJOCO_GL"] = "disable"
    try:
        return _import_needs(needs)
    finally:
        if before is None:
            del environment["MUJOCO_GL"]
        else:
            environment["MUJOCO_GL"] = before


def _recorded(resources: str) -> list[str]:
    """Package folders that were recorded at build time, if they are for this Python."""
    import os  # noqa: PLC0415 - not before _open_python

    path = os.path.join(resources, PATHS_FILE)  # noqa: PTH118
    try:
        with open(path, encoding="utf-8") as file:  # noqa: PTH123
            version, *paths = file.read().splitlines()
    except (OSError, ValueError):
        return []
    return paths if version == _dotted(sys.version_info[:2]) else []


def _reason(error: Exception, needs: tuple[str, ...], resources: str) -> str:
    """Say what is missing and how to get it."""
    packages = " and ".join(f"{name} {_dotted(NEEDS[name])}" for name in needs)
    recorded = ", ".join(_recorded(resources)) or f"none for Python {_dotted(sys.version_info[:2])}"
    return (
        f"the FMU's code cannot start in Python {_dotted(sys.version_info[:3])} "
        f"({sys.prefix}): {type(error).__name__}: {error}. It needs Python "
        f"{_dotted(MIN_PYTHON)}, {packages}, or newer. Package folders recorded when it was built: "
        f"{recorded}. To use others, set {PATHS_VARIABLE} to the folder that holds "
        f"{' and '.join(needs)} for this Python."
    )


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))
