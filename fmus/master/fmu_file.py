"""Unpacks and checks an .fmu file, and reads its description."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, Final

from ..atomic import cache_folder
from ..errors import InputError
from ..messages import did_you_mean, excerpt, one_line
from .archive import file_digest, unpack
from .library import check_library
from .xml_file import read_xml

VERSIONS: Final = {"2.0": 2, "3.0": 3}
# FMI 3.0's types by the names of FMI 2.0, if the master treats them alike.
_TYPES: Final = {
    "Float64": "Real",
    **{f"{sign}Int{bits}": "Integer" for sign in ("", "U") for bits in (8, 16, 32, 64)},
}
TEXTS: Final = ("String", "Binary", "Clock")  # types whose start value is kept as it is written


@dataclass(frozen=True, slots=True)
class FmuVariable:
    """A scalar: a variable of FMI 2.0, or an element of one of FMI 3.0.

    Attributes:
        name: Name, with the indices of an element: `jac[1,2]`.
        array: Name of the array that it is an element of; for a scalar, its own name.
        element: Index among the array's elements, row by row; for a scalar, 0.
        reference: Value reference, of the whole array.
        type: Real, Integer, Boolean, String or Enumeration; another type of FMI 3.0 keeps its
            name.
        fmi_type: Type as the FMU's FMI version names it.
        causality: As in the description.
        variability: As in the description.
        unit: Unit, or None.
        start: Start value as written in the description, or None.
        minimum: Lower bound, or None.
        maximum: Upper bound, or None.
        choices: Names of an enumeration's items, by value.
        description: Description, or "".
    """

    name: str
    array: str
    element: int
    reference: int
    type: str
    fmi_type: str
    causality: str
    variability: str
    unit: str | None
    start: str | None
    minimum: float | None
    maximum: float | None
    choices: Mapping[int, str]
    description: str

    def start_value(self) -> float | bool | str:
        """Start value, in its type, a Binary as hexadecimal text; zero if there is none."""
        return self.converted("" if self.start is None else self.start)

    def converted(self, value: float | bool | str) -> float | bool | str:
        """Return a value in this variable's type; an enumeration's value may be a name."""
        if self.type in TEXTS:
            return str(value)
        if isinstance(value, str) and value in self.choices.values():
            return next(number for number, name in self.choices.items() if name == value)
        if self.type == "Boolean":
            return value in (True, "true", "1")
        if self.type in ("Integer", "Enumeration"):
            # Not by way of float, which holds no more than 53 of 64 bits.
            return int(Decimal(value or 0) if isinstance(value, str) else value)
        return float(value or 0.0)


class Fmu:
    """An .fmu file, unpacked and described.

    Args:
        path: The file.
        label: What messages call it; "": its path.

    Attributes:
        path: The file.
        label: What messages call it: an unpacked .ssp file's FMU is nowhere that a user knows.
        sha256: Its SHA-256.
        description: FMPy's `ModelDescription`.
        fmi: Major version of FMI, 2 or 3.
        variables: Scalars by name, including the elements of FMI 3.0 arrays.

    Raises:
        InputError: The file is missing, damaged, or not a co-simulation FMU of FMI 2.0 or 3.0
            for this platform.
    """

    def __init__(self, path: Path, label: str = "") -> None:
        self.path, self.label = path, label or str(path)
        self.sha256 = file_digest(path)
        self.folder = unpack(path, cache_folder() / "unpacked" / self.sha256[:24])
        self.description: Any = _read_description(path, self.folder)
        self.fmi = VERSIONS[self.description.fmiVersion]
        self.variables = _by_name(path, self.description.modelVariables)
        self._arrays: dict[str, list[FmuVariable]] = defaultdict(list)
        for variable in self.variables.values():
            self._arrays[variable.array].append(variable)
        if self.in_python:
            self._check_place()
            _check_script(self)

    @property
    def guid(self) -> str:
        """The FMU's GUID; in FMI 3.0, its instantiation token."""
        return str(self.description.guid)

    @property
    def in_python(self) -> bool:
        """Whether PythonFMU's wrapper runs it, in the Python of this process."""
        return "PythonFMU" in (self.description.generationTool or "")

    def array(self, name: str) -> list[FmuVariable]:
        """Return the elements of an array; for a scalar, only itself."""
        return self._arrays[name]

    def variable(self, name: str) -> FmuVariable:
        """Return a scalar.

        Raises:
            InputError: There is no variable of this name.
        """
        if name in self.variables:
            return self.variables[name]
        raise InputError(f"{self.label}: no variable {name!r}{did_you_mean(name, self.variables)}")

    def _check_place(self) -> None:
        """Check the folder's path: PythonFMU's wrapper decodes no URI escape but a space."""
        uri = (self.folder / "resources").as_uri()
        if "%" in uri.replace("%20", " "):
            raise InputError(
                f"{self.folder}: the FMU's wrapper cannot read a path with these characters; set "
                f"PANDA_COSIM_CACHE to a folder with a plain ASCII path"
            )


def read_fmu(path: Path, label: str = "") -> Fmu:
    """Read an FMU; one that has been read before is not read again until its file changes.

    Raises:
        InputError: See `Fmu`.
    """
    try:
        state = path.stat()
    except (OSError, ValueError):
        return Fmu(path, label)  # which says what is wrong
    return _read_once(path.absolute(), label or str(path), state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=64)
def _read_once(path: Path, label: str, _mtime: int, _size: int) -> Fmu:
    return Fmu(path, label)


def _check_script(fmu: Fmu) -> None:
    """Check that the slave's module is there: PythonFMU's wrapper crashes without it."""
    resources, names = fmu.folder / "resources", "slavemodule.txt"
    if not (resources / names).is_file():
        raise InputError(f"{fmu.path}: resources/{names} is missing; PythonFMU's wrapper needs it")
    words = (resources / names).read_text(errors="replace")[:200].split() or [""]
    module = words[0].replace(".", "/")
    if not any((resources / f"{module}{end}").is_file() for end in (".py", ".pyc", "/__init__.py")):
        raise InputError(
            f"{fmu.path}: resources/{names} names {excerpt(words[0])}; must be a module there"
        )


def _read_description(path: Path, folder: Path) -> Any:
    import fmpy  # noqa: PLC0415 - takes 0.2 s, wasted on a command that runs no FMU
    from fmpy.model_description import read_model_description  # noqa: PLC0415 - see above

    xml = folder / "modelDescription.xml"
    label = f"{path}: modelDescription.xml"
    root = read_xml(xml, label)
    if root.tag != "fmiModelDescription":
        raise InputError(f"{label}: root element {root.tag[:80]!a}; must be fmiModelDescription")
    version = root.get("fmiVersion")
    if version not in VERSIONS:
        raise InputError(f"{label}: fmiVersion {version!r}; must be '2.0' or '3.0'")
    try:
        description = read_model_description(str(folder), validate=False)
    except Exception as error:  # FMPy raises plain Exceptions, lxml and OS errors
        raise InputError(
            f"{path}: modelDescription.xml cannot be read: {_why_invalid(folder, error)}"
        ) from error
    if description.coSimulation is None:
        raise InputError(f"{path}: not a co-simulation FMU; it must have a <CoSimulation> element")
    if not description.guid:
        name = "guid" if version == "2.0" else "instantiationToken"
        raise InputError(f"{path}: modelDescription.xml: the {name} is missing or empty")
    identifier = description.coSimulation.modelIdentifier or ""
    if not (identifier.isascii() and identifier.isidentifier()):
        raise InputError(
            f"{path}: modelIdentifier {identifier[:80]!a}; must be letters, digits and _"
        )
    platform = fmpy.platform if version == "2.0" else fmpy.platform_tuple
    library = folder / "binaries" / platform / f"{identifier}{fmpy.sharedLibraryExtension}"
    if not library.is_file():
        raise InputError(
            f"{path}: no binary for this platform; {library.relative_to(folder)} is missing"
        )
    check_library(library, f"{path}: {library.relative_to(folder)}")
    return description


def _by_name(path: Path, variables: Sequence[Any]) -> dict[str, FmuVariable]:
    found: dict[str, FmuVariable] = {}
    for variable in variables:
        for scalar in _scalars(path, variable):
            if found.setdefault(scalar.name, scalar) is not scalar:
                raise InputError(f"{path}: variable {scalar.name!a} occurs twice")
    return found


def _scalars(path: Path, variable: Any) -> Iterator[FmuVariable]:
    """Yield the scalars of one of FMPy's `ModelVariable`s."""
    if not 0 <= variable.valueReference < 1 << 32:
        raise InputError(
            f"{path}: modelDescription.xml: {variable.name!a}: valueReference "
            f"{variable.valueReference}; must be from 0 to {(1 << 32) - 1}"
        )
    declared = variable.declaredType
    items = getattr(declared, "items", ())
    common = {
        "array": variable.name,
        "reference": variable.valueReference,
        "type": _TYPES.get(variable.type, variable.type),
        "fmi_type": variable.type,
        "causality": variable.causality,
        "variability": variable.variability or "",
        "unit": variable.unit or getattr(declared, "unit", None),
        "minimum": _bound(path, variable, "min"),
        "maximum": _bound(path, variable, "max"),
        "choices": {int(item.value): item.name for item in items},
        "description": variable.description or "",
    }
    names = _element_names(variable.name, variable.shape or ())
    starts = _starts(variable, len(names))
    for element, (name, start) in enumerate(zip(names, starts, strict=True)):
        scalar = FmuVariable(name=name, element=element, start=start, **common)
        _check_start(path, scalar)
        yield scalar


def _check_start(path: Path, scalar: FmuVariable) -> None:
    if not _is_start(scalar, (scalar.start or "").strip()):
        raise InputError(
            f"{path}: modelDescription.xml: {scalar.name!a}: start {excerpt(scalar.start)}; "
            f"must be of type {scalar.type}"
        )


def _is_start(scalar: FmuVariable, text: str) -> bool:
    """Whether a start value's text is of the variable's type; it may be missing."""
    if not text or scalar.type in TEXTS:
        return True
    if scalar.type == "Boolean":
        return text in ("true", "false", "1", "0")
    if scalar.type == "Enumeration" and text in scalar.choices.values():
        return True
    try:
        number = float(text)
    except ValueError:
        return False
    is_xml = "_" not in text  # which Python takes between digits
    return is_xml and (scalar.type in ("Real", "Float32") or number.is_integer())


def _element_names(name: str, shape: Sequence[int]) -> list[str]:
    if not shape:
        return [name]
    indices = product(*(range(1, n + 1) for n in shape))
    return [f"{name}[{','.join(map(str, index))}]" for index in indices]


def _starts(variable: Any, count: int) -> list[str | None]:
    """Start value of each element; a single value in the description applies to all."""
    start: str | None = variable.start
    if start is None or variable.type in TEXTS:
        return [start] * count
    parts: list[str | None] = [*start.split()]
    return parts * count if len(parts) == 1 else [*parts, *[None] * count][:count]


def _bound(path: Path, variable: Any, side: str) -> float | None:
    text = getattr(variable, side) or getattr(variable.declaredType, side, None)
    try:
        return None if text is None else float(text)
    except ValueError:
        raise InputError(
            f"{path}: modelDescription.xml: {variable.name!a}: {side} {text!a} is not a number"
        ) from None


def _why_invalid(folder: Path, error: Exception) -> str:
    """Return what is wrong with a description: the schema's message, if validation finds one."""
    from fmpy.model_description import (  # noqa: PLC0415 - takes 0.2 s
        ValidationError,
        read_model_description,
    )

    with suppress(Exception):  # other errors say less than the first one
        try:
            read_model_description(str(folder), validate=True)
        except ValidationError as invalid:
            return " ".join(str(invalid.problems[0]).split())
    name = type(error).__name__
    return one_line(error) if name == "Exception" else f"{name}: {one_line(error)}"
