"""Other versions of MuJoCo: each an importable folder in the cache, for processes of its own.

The project itself runs with any of them. So an FMU with another engine is the one that the project
builds where that version is installed: its models are compiled by that version, byte for byte.
"""

from __future__ import annotations

import os
import pickle
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from ..atomic import cache_folder, in_cache, temporary_folder
from ..errors import CosimError, InputError
from ..processes import SAFE_PATH, run

OLDEST: Final = (3, 10, 0)  # as in pyproject.toml
_VERSION: Final = re.compile(r"\d{1,3}(\.\d{1,3}){2}", re.A)
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
    if version != "":
        is_version = isinstance(version, str) and _VERSION.fullmatch(version)
        if not is_version or tuple(map(int, str(version).split("."))) < OLDEST:
            oldest = ".".join(map(str, OLDEST))
            raise ValueError(f'value {version!r}; must be a version of MuJoCo from "{oldest}" on')
    return str(version)


def engine_folder(version: str) -> Path:
    """Folder from which this version of MuJoCo can be imported; downloaded if it is missing."""
    folder = cache_folder() / "engines" / f"{version}-{sys.implementation.cache_tag}"
    if not folder.is_dir():
        packages = ["mujoco"] if version.startswith("3.") else ["mujoco", "mujoco-core"]
        with in_cache(folder) as partial:
            command = [
                *(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"),
                *("--disable-pip-version-check", "--retries", "1", "--only-binary", ":all:"),
                *("--target", str(partial)),
                *(f"{package}=={version}" for package in packages),
            ]
            done = run(command)
            if done.returncode:
                lines = done.stderr.strip().splitlines() or ["pip failed"]
                raise CosimError(f"MuJoCo {version} cannot be downloaded: {lines[-1]}")
            with suppress(OSError):  # another process was first
                partial.rename(folder)
    return folder


def made_with(version: str, make: Callable[[], bytes]) -> bytes:
    """Call a function that can be pickled in a process that has another MuJoCo."""
    paths = [str(engine_folder(version)), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, **SAFE_PATH, "PYTHONPATH": os.pathsep.join(paths)}
    with temporary_folder(cache_folder()) as folder:
        call, answer = folder / "call", folder / "answer"
        call.write_bytes(pickle.dumps(make))
        command = [sys.executable, "-c", _CHILD, str(call), str(answer), version]
        done = run(command, environment=environment)
        if done.returncode:
            lines = done.stderr.strip().splitlines() or [f"ended with {done.returncode}"]
            kind = InputError if done.returncode == InputError.exit_code else CosimError
            raise kind(f"with MuJoCo {version}: {lines[-1]}")
        return answer.read_bytes()
