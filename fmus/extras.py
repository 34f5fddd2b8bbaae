"""Packages that only some commands need: what is said where one is missing."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import requires
from typing import Final

from .errors import InputError

_BOUND: Final = re.compile(r"python_version < ['\"]3\.(\d+)['\"]")


@contextmanager
def needing(package: str, extra: str, what: str) -> Iterator[None]:
    """Import a package of an extra within this, which `what` needs.

    Raises:
        InputError: If it is missing, with how to get it.
    """
    try:
        yield
    except ImportError as error:
        get = f"which is not installed ({error}); pip install 'panda-cosim[{extra}]'"
        raise InputError(f"{what}: needs {package}, {no_release(package) or get}") from None


def no_release(package: str) -> str:
    """Say that an optional package has no release for this Python, or ""."""
    last, version = last_python(package), sys.version_info[1]
    if last is None or version <= last:
        return ""
    return f"which has no release for Python 3.{version}; must be 3.{last} or older"


def last_python(package: str) -> int | None:
    """Return the newest minor version of Python that an optional package has a release for."""
    for requirement in requires("panda-cosim") or ():
        if requirement.startswith(package) and (bound := _BOUND.search(requirement)):
            return int(bound[1]) - 1
    return None
