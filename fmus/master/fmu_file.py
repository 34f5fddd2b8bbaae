"""Unpacks an .fmu file and reads its description, also as an interface table."""

from __future__ import annotations

import pickle
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from copy import copy
from dataclasses import replace
from functools import cache, lru_cache
from io import StringIO
from itertools import chain, groupby
from pathlib import Path
from typing import Any, Final, cast
from xml.etree import ElementTree as ET

from ..atomic import cached
from ..build.identity import code_digest, digest, package_version
from ..errors import InputError, did_you_mean, excerpt, one_line, refuse
from ..interface.units import BASES, Unit, Units
from ..interface.variables import (
    INTEGERS,
    Interface,
    Kind,
    Scalar,
    Value,
    Variability,
    Variable,
    address,
    check_elements,
)
from ..reading import finite_number, read_xml, unpack

VERSIONS: Final = {"2.0": 2, "3.0": 3}
# FMI 3.0's types by the names of FMI 2.0, if the master treats them alike.
_KINDS: Final = {"Float64": "Real", "Float32": "Real"} | dict.fromkeys(INTEGERS, "Integer")
TEXTS: Final = ("String", "Binary")  # kinds whose start value is kept as it is written
_NUMBERS: Final = ("Real", "Integer")  # an interface table's Real
STRUCTURAL: Final = "structuralParameter"
_SHOWN: Final = ("input", "output", "parameter")
_COMPUTED: Final = ("output", "local", "calculatedParameter")
_NAMES_NOTE: Final = "org.panda-cosim.names"  # annotation with names as in FMI 2.0
_MODEL_NOTE: Final = "org.panda-cosim.mujoco-model"  # annotation of a MuJoCo model of ours
_IDENTIFIER: Final = re.compile(r"[\w-]+", re.A)  # containers have the name of their file
_ATTRIBUTES: Final = {**dict.fromkeys(BASES, "0"), "factor": "1", "offset": "0"}  # of a BaseUnit
_NUMBER: Final = Variable("", (), "", "parameter", "fixed", "")  # what a bound is read as
_FEW: Final = 4  # descriptions of an array's elements that are joined
_ELEMENT: Final = re.compile(r"(.+)\[(\d+(?:,\d+)*)\]", re.S)


class Fmu:
    """An .fmu file, unpacked and described; messages call it by its label, else by its path.

    `read_fmu` makes it, once a file. Nothing of the FMU runs: for that there is `FmuSlave`.
    """

    description: Any  # FMPy's `ModelDescription`
    fmi: int  # major version of FMI, 2 or 3
    variables: dict[str, Scalar]  # by name, including the elements of FMI 3.0 arrays; those of an
    # FMU of ours have the same names in FMI 2.0 and 3.0
    units: Units
    library: Path  # for this platform

    def __init__(self, path: Path, label: str = "") -> None:
        self.path, self.label = path, label or str(path)
        self.folder, self.sha256 = unpack(path, self.label)
        kept = self.folder.with_name(f"{self.folder.name}-{_reader()[:16]}.pickle")
        # What the cache holds is code that is run, anyway.
        vars(self).update(pickle.loads(cached(kept, self._read).read_bytes()))  # noqa: S301
        self.library = library_of(self.label, self.folder, self.description)
        # PythonFMU's wrapper reads its path, whose only URI escape may be a space.
        if self.in_python and "%" in self.folder.as_uri().replace("%20", " "):
            raise InputError(
                f"{self.folder}: the FMU's wrapper cannot read a path with these characters; set "
                f"PANDA_COSIM_CACHE to a folder with a plain ASCII path"
            )

    def _read(self) -> bytes:
        """Read the description, which takes longer than to load what is returned."""
        before = set(vars(self))
        place = f"{self.label}: modelDescription.xml"
        root = read_xml(self.folder / "modelDescription.xml", place)
        self.description = _read_description(self.label, self.folder, root)
        self.fmi, self.guid = VERSIONS[self.description.fmiVersion], str(self.description.guid)
        described = self.description.modelVariables
        self.clocked = [v.name for v in described if v.type == "Clock" or v.clocks]  # left out
        self.structural = {v.name for v in described if v.causality == STRUCTURAL}
        # Differences, for which the offset of a unit does not count.
        self.relative = {v.name for v in described if _stated(v, "relativeQuantity")}
        self.sizes: dict[str, int] = {}  # values of structural parameters that are changed
        notes = (*root.iterfind("VendorAnnotations/*"), *root.iterfind("Annotations/*"))
        self.is_model = any(_MODEL_NOTE in note.attrib.values() for note in notes)
        self._noted = _noted_names(root)
        self._described: dict[str, Scalar] = {}  # by their names in the description
        self.variables = self._scalars()
        self.units = read_units(place, root.iterfind("UnitDefinitions/Unit"))
        return pickle.dumps({k: value for k, value in vars(self).items() if k not in before})

    def _scalars(self) -> dict[str, Scalar]:
        taken = [v for v in self.description.modelVariables if v.name not in self.clocked]
        variables = {}
        for scalar in _scalars(f"{self.label}: modelDescription.xml", taken, self.sizes):
            names = self._noted.get(scalar.variable.name, [])
            name = names[scalar.element] if scalar.element < len(names) else scalar.name
            self._described[scalar.name] = variables[name] = replace(scalar, name=name)
        return variables

    @property
    def independent(self) -> frozenset[str]:
        """Outputs, as scalars, that depend on no input, as ModelStructure says."""
        if self.is_ours:
            return frozenset()  # all of ours say so, also a law that follows its inputs
        free = {
            unknown.variable.name
            for unknown in self.description.outputs
            if unknown.dependencies is not None
            and all(v.causality != "input" for v in unknown.dependencies)
        }
        return frozenset(n for n, scalar in self.variables.items() if scalar.variable.name in free)

    def restructured(self, values: Mapping[str, object]) -> Fmu:
        """Return the FMU with the arrays' shapes that values of structural parameters give."""
        sizes = {
            name: int(self.variables[name].checked(f"{self.label}: {name}", value))
            for name, value in values.items()
            if name in self.structural
        }
        if not sizes:
            return self
        other = copy(self)
        other.sizes, other._described = sizes, {}
        other.variables = other._scalars()
        return other

    @property
    def in_python(self) -> bool:
        """Whether PythonFMU's wrapper runs it, in the Python of this process."""
        return "PythonFMU" in (self.description.generationTool or "")

    @property
    def tolerance(self) -> float | None:
        """Relative tolerance of the default experiment; None: it has none."""
        text = getattr(self.description.defaultExperiment, "tolerance", None)
        return finite_number(text or "") or None

    @property
    def is_ours(self) -> bool:
        """Whether this project made it; its models have no end, and may go beyond a stop."""
        return (self.description.generationTool or "").startswith("panda-cosim")

    @property
    def answers_at_end(self) -> bool:
        """Whether its outputs belong to the end of a step; our controllers' belong to its begin."""
        return self.is_model or not self.is_ours

    @property
    def code(self) -> str:
        """What runs in it: "native" code, or "python" in our host or in PythonFMU's wrapper."""
        host = self.folder / "resources" / "python_host.py"
        return "python" if self.in_python or host.is_file() else "native"

    def check_restorable(self, whose: str) -> None:
        """Refuse an FMU whose state cannot be saved and restored; `whose` is for the message."""
        if not self.description.coSimulation.canGetAndSetFMUstate:
            must = f"must have canGetAndSetFMU{'s' if self.fmi == 2 else 'S'}tate"
            raise InputError(f"{self.label}: {whose} cannot restore its state; its FMU {must}")

    def variable(self, name: str) -> Scalar:
        """Return a scalar; raises InputError if there is no variable of this name."""
        if scalar := self.variables.get(name) or self._described.get(name):
            return scalar
        raise InputError(f"{self.label}: no variable {name!r}{did_you_mean(name, self.variables)}")


def read_fmu(path: Path, label: str = "") -> Fmu:
    """Read an FMU; one that has been read before is not read again until its file changes."""
    modified = path.stat().st_mtime_ns if path.is_file() else 0
    known = path.absolute(), label or str(path), modified
    if not _read_once(*known).library.is_file():  # the cache was cleared meanwhile
        _read_once.cache_clear()
    return _read_once(*known)


@lru_cache(maxsize=64)
def _read_once(path: Path, label: str, _modified: int) -> Fmu:
    return Fmu(path, label)


def read_value(place: str, variable: Variable, text: str) -> Value:
    """Return the value that is written in an XML file; `place` is for messages."""
    try:
        return _parsed(variable, text)
    except (ValueError, KeyError):
        valid = variable.fmi_type or variable.kind
        raise InputError(f"{place} {excerpt(text)}; must be of type {valid}") from None


def _parsed(variable: Variable, text: str) -> Value:
    if variable.kind in TEXTS:
        return text
    text = text.strip()
    if variable.kind == "Boolean":
        return {"true": True, "1": True, "false": False, "0": False}[text.lower()]  # Python's True
    if variable.choices:
        numbers = {variable.number_of(choice): choice for choice in variable.choices}
        return text if text in variable.choices else numbers[int(text)]
    if "_" in text or not text.isascii():  # which Python takes, but not XML
        raise ValueError(text)
    is_whole = variable.fmi_type in INTEGERS and text.lstrip("+-").isdigit()
    return int(text) if is_whole or variable.kind != "Real" else float(text)


@cache
def load_fmpy() -> Any:
    """Import FMPy, which takes 0.2 s, and says on ARM that it has no proxy for loggers there."""
    with redirect_stdout(StringIO()):
        import fmpy  # noqa: PLC0415 - see above
    return fmpy


def _read_description(label: str, folder: Path, root: ET.Element) -> Any:
    read_model_description = load_fmpy().read_model_description
    place = f"{label}: modelDescription.xml"
    version = root.get("fmiVersion")
    if root.tag != "fmiModelDescription" or version not in VERSIONS:
        must = "must be a fmiModelDescription of '2.0' or '3.0'"
        raise InputError(f"{place}: {excerpt(root.tag)} of fmiVersion {version!a}; {must}")
    try:
        try:
            description = read_model_description(str(folder), validate=False)
        except Exception:  # of any type; the schema's words say more than its own
            description = read_model_description(str(folder), validate=True)
    except Exception as error:
        why = f"{type(error).__name__}: {one_line(error)}"
        raise InputError(f"{place}: cannot be read: {why}") from error
    if description.coSimulation is None:
        raise InputError(f"{label}: not a co-simulation FMU; it must have a <CoSimulation> element")
    identifier = description.coSimulation.modelIdentifier or ""
    if not _IDENTIFIER.fullmatch(identifier):
        refuse(f"{label}: modelIdentifier", identifier, "must be letters, digits, _ and -")
    return description


def library_of(label: str, folder: Path, description: Any) -> Path:
    """Return the FMU's library for this platform."""
    fmpy = load_fmpy()
    platforms = [fmpy.platform_tuple]
    if description.fmiVersion == "2.0":  # whose names are those of x86; FMPy has no others
        platforms.insert(0 if platforms[0].startswith("x86") else 1, fmpy.platform)
    name = f"{description.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
    places = [Path("binaries", platform, name) for platform in platforms]
    for place in places:
        # Some tools name the library after the file; where it is the only one, it is meant.
        found = [*(folder / place.parent).glob(f"*{fmpy.sharedLibraryExtension}")]
        if len(found) == 1 or folder / place in found:
            return found[0] if len(found) == 1 else folder / place
    raise InputError(f"{label}: no binary for this platform; {places[0]} is missing")


@cache
def _reader() -> str:
    """Hash of the code that reads a description."""
    return digest(package_version("fmpy"), code_digest(), Path(__file__).read_bytes())


def read_units(place: str, elements: Iterable[ET.Element]) -> Units:
    """Read definitions of units of an FMU or an SSP; a unit may lack its base units."""
    units = {}
    bases = {each.get("name", ""): each.find("{*}BaseUnit") for each in elements}
    for name, base in bases.items():
        if base is not None:
            units[name] = _unit(f"{place}: BaseUnit of {excerpt(name)}", base)
    return units


def _unit(place: str, base: ET.Element) -> Unit:
    numbers = [finite_number(base.get(key, preset)) for key, preset in _ATTRIBUTES.items()]
    *exponents, factor, offset = (number or 0.0 for number in numbers)
    if None in numbers or not factor:
        raise InputError(f"{place}; must have whole exponents, a factor other than 0 and an offset")
    return Unit(tuple(map(int, exponents)), factor, offset)


def _scalars(place: str, described: Sequence[Any], sizes: Mapping[str, int]) -> Iterator[Scalar]:
    """Yield the scalars of FMPy's `ModelVariable`s."""
    elements = 0
    for each in described:
        variable = _variable(f"{place}: {each.name!a}", each, sizes)
        elements += variable.size if variable.shape else 0
        check_elements(f"{place}: {each.name!a}", elements)
        yield from variable.scalars(each.valueReference, stride=0)


def _stated(described: Any, attribute: str) -> Any:
    """An attribute of a variable, or else of its declared type; None: neither has it."""
    return getattr(described, attribute, None) or getattr(described.declaredType, attribute, None)


def _shape(described: Any, sizes: Mapping[str, int]) -> tuple[int, ...]:
    """Shape of a variable for some values of structural parameters."""
    names = [getattr(each.variable, "name", "") for each in described.dimensions]
    return tuple(sizes.get(n, size) for n, size in zip(names, described.shape or (), strict=True))


def _noted_names(root: ET.Element) -> dict[str, list[str]]:
    """Names of an array's elements without `--fmi 3` and `--names flat`, in an FMU of ours."""
    return {
        variable.get("name", ""): [name.text or "" for name in note]
        for variable in root.iterfind("ModelVariables/*")
        for note in variable.iterfind("Annotations/*")
        if _NAMES_NOTE in note.attrib.values()
    }


def _variable(place: str, described: Any, sizes: Mapping[str, int]) -> Variable:
    """Return one of FMPy's `ModelVariable`s as a row of an interface table."""
    items = getattr(described.declaredType, "items", ())
    shape, is_structural = _shape(described, sizes), described.causality == STRUCTURAL

    def bound(side: str) -> float | None:
        text = _stated(described, side)
        return None if text is None else float(read_value(f"{place}: {side}", _NUMBER, text))

    variable = Variable(
        described.name,
        shape,
        _stated(described, "unit") or "",
        "parameter" if is_structural else described.causality,
        cast("Variability", "fixed" if is_structural else described.variability or ""),
        described.description or "",
        minimum=bound("min"),
        maximum=bound("max"),
        nominal=bound("nominal"),
        kind=cast("Kind", _KINDS.get(described.type, described.type)),
        has_start=_has_start(described),
        choices=tuple(item.name for item in items),
        numbers=tuple(int(item.value) for item in items),
        fmi_type=described.type,
    )
    # What an array of another shape starts with is not described.
    if described.start is None or shape != tuple(described.shape or ()):
        return variable
    return replace(variable, start=_start(f"{place}: start", variable, described.start))


def _has_start(described: Any) -> bool:
    """Whether what the FMU computes starts from a value that can be set."""
    is_open = described.initial in ("exact", "approx") and described.variability != "constant"
    return is_open and described.causality in _COMPUTED


def _start(place: str, variable: Variable, text: str | None) -> Any:
    """Start value of each element; a single value in the description applies to all."""
    if text is None or variable.kind in TEXTS:
        return text
    values = tuple(read_value(place, variable, part) for part in text.split())
    if len(values) > 1:
        return (*values, *[None] * (variable.size - len(values)))[: variable.size]
    return values[0] if values else None


# As a table.


def described_interface(fmu: Fmu) -> Interface:
    """Return an FMU's interface; scalars `q[1]`, `q[2]` become one variable `q` of shape (2,)."""
    # Its value references are not those of the FMU.
    order = (*_SHOWN, *_COMPUTED[1:])
    scalars = [
        scalar
        for scalar in fmu.variables.values()
        if scalar.variable.causality in _SHOWN or scalar.variable.has_start
    ]
    scalars.sort(key=lambda scalar: order.index(scalar.variable.causality))
    groups = (_joined(list(group)) for _, group in groupby(scalars, key=_array))
    return Interface(
        fmu.description.modelName or fmu.path.stem,
        fmu.description.description or "",
        tuple(chain.from_iterable(groups)),
        units=fmu.units,
        is_model=fmu.is_model,
        independent=fmu.independent,
    )


def _array(scalar: Scalar) -> tuple[str | bool, ...]:
    """What the elements of one array have in common."""
    variable, match = scalar.variable, _ELEMENT.fullmatch(scalar.name)
    name = match[1] if match else scalar.name
    kind = (variable.variability, variable.kind, variable.fmi_type, variable.has_start)
    return name, variable.causality, *kind


def _joined(scalars: Sequence[Scalar]) -> Iterable[Variable]:
    """Return one array if the scalars are all of its elements, row by row; else each of them."""
    last = _ELEMENT.fullmatch(scalars[-1].name)
    if last is not None:
        shape = tuple(int(n) for n in last[2].split(","))
        array = _table_row(last[1], shape, scalars)
        if all(shape) and array.size == len(scalars) and array.names() == [s.name for s in scalars]:
            return [array]
    return [_table_row(scalar.name, (), [scalar]) for scalar in scalars]


def _table_row(name: str, shape: tuple[int, ...], scalars: Sequence[Scalar]) -> Variable:
    first = scalars[0].variable
    units = tuple(s.unit for s in scalars)
    texts = list(dict.fromkeys(s.variable.description for s in scalars))
    kinds = {"parameter": "tunable" if first.variability == "tunable" else "fixed"}
    kinds["input"] = first.variability or ("continuous" if first.kind == "Real" else "discrete")
    return replace(
        first,
        name=name,
        shape=shape,
        description="; ".join(texts[:_FEW]) + "; ..." * (len(texts) > _FEW),
        details=tuple(s.variable.description for s in scalars) if any(map(address, texts)) else (),
        unit=units[0] if len(set(units)) == 1 else units,
        variability=cast("Variability", kinds.get(first.causality, "continuous")),
        start=_each(s.start for s in scalars) if len(scalars) > 1 else scalars[0].start,
        minimum=_each(s.minimum for s in scalars),
        maximum=_each(s.maximum for s in scalars),
        kind="Real" if first.kind in _NUMBERS else first.kind,
        multiple_of=1.0 if first.kind == "Integer" else None,
    )


def _each(values: Iterable[Any]) -> Any:
    """Values of all elements; None if any element has none."""
    known = tuple(values)
    return None if None in known else known
