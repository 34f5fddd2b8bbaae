"""Makes an FMU's modelDescription.xml, for FMI 2.0 or 3.0, from its interface table.

The templates are in `templates/`; this module computes the values that fill them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ..interface.variables import Interface, Numbers, Scalar, Variable
from ..messages import shown
from ..inside.base import LOG_CATEGORIES, TICK

AUTHOR = "The panda-cosim engineers"
LICENSE = "Apache-2.0"
COPYRIGHT = "Copyright 2026 The panda-cosim engineers"
STOP_TIME = 6.5  # [s] of the shipped scenarios
# Exponents of the SI base units; FMI counts rad among them.
BASE_UNITS: dict[str, dict[str, str]] = {
    "1": {},
    "m": {"m": "1"},
    "kg": {"kg": "1"},
    "kg.m2": {"kg": "1", "m": "2"},
    "s": {"s": "1"},
    "rad": {"rad": "1"},
    "1/s": {"s": "-1"},
    "m/s": {"m": "1", "s": "-1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "m/s2": {"m": "1", "s": "-2"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "m/rad": {"m": "1", "rad": "-1"},
    "rad/m": {"rad": "1", "m": "-1"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "N.m/rad": {"kg": "1", "m": "2", "s": "-2", "rad": "-1"},
    "N/m": {"kg": "1", "s": "-2"},
    "N.m.s/rad": {"kg": "1", "m": "2", "s": "-1", "rad": "-1"},
}
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
    units = {scalar.unit for scalar in variable.scalars(0)}
    return units.pop() or None if len(units) == 1 else None


def _lowest(bound: Numbers | None) -> str | None:
    """Lower bound of an array: the lowest of its elements' bounds."""
    return None if bound is None else _number(min(_all(bound)))


def _highest(bound: Numbers | None) -> str | None:
    return None if bound is None else _number(max(_all(bound)))


def _all(bound: Numbers) -> tuple[float, ...]:
    return bound if isinstance(bound, tuple) else (bound,)


_FILTERS: Final[Mapping[str, Callable[..., str | None]]] = {
    "number": _number,
    "type_name": _type_name,
    "start": _start,
    "starts": _starts,
    "common_unit": _common_unit,
    "lowest": _lowest,
    "highest": _highest,
}


def render(name: str, filters: Mapping[str, Callable[..., Any]], **context: Any) -> bytes:
    """Fill in a file of `templates/`; text is escaped for XML and HTML."""
    from jinja2 import (  # noqa: PLC0415 - takes 50 ms
        Environment,
        FileSystemLoader,
        StrictUndefined,
    )

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_escaped,
        keep_trailing_newline=True,
    )
    environment.filters |= {"shown": _escaped, **filters}
    return environment.get_template(name).render(**context).encode()


def _escaped(value: object) -> object:
    """Escape characters that XML cannot hold, such as those in names of an MJCF file."""
    return shown(value, limit=None)
