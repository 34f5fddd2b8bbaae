"""An FMU on a library of `fmus/native`: its table, its libraries, and the archive's members."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import distribution, version
from pathlib import Path
from typing import Final

from ..interface.variables import Interface
from ..slaves.base import TICK
from .archive_writer import archive
from .compile import PLATFORMS
from .description import STOP_TIME, Identity, model_description, terminals
from .document import PYTHON_THIRD_PARTY, About, documents, python_needs
from .libraries import MUJOCO, NEED_MUJOCO, fmu_library, mujoco_library, sources_digest
from .python_runtime import RECORDED
from .table import Option, table

TABLE_NAME: Final = "variables.txt"


@dataclass(frozen=True)
class NativeFmu:
    """A native FMU, for any FMI version and platform.

    Attributes:
        interface: Its variables; `Variable.source` in the backend's form.
        backend: Key of `compile.BACKENDS`.
        law: Description of what it computes, for the documentation.
        resources: Contents of the resources, by name.
        options: Options for the backend.
        step_size: Internal step [s].
        stop_time: Of the default experiment [s].
    """

    interface: Interface
    backend: str
    law: str
    resources: Mapping[str, bytes] = field(default_factory=dict)
    options: tuple[Option, ...] = ()
    step_size: float = TICK
    stop_time: float = STOP_TIME

    @property
    def model(self) -> str:
        """Model name and identifier."""
        return self.interface.model

    @cached_property
    def digest(self) -> str:
        """Hash of everything that the FMU's behaviour and documents depend on."""
        content = hashlib.sha256(sources_digest(self.backend).encode())
        content.update(version("panda-cosim").encode() + self.law.encode())
        content.update(self.model.encode() + self.interface.description.encode())
        content.update(repr([(v.name, v.description, v.unit) for v in self.interface.variables])
                       .encode())  # fmt: skip
        options = [(key, value) for key, value in self.options if key not in RECORDED]
        content.update(table(self.interface, "", self.step_size, options))
        for name, resource in sorted(self.resources.items()):
            content.update(f"{name}\0{len(resource)}\0".encode() + resource)
        templates = Path(__file__).with_name("templates")
        for path in (*sorted(templates.iterdir()), Path(__file__)):
            content.update(path.read_bytes())
        return content.hexdigest()

    @property
    def token(self) -> str:
        """GUID of FMI 2.0 and instantiation token of FMI 3.0."""
        return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, self.digest)}}}"

    @property
    def opens_mujoco(self) -> bool:
        """Whether it contains MuJoCo's library."""
        return self.backend in NEED_MUJOCO

    def build(self, fmi: int, platforms: Sequence[str]) -> bytes:
        """Make the .fmu file.

        Args:
            fmi: Major version of FMI, 2 or 3.
            platforms: Keys of `compile.PLATFORMS`.

        Raises:
            InputError: There is no compiler for a platform.
            CosimError: A library cannot be compiled or downloaded.
        """
        return archive(self._for_people(fmi) | self._resources() | self._binaries(fmi, platforms))

    def _for_people(self, fmi: int) -> dict[str, bytes]:
        """Model description, documentation, licences."""
        identity = Identity(
            self.token,
            version("panda-cosim"),
            f"panda-cosim {version('panda-cosim')}",
            self.step_size,
            self.stop_time,
        )
        members = documents(self.interface, identity, fmi, self._about())
        members["modelDescription.xml"] = model_description(self.interface, identity, fmi)
        if fmi == 3 and self.interface.terminals:
            members["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(self.interface)
        return members

    def _about(self) -> About:
        python = [text.split()[0] for key, text in self.options if key == "need"]
        is_python = self.backend == "python"
        nothing = ("Nothing: neither Python nor any library that it does not contain.",)
        needs = python_needs(python) if is_python else nothing
        glibc = "2.27" if self.opens_mujoco else "2.17"
        systems = f"Linux: glibc {glibc} or newer. Windows: 10 or newer. macOS: 11 or newer."
        licences = [(MUJOCO, name) for name in _mujoco_licences()] if self.opens_mujoco else []
        return About(self.law, (*needs, systems), tuple(licences), self._third_party())

    def _third_party(self) -> str:
        headers = "FMI headers (BSD-2-Clause, Modelica Association), compiled into the binaries.\n"
        if self.backend == "python":
            return f"In this FMU: {headers}{PYTHON_THIRD_PARTY}"
        if not self.opens_mujoco:
            return f"In this FMU: {headers}"
        engine = f"MuJoCo {version(MUJOCO)} (Apache-2.0, DeepMind Technologies), beside them.\n"
        return f"In this FMU:\n  {headers}  {engine}"

    def _resources(self) -> dict[str, bytes]:
        written = table(self.interface, self.token, self.step_size, self.options)
        files = {TABLE_NAME: written, **self.resources}
        return {f"resources/{name}": content for name, content in files.items()}

    def _binaries(self, fmi: int, platforms: Sequence[str]) -> dict[str, bytes]:
        members = {}
        for name in platforms:
            platform = PLATFORMS[name]
            folder = f"binaries/{platform.fmi2 if fmi == 2 else platform.fmi3}"
            library = fmu_library(self.backend, name)
            members[f"{folder}/{self.model}{platform.suffix}"] = library
            if self.opens_mujoco:
                members[f"{folder}/{platform.mujoco}"] = mujoco_library(name)
        return members


def _mujoco_licences() -> list[str]:
    files = distribution(MUJOCO).files or []
    return sorted(file.name for file in files if "dist-info/licenses" in str(file))
