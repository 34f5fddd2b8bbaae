"""An .fmu file: checked, unpacked and described."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..messages import did_you_mean, one_line
from ..packaging.build import cache_folder
from .archive import digest, unpack
from .library import check_library
from .xmlcheck import check_xml


class Fmu:
    """An .fmu file, unpacked and described.

    Args:
        path: The file.

    Attributes:
        path: The file.
        sha256: Its hash.
        description: FMPy's `ModelDescription`.
        variables: FMPy's `ScalarVariable`s by name.

    Raises:
        InputError: The file is missing, damaged, or no FMI 2.0 co-simulation FMU for this
            platform.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sha256 = digest(path)
        self.folder = unpack(path, cache_folder() / "unpacked" / self.sha256[:24])
        self.description: Any = _read_description(path, self.folder)
        self.variables = _by_name(path, self.description.modelVariables)
        self._check_place()

    @property
    def guid(self) -> str:
        """The FMU's GUID."""
        return str(self.description.guid)

    def variable(self, name: str) -> Any:
        """Return a scalar variable.

        Raises:
            InputError: There is none of this name.
        """
        if name in self.variables:
            return self.variables[name]
        raise InputError(f"{self.path}: no variable {name!r}{did_you_mean(name, self.variables)}")

    def _check_place(self) -> None:
        """PythonFMU's wrapper understands no other escape than that of a space."""
        uri = (self.folder / "resources").as_uri()
        if "%" in uri.replace("%20", " "):
            raise InputError(
                f"{self.folder}: the FMU's wrapper cannot read a path with these characters; set "
                f"PANDA_COSIM_CACHE to a folder whose path is plain ASCII"
            )


def _read_description(path: Path, folder: Path) -> Any:
    import fmpy  # noqa: PLC0415 - 0.2 s, which a command that runs no FMU should not pay
    from fmpy.model_description import read_model_description  # noqa: PLC0415

    xml = folder / "modelDescription.xml"
    label = f"{path}: modelDescription.xml"
    version = check_xml(xml, label, "fmiModelDescription").get("fmiVersion")
    if version != "2.0":
        raise InputError(f"{label}: fmiVersion {version!r}; must be '2.0'")
    try:
        description = read_model_description(str(folder), validate=False)
    except Exception as error:  # FMPy raises plain Exceptions, lxml and OS errors
        raise InputError(
            f"{path}: modelDescription.xml cannot be read: {_why_invalid(folder, error)}"
        ) from error
    if description.coSimulation is None:
        raise InputError(f"{path}: not a co-simulation FMU; it must have a <CoSimulation> element")
    if not description.guid:
        raise InputError(f"{path}: modelDescription.xml: the guid is missing or empty")
    identifier = description.coSimulation.modelIdentifier or ""
    if not (identifier.isascii() and identifier.isidentifier()):
        raise InputError(
            f"{path}: modelIdentifier {identifier[:80]!a}; must be letters, digits and _"
        )
    library = folder / "binaries" / fmpy.platform / f"{identifier}{fmpy.sharedLibraryExtension}"
    if not library.is_file():
        raise InputError(
            f"{path}: no binary for this platform; {library.relative_to(folder)} is missing"
        )
    check_library(library, f"{path}: {library.relative_to(folder)}")
    return description


def _by_name(path: Path, variables: Sequence[Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for variable in variables:
        if found.setdefault(variable.name, variable) is not variable:
            raise InputError(f"{path}: variable {variable.name!a} occurs twice")
    return found


def _why_invalid(folder: Path, error: Exception) -> str:
    """Say what is wrong with a description: the schema's words, if it finds anything."""
    from fmpy.model_description import ValidationError, read_model_description  # noqa: PLC0415

    with suppress(Exception):  # the first error says more then
        try:
            read_model_description(str(folder), validate=True)
        except ValidationError as invalid:
            return " ".join(str(invalid.problems[0]).split())
    name = type(error).__name__
    return one_line(error) if name == "Exception" else f"{name}: {one_line(error)}"
