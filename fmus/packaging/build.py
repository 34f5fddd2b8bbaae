"""Packaging: from a bundle of code to an .fmu file, the same bytes for the same content."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import uuid
import zipfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import CosimError, InputError
from ..interface.trajectory import TABLE_FILE
from ..slaves.hosting import PATHS_FILE
from . import binary
from .bundle import BUNDLES, TRAJECTORY_BUNDLE, Bundle
from .cache import cache_folder, private_folder
from .scratch import BUILD, remove_stale, scratch_folder

FIXED_DATE: Final = (2026, 1, 1, 0, 0, 0)  # of every archive member: equal content, equal bytes
_PARSING: Final = Lock()  # Python 3.11's parser fails where two threads use it at once
# Of every Python that is started: what lies in the working directory is data, never code.
# `-P` does the same for that Python alone, this also for those that it starts.
SAFE_PATH: Final = {"PYTHONSAFEPATH": "1"}
# PythonFMU's builder imports the script and leaves its folder on sys.path: so in a child.
# There, the FMU's own copy of pythonfmu has to be the builder's, which looks for its class.
_CHILD: Final = """
import ctypes, importlib, sys
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, 9)  # PR_SET_PDEATHSIG, SIGKILL: not to outlive who asked
from pythonfmu.builder import FmuBuilder
package, script, destination, *files = sys.argv[1:]
for name in ("", ".enums", ".fmi2slave"):
    sys.modules[f"{package}.pythonfmu{name}"] = importlib.import_module(f"pythonfmu{name}")
FmuBuilder.build_FMU(script, dest=destination, project_files=files)
"""


def guid(bundle: Bundle) -> str:
    """GUID of an FMU, made from its content."""
    return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, bundle.digest)}}}"


def outdated(names: Iterable[str] = BUNDLES) -> list[str]:
    """Tell which FMUs `build` would have to build, as none of their content is cached."""
    return [name for name in names if not _place(BUNDLES[name]).exists()]


def build(names: Iterable[str] = BUNDLES, out: Path | None = None) -> dict[str, Path]:
    """Build FMUs, those that are not there yet.

    Args:
        names: Keys of `BUNDLES`.
        out: Folder to also put them in; None: they stay in the cache alone.

    Returns:
        The path of each FMU, by key.

    Raises:
        InputError: The folder cannot be written.
        CosimError: PythonFMU failed.
    """
    bundles = {name: BUNDLES[name] for name in names}
    remove_stale(cache_folder())
    binary.recorded_paths()  # here: sysconfig fails where two threads ask it first
    with ThreadPoolExecutor() as pool:
        paths = dict(zip(bundles, pool.map(_cached, bundles.values()), strict=True))
    if out is None:
        return paths
    return {name: _copy(path, out / f"{bundles[name].model}.fmu") for name, path in paths.items()}


def build_trajectory(commands: NDArray[np.float64], path: Path | None = None) -> Path:
    """Build the FMU that plays commands.

    Args:
        commands: Commands of each millisecond from t = 0 on (n, 14), columns as the outputs of
            `fmus.interface.trajectory.TRAJECTORY`.
        path: The file; None: in the cache.

    Returns:
        Its path.

    Raises:
        InputError: The commands are not finite or not of this shape, or the folder cannot be
            written.
        CosimError: PythonFMU failed.
    """
    if commands.ndim != 2 or commands.shape[1] != 14 or not len(commands):
        raise InputError(f"commands: shape {commands.shape}; must be (n, 14)")
    if not np.isfinite(commands).all():
        row, column = np.argwhere(~np.isfinite(commands))[0]
        raise InputError(f"commands: row {row}, column {column} is not finite")
    table = (f"fmus/slaves/{TABLE_FILE}", commands.astype("<f8").tobytes())
    built = _cached(replace(TRAJECTORY_BUNDLE, extra=(table,)))
    return built if path is None else _copy(built, path)


def _copy(built: Path, path: Path) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return Path(shutil.copy2(built, path))
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(f"{path.parent}: must be a folder, or a new name for one") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def build_bundle(bundle: Bundle, path: Path) -> Path:
    """Build one FMU where it is wanted, past the cache.

    Args:
        bundle: What goes into it.
        path: The file.

    Returns:
        The path.

    Raises:
        CosimError: PythonFMU failed.
    """
    with scratch_folder(path.parent, BUILD) as folder:
        return _assemble(bundle, folder).replace(path)


def _place(bundle: Bundle) -> Path:
    """Path of an FMU in the cache, by its content and by the paths that it records."""
    machine = hashlib.sha256(binary.recorded_paths().encode()).hexdigest()
    return cache_folder() / f"{bundle.digest[:16]}-{machine[:8]}" / f"{bundle.model}.fmu"


def _cached(bundle: Bundle) -> Path:
    """Path of an FMU in the cache, built if it is not there."""
    path = _place(bundle)
    try:
        private_folder(path.parent)
        if not path.exists():
            with scratch_folder(path.parent, BUILD) as folder:
                built = _assemble(bundle, folder)
                built.replace(path)  # in one go: another process may be building, too
    except OSError as error:
        raise InputError(
            f"{path.parent}: cannot write the FMU cache: {error.strerror or error}; "
            f"set PANDA_COSIM_CACHE to a folder that can be written"
        ) from error
    return path


def _assemble(bundle: Bundle, folder: Path) -> Path:
    """Let PythonFMU build, then complete and repack what it made."""
    package = folder / bundle.package
    with _PARSING:
        files = list(bundle.private_files())
    for name, content in files:
        target = package / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
        if target.suffix == ".py":
            init = target.parent / "__init__.py"
            init.touch()
    script = folder / f"{bundle.package}_slave.py"
    script.write_text(bundle.script())
    raw = folder / "raw.fmu"
    child = subprocess.run(
        [sys.executable, "-P", "-c", _CHILD, bundle.package, str(script), str(raw), str(package)],
        capture_output=True,
        text=True,
        check=False,
        start_new_session=True,  # Ctrl-C is for this process, which then stops by itself
        env=os.environ | SAFE_PATH | {"TMPDIR": str(folder)},  # a kill leaves nothing elsewhere
    )
    if child.returncode or not raw.exists():
        raise CosimError(f"PythonFMU could not build {bundle.model}:\n{child.stderr}")
    return _repack(bundle, raw, folder / f"{bundle.model}.fmu")


def _repack(bundle: Bundle, raw: Path, path: Path) -> Path:
    """Write the archive anew: complete description, fixed order and dates, compressed."""
    with zipfile.ZipFile(raw) as archive:
        members = {
            name: archive.read(name)
            for name in archive.namelist()
            # The FMU has its own pythonfmu inside its package.
            if not name.startswith("resources/pythonfmu/")
        }
    members |= _descriptions(bundle)
    members[f"resources/{PATHS_FILE}"] = _recorded_folders()
    library = f"binaries/linux64/{bundle.model}.so"
    members[library] = binary.complete(members[library], raw.parent)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(members):
            info = zipfile.ZipInfo(name, FIXED_DATE)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.create_system = 3  # Unix, wherever it is built
            info.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(info, members[name])
    return path


def _recorded_folders() -> bytes:
    """Where this Python's packages are, for hosts that are not Python."""
    version = ".".join(map(str, sys.version_info[:2]))
    return "\n".join((version, *binary.package_folders(), "")).encode()


def _descriptions(bundle: Bundle) -> dict[str, bytes]:
    """The model description, and what is for people."""
    from importlib import import_module  # noqa: PLC0415 - only for a build, as all of these
    from importlib.metadata import version  # noqa: PLC0415

    from ..interface.tables import ALL_INTERFACES  # noqa: PLC0415
    from .description import Identity, model_description  # noqa: PLC0415
    from .document import PYTHON_THIRD_PARTY, About, documents, python_needs  # noqa: PLC0415

    interface = next(i for i in ALL_INTERFACES if i.model == bundle.model)
    tool = f"panda-cosim with PythonFMU {version('pythonfmu')}"
    identity = Identity(guid(bundle), version("panda-cosim"), tool)
    module, name = bundle.law
    law = getattr(import_module(f"panda_cosim.{module}"), name).__doc__ or ""
    about = About(
        law,
        python_needs(bundle.needs),
        (("pythonfmu", "LICENSE"),),
        PYTHON_THIRD_PARTY,
        native=False,
    )
    return {
        "modelDescription.xml": model_description(interface, identity),
        **documents(interface, identity, 2, about),
    }
