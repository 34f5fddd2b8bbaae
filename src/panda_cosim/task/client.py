"""The client of a scenario: a program that runs beside the FMUs, such as a robot's."""

from __future__ import annotations

import os
import shutil
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Annotated, Final

from ..fmus.errors import InputError, refuse
from ..fmus.extras import no_release
from .fields import Line, checked

ADDRESS: Final = "{address}"  # in a command: where the FMUs listen
PYTHON: Final = ("python", "python3")  # in a command: the one that runs this


class MissingPackageError(InputError):
    """A scenario's client needs a package that is not installed; a suite skips the scenario."""


@checked
class Client:
    """The section [client] of a scenario.

    Attributes:
        command: The program and its arguments, run in the scenario's folder. `{address}` stands for
            the address at which FMUs listen, and `python` for the Python that runs this.
        needs: Packages without which it cannot run, by the names that pip knows.

    Raises:
        InputError: The command names no program.
    """

    command: tuple[Annotated[str, Line()], ...]
    needs: tuple[Annotated[str, Line()], ...] = ()

    def __post_init__(self) -> None:
        if not (self.command and self.command[0]):
            must = 'must name a program, as ["python", "pick.py"]'
            refuse("command", self.command, must, error=ValueError)

    @property
    def has_address(self) -> bool:
        """Whether the command says where to connect, so that any address will do."""
        return any(ADDRESS in word for word in self.command)

    def words(self, folder: Path, address: str = "") -> list[str]:
        """Return the command as it is run.

        Raises:
            InputError: The program or a package is not there.
        """
        self._check_packages()
        program, *others = (word.replace(ADDRESS, address) for word in self.command)
        if program in PYTHON:
            for script in others[:1]:
                if script.endswith(".py") and not (folder / script).is_file():
                    raise InputError(f"[client] command: {folder / script}: no such file")
            return [sys.executable, *others]
        found = shutil.which(folder.resolve() / program if os.sep in program else program)
        if found is None:
            refuse("[client] command", program, "must be a program that can be run")
        return [found, *others]

    def _check_packages(self) -> None:
        for name in self.needs:
            try:
                distribution(name)
            except PackageNotFoundError:
                how = no_release(name) or f"which is not installed: pip install {name}"
                raise MissingPackageError(f"[client] needs {name}, {how}") from None
