"""Other versions of MuJoCo than the installed one.

Each is a folder in the cache that a process of its own imports. The project runs with any of them,
so an FMU with another engine is the one that the project makes where that version is installed: its
models are compiled by that version, byte for byte.
"""

from __future__ import annotations

import os
import pickle
import re
import sys
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from ..atomic import cache_folder, in_cache, temporary_folder
from ..errors import CosimError, InputError, refuse
from ..processes import SAFE_PATH, last_line, pip, run
from .identity import mujoco_version

_VERSION: Final = re.compile(r"(3\.[1-9]\d|[4-9]\.\d\d?)\.\d\d?", re.A)
DEPENDENCIES: Final = "documentation/externalDependencies.txt"  # of an FMU
SPARSE_FAULT: Final = (  # where the solver is Newton's, the default
    "MuJoCo 4.0.0 computes wrong accelerations where a model's constraint Jacobian is sparse "
    "(google-deepmind/mujoco issue 3767, mended in 4.0.1); --mujoco takes another version"
)
_CHILD: Final = """
import pickle, sys
from pathlib import Path
import mujoco
from panda_cosim.fmus.errors import CosimError
call, answer, version = sys.argv[1:]
assert mujoco.__version__ == version, mujoco.__file__
try:
    Path(answer).write_bytes(pickle.loads(Path(call).read_bytes())())
except CosimError as error:
    print(error, file=sys.stderr)
    sys.exit(error.exit_code)
"""


def check_engine(version: object) -> str:
    """Return a version of MuJoCo that FMUs can hold; "" is the installed one."""
    if version != "" and not (isinstance(version, str) and _VERSION.fullmatch(version)):
        refuse("mujoco", version, "must be a version from 3.10.0 on")
    return str(version)


def sparse_fault() -> tuple[str, ...]:
    """What is wrong with sparse models in the installed version."""
    return (SPARSE_FAULT,) * (mujoco_version() == "4.0.0")


def known_faults(fmu: Path) -> list[str]:
    """Return what an FMU's documents say is wrong with the engine and the model in it."""
    with zipfile.ZipFile(fmu) as archive:
        texts = [archive.read(name) for name in archive.namelist() if name == DEPENDENCIES]
    return [SPARSE_FAULT] * (SPARSE_FAULT.encode() in b"".join(texts))


def made_with(version: str, make: Callable[[], bytes]) -> bytes:
    """Call a function that can be pickled where this version of MuJoCo is imported."""
    if version == mujoco_version():
        return make()
    paths = [str(_installed(version)), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, **SAFE_PATH, "PYTHONPATH": os.pathsep.join(paths)}
    with temporary_folder(cache_folder()) as folder:
        call, answer = folder / "call", folder / "answer"
        call.write_bytes(pickle.dumps(make))
        command = [sys.executable, "-c", _CHILD, str(call), str(answer), version]
        done = run(command, environment=environment)
        if done.returncode:
            kind = InputError if done.returncode == InputError.exit_code else CosimError
            raise kind(f"with MuJoCo {version}: {last_line(done.stderr)}")
        return answer.read_bytes()


def has_engine(version: str) -> bool:
    """Whether a version of MuJoCo is here, so that nothing has to be downloaded."""
    return version in ("", mujoco_version()) or _engine(version).is_dir()


def _engine(version: str) -> Path:
    return cache_folder() / "engines" / f"{version}-{sys.implementation.cache_tag}"


def _installed(version: str) -> Path:
    """Return the folder of a version, downloaded if it is missing."""
    folder = _engine(version)
    packages = ["mujoco"] if version.startswith("3.") else ["mujoco", "mujoco-core"]
    if not folder.is_dir():
        with in_cache(folder) as partial:
            reason = pip(
                "install", "--retries", "1", "--target", str(partial),
                *(f"{package}=={version}" for package in packages), folder=partial.parent,
            )  # fmt: skip
            if reason:
                raise CosimError(f"MuJoCo {version} cannot be installed: {reason}")
            with suppress(OSError):  # another process was first
                partial.rename(folder)
    return folder
