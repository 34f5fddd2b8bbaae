"""The Python kind of FMU: a bundle of code, packaged by PythonFMU and completed."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import uuid
import zipfile
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from threading import Lock
from typing import Final

from ..errors import CosimError
from ..interface.tables import ALL_INTERFACES
from ..processes import SAFE_PATH
from ..slaves.hosting import PATHS_FILE
from . import binary
from .archive_writer import archive
from .bundle import Bundle
from .cache import cache_folder
from .description import Identity, model_description
from .document import PYTHON_THIRD_PARTY, About, documents, python_needs
from .scratch import BUILD, scratch_folder

_PARSING: Final = Lock()  # Python 3.11's parser fails where two threads use it at once
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


@dataclass(frozen=True)
class PythonFmu:
    """An FMU that runs its bundle's code in Python.

    Attributes:
        bundle: What goes into it.
    """

    bundle: Bundle

    @property
    def model(self) -> str:
        """Model name and identifier."""
        return self.bundle.model

    @property
    def key(self) -> str:
        """Hash of its content, and of the paths of this machine that it records."""
        paths = binary.recorded_paths()
        return hashlib.sha256(f"{self.bundle.digest} {paths}".encode()).hexdigest()

    def build(self) -> bytes:
        """Make the .fmu file.

        Raises:
            CosimError: PythonFMU failed.
        """
        with scratch_folder(cache_folder(), BUILD) as folder:
            return _assemble(self.bundle, folder)


def build_bundle(bundle: Bundle, path: Path) -> Path:
    """Build one FMU where it is wanted, past the cache; returns the path.

    Args:
        bundle: What goes into it.
        path: The file.

    Raises:
        CosimError: PythonFMU failed.
    """
    path.write_bytes(PythonFmu(bundle).build())
    return path


def _assemble(bundle: Bundle, folder: Path) -> bytes:
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
    return _repack(bundle, raw)


def _repack(bundle: Bundle, raw: Path) -> bytes:
    """Write the archive anew: complete description, fixed order and dates, compressed."""
    with zipfile.ZipFile(raw) as made:
        members = {
            name: made.read(name)
            for name in made.namelist()
            # The FMU has its own pythonfmu inside its package.
            if not name.startswith("resources/pythonfmu/")
        }
    members |= _descriptions(bundle)
    members[f"resources/{PATHS_FILE}"] = _recorded_folders()
    library = f"binaries/linux64/{bundle.model}.so"
    members[library] = binary.complete(members[library], raw.parent)
    return archive(members)


def _recorded_folders() -> bytes:
    """Where this Python's packages are, for hosts that are not Python."""
    version = ".".join(map(str, sys.version_info[:2]))
    return "\n".join((version, *binary.package_folders(), "")).encode()


def _descriptions(bundle: Bundle) -> dict[str, bytes]:
    """The model description, and what is for people."""
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
