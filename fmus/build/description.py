"""What an FMU says about itself: modelDescription.xml, and documents for human readers.

The templates are in `templates/`; this module computes the values that fill them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import distribution, version
from inspect import cleandoc
from pathlib import Path
from typing import Any, Final

from ..inside.base import LOG_CATEGORIES, TICK
from ..interface.variables import Interface, Numbers, Scalar, Variable
from ..messages import shown
from .libraries import MUJOCO, NEED_MUJOCO, licence, own_licences

AUTHOR = "The panda-cosim engineers"
LICENSE = "Apache-2.0"
COPYRIGHT = "Copyright 2026 The panda-cosim engineers"
STOP_TIME = 6.5  # [s] of the shipped scenarios
# Exponents of the SI base units; FMI counts rad among them.
BASE_UNITS: dict[str, dict[str, str]] = {
    "1": {}, "m": {"m": "1"}, "kg": {"kg": "1"}, "s": {"s": "1"}, "rad": {"rad": "1"},
    "kg.m2": {"kg": "1", "m": "2"},
    "1/s": {"s": "-1"}, "m/s": {"m": "1", "s": "-1"}, "rad/s": {"rad": "1", "s": "-1"},
    "m/s2": {"m": "1", "s": "-2"}, "rad/s2": {"rad": "1", "s": "-2"},
    "m/rad": {"m": "1", "rad": "-1"}, "rad/m": {"rad": "1", "m": "-1"},
    "N": {"kg": "1", "m": "1", "s": "-2"}, "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "N.m/rad": {"kg": "1", "m": "2", "s": "-2", "rad": "-1"}, "N/m": {"kg": "1", "s": "-2"},
    "N.m.s/rad": {"kg": "1", "m": "2", "s": "-1", "rad": "-1"},
}  # fmt: skip
_PART: Final = r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?"
_STRUCTURED: Final = re.compile(rf"{_PART}(\.{_PART})*", re.A)  # as `arm.joint[3].angle`


@dataclass(frozen=True)
class Identity:
    """Identifies one build of an FMU."""

    token: str  # GUID of FMI 2.0, instantiation token of FMI 3.0; a hash of the content
    version: str  # of the project
    tool: str = "panda-cosim"  # generation tool
    step_size: float = TICK  # internal step [s]; 0: any communication step is taken as it is
    stop_time: float = STOP_TIME  # of the default experiment [s]
    date: str = "2026-01-01T00:00:00Z"  # ISO 8601 in UTC; fixed: equal contents, equal bytes


def model_description(interface: Interface, identity: Identity, fmi: int = 2) -> bytes:
    """Make modelDescription.xml of FMI 2.0 or 3.0, in UTF-8."""
    scalars = interface.scalars()
    first = {id(s.variable): s.value_reference for s in reversed(scalars)}
    used = {s.unit for s in scalars if s.unit} | ({"s"} if fmi == 3 else set())
    return render(
        f"fmi{fmi}.xml.j2",
        _FILTERS,
        **vars(identity),
        model=interface.model,
        interface=interface,
        author=AUTHOR,
        copyright=COPYRIGHT,
        license=LICENSE,
        log_categories=LOG_CATEGORIES,
        naming=_naming_convention(interface),
        units={name: BASE_UNITS[name] for name in sorted(used)},
        enumerations=[v for v in interface.variables if v.kind == "Enumeration"],
        scalars=scalars,
        arrays=[(v, first[id(v)]) for v in interface.variables],
        outputs=[s for s in scalars if s.variable.causality == "output"],
        parameters=[s for s in scalars if s.variable.causality == "parameter"],
        # A user's slave, which has no internal step, may compute its first outputs from inputs.
        knows_dependencies=identity.step_size > 0.0,
    )


def terminals(interface: Interface) -> bytes:
    """Make terminalsAndIcons.xml of FMI 3.0."""
    return render("terminals.xml.j2", {}, interface=interface)


def _type_name(variable: Variable) -> str:
    """Name of an enumeration's type, which FMI wants to be different from all variables' names."""
    return f"{variable.name}_type"


def _naming_convention(interface: Interface) -> str:
    """FMI's `variableNamingConvention`; a slave's variables may have any names."""
    names = (variable.name for variable in interface.variables)
    return "structured" if all(map(_STRUCTURED.fullmatch, names)) else "flat"


def literal(value: float | bool | str) -> str:
    """Format a value for an XML attribute of FMI or SSP."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else repr(float(value))


def _number(value: float | None) -> str | None:
    return None if value is None or math.isinf(value) else repr(float(value))


def _start(scalar: Scalar) -> str | None:
    """Start value; for an enumeration, its number."""
    if scalar.start is None:
        return None
    if scalar.variable.kind == "Enumeration":
        return str(scalar.variable.choices.index(str(scalar.start)) + 1)
    if scalar.variable.kind == "Integer":
        return str(int(scalar.start))
    return literal(scalar.start)


def _starts(variable: Variable) -> str | None:
    """Start values of an array."""
    starts = [_start(scalar) for scalar in variable.scalars(0)]
    return None if None in starts else " ".join(map(str, starts))


def _common_unit(variable: Variable) -> str | None:
    """Unit of an array, or None: FMI 3.0 cannot express several units in one array."""
    units = set(variable.units)
    return units.pop() or None if len(units) == 1 else None


def _extreme(pick: Callable[[Iterable[float]], float], bound: Numbers | None) -> str | None:
    """Bound of an array: the lowest or highest of its elements' bounds."""
    return None if bound is None else _number(pick(_parts(bound)))


def _parts(bound: Numbers | None) -> tuple[float, ...]:
    return bound if isinstance(bound, tuple) else () if bound is None else (bound,)


_FILTERS: Final[Mapping[str, Callable[..., str | None]]] = {
    "number": _number,
    "type_name": _type_name,
    "start": _start,
    "starts": _starts,
    "common_unit": _common_unit,
    "lowest": partial(_extreme, min),
    "highest": partial(_extreme, max),
}


# For human readers.

PICTURES: Final = {
    "PandaPlant": "plant.png",
    "PandaController": "controller.png",
    "PandaTrajectory": "trajectory.png",
}
NOTHING: Final = "Nothing: neither Python nor any library that it does not contain."
_FEW: Final = 12  # most values shown in a table's cell
_HEADERS: Final = "FMI headers (BSD-2-Clause, Modelica Association), compiled into the binaries.\n"


def documents(  # noqa: PLR0913 - the FMU, its identity and its version
    interface: Interface, identity: Identity, fmi: int, law: str, needs: tuple[str, ...],
    backend: str,
) -> dict[str, bytes]:  # fmt: skip
    """Return the members of an FMU that are for human readers, by path."""
    opens_mujoco = backend in NEED_MUJOCO
    glibc = "2.27" if opens_mujoco else "2.17"
    systems = f"Linux: glibc {glibc} or newer. Windows: 10 or newer. macOS: 11 or newer."
    folder = "documentation/licenses"
    members = {
        "documentation/index.html": documentation(interface, identity, fmi, law, (*needs, systems)),
        "documentation/externalDependencies.txt": "\n".join((*needs, systems, "")).encode(),
        **{f"{folder}/{name}": text for name, text in own_licences().items()},
        f"{folder}/third_party.txt": _third_party(backend).encode(),
    }
    for file in distribution(MUJOCO).files or [] if opens_mujoco else []:
        if "dist-info/licenses" in str(file):
            members[f"{folder}/{MUJOCO}-{file.stem}.txt"] = licence(MUJOCO, file.name)
    picture = PICTURES.get(interface.model)
    if picture:
        place = "model.png" if fmi == 2 else "terminalsAndIcons/icon.png"
        members[place] = Path(__file__).with_name(picture).read_bytes()
    return members


def documentation(
    interface: Interface, identity: Identity, fmi: int, law: str, needs: tuple[str, ...]
) -> bytes:
    """Make documentation/index.html."""
    return render(
        "documentation.html.j2",
        {"listed": listed, "shaped_name": shaped_name, "units": units, "range": value_range},
        interface=interface,
        token=identity.token,
        step_size=f"{identity.step_size:g}",
        fmi=fmi,
        law=cleandoc(law),
        needs=needs,
        coupled=interface.model in PICTURES,
    )


def _third_party(backend: str) -> str:
    """Third-party software that an FMU contains or uses."""
    if backend == "python":
        return (
            f"In this FMU: {_HEADERS}Used at run time, not contained in the FMU:\n"
            "  Python (Python Software Foundation License) and the packages that it needs.\n"
        )
    if backend not in NEED_MUJOCO:
        return f"In this FMU: {_HEADERS}"
    engine = f"MuJoCo {version(MUJOCO)} (Apache-2.0, DeepMind Technologies), beside them.\n"
    return f"In this FMU:\n  {_HEADERS}  {engine}"


def shaped_name(variable: Variable) -> str:
    """Name with the ranges of its indices, such as `jac[1..6,1..7]`."""
    indices = ",".join(f"1..{n}" for n in variable.shape)
    return f"{variable.name}[{indices}]" if indices else variable.name


def units(variable: Variable) -> str:
    """Units of a variable, each once; its type if it has no unit."""
    return ", ".join(dict.fromkeys(filter(None, variable.units))) or variable.kind


def listed(value: object) -> str:
    """Format a value, or several; shortens long lists."""
    if value is None:
        return ""
    values = value if isinstance(value, tuple) else (value,)
    shown = [f"{v:g}" if isinstance(v, float) else str(v) for v in values[:_FEW]]
    return ", ".join(shown) + ", ..." * (len(values) > _FEW)


def value_range(variable: Variable) -> str:
    """Range of valid values, or "" if all are valid."""
    if variable.choices:
        return ", ".join(f"{i}: {name}" for i, name in enumerate(variable.choices, 1))
    bounds = (variable.minimum, variable.maximum)
    written = [listed(bound) if any(map(math.isfinite, _parts(bound))) else "" for bound in bounds]
    return " to ".join(written) if any(written) else ""


def render(name: str, filters: Mapping[str, Callable[..., Any]], **context: Any) -> bytes:
    """Fill in a file of `templates/`; text is escaped for XML and HTML."""
    import jinja2  # noqa: PLC0415 - takes 50 ms

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_escaped,
        keep_trailing_newline=True,
    )
    environment.filters |= {"shown": _escaped, **filters}
    return environment.get_template(name).render(**context).encode()


def _escaped(value: object) -> object:
    """Escape characters that XML cannot hold, such as those in names of an MJCF file."""
    return shown(value, limit=None)
