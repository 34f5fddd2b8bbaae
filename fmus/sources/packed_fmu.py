"""FMUs that PythonFMU's own builder packs, with its wrapper and our description."""

from __future__ import annotations

import io
import os
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..atomic import cache_folder, temporary_folder
from ..build.description import Layout
from ..build.description import members as description_of
from ..build.native import NativeFmu, archive
from ..errors import CosimError
from ..interface.variables import Interface
from ..processes import SAFE_PATH, last_line, run
from .python_fmu import PYTHONFMU, package_of, requirements


@dataclass(frozen=True)
class PackedFmu(NativeFmu):
    """An FMU that PythonFMU's builder packs, with its wrapper, and with our description."""

    script: str = ""  # the resource that defines the slave's class
    holds = (PYTHONFMU,)

    def build(self, layout: Layout, platforms: Sequence[str]) -> bytes:
        """Make the .fmu file; its wrapper is for the platforms that PythonFMU has."""
        with temporary_folder(cache_folder()) as folder:
            zipfile.ZipFile(io.BytesIO(archive(self.resources))).extractall(folder)
            script, packed = folder / self.script, folder / f"{self.model}.fmu"
            others = {folder / name.partition("/")[0] for name in self.resources} - {script}
            words = ["-m", PYTHONFMU, "build", "-f", script, "-d", packed, *others]
            done = run([sys.executable, *map(str, words)], environment=os.environ | SAFE_PATH)
            if done.returncode:
                raise CosimError(f"PythonFMU cannot build {self.model}: {last_line(done.stderr)}")
            with zipfile.ZipFile(packed) as file:
                members = {name: file.read(name) for name in file.namelist()}
        return archive(members | description_of(self, layout))


def packed_fmu(
    interface: Interface,
    code: Mapping[str, bytes],
    slave: tuple[str, str],
    needs: Sequence[str],
    resources: Mapping[str, bytes],
) -> PackedFmu:
    """Describe the FMU of a slave class that PythonFMU packs."""
    package, files = package_of(interface, code)
    # One process would not read a second script of the same name.
    script, (module, name) = f"{package}_slave.py", slave
    text = (
        f"from {package}.{module} import {name}\n\n\nclass {interface.model}({name}):\n    pass\n"
    )
    contents = {**files, **resources, script: text.encode()}
    needed = requirements("packed", needs)
    return PackedFmu(interface, PYTHONFMU, "", contents, needs=needed, script=script)
