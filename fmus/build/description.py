"""What an FMU says about itself: modelDescription.xml, and documents for human readers.

The templates are in `templates/`; this module computes the values that fill them.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from inspect import cleandoc
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ..errors import InputError, shown
from ..interface.units import DISPLAY_UNITS, NOMINALS, OUR_UNITS
from ..interface.variables import Interface, Numbers, Scalar, Value, Variable
from .engines import DEPENDENCIES
from .libraries import NEED_MUJOCO, licences, own_licences

if TYPE_CHECKING:
    from .native import NativeFmu

_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
ABOUT: Final[Mapping[str, str]] = _TABLES["about"]
LOG_CATEGORIES: Final[Mapping[str, str]] = _TABLES["log_categories"]
PICTURES: Final[Mapping[str, str]] = _TABLES["pictures"]
STOP_TIME = 6.5  # [s] of the shipped scenarios
DATE: Final = "2026-01-01T00:00:00Z"  # fixed: equal contents, equal bytes
NOTHING: Final = "Nothing: neither Python nor any library that it does not contain."
_FEW: Final = 12  # most values shown in a table's cell of the documentation
_PART: Final = r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?"
_STRUCTURED: Final = re.compile(rf"{_PART}(\.{_PART})*", re.A)  # as `arm.joint[3].angle`


@dataclass(frozen=True)
class Layout:
    """How an FMU's description shows the variables."""

    fmi: int = 2
    scalars: bool = False  # FMI 3.0 without arrays; FMI 2.0 has none
    flat: bool = False  # `q_1` instead of `q[1]`


@dataclass(frozen=True)
class Described:
    """A variable as an FMU's description has it: an array of FMI 3.0, or a scalar."""

    variable: Variable
    reference: int
    whole: str  # the interface's variable that it is, or belongs to
    names: list[str]  # of its elements in our master and its recordings


def described(interface: Interface, layout: Layout) -> list[Described]:
    """Return the variables as a description has them; two must not get one name."""
    rows: list[Described] = []
    elements, has_arrays = iter(interface.scalars()), layout.fmi == 3 and not layout.scalars
    for whole in interface.variables:
        for array in whole.arrays():
            scalars = list(islice(elements, array.size))
            each = [(array, scalars)] if has_arrays else [(s.alone(), [s]) for s in scalars]
            rows += [_row(whole, *one, is_flat=layout.flat) for one in each]
    for name, count in Counter(row.variable.name for row in rows).most_common(1):
        if count > 1:
            raise InputError(f"{interface.model}: two variables would have the name {name!r}")
    return rows


def _row(whole: Variable, own: Variable, scalars: Sequence[Scalar], *, is_flat: bool) -> Described:
    name = re.sub(r"\W+", "_", own.name, flags=re.A).strip("_") if is_flat else own.name
    names, reference = [scalar.name for scalar in scalars], scalars[0].value_reference
    return Described(replace(own, name=name), reference, whole.name, names)


def members(fmu: NativeFmu, layout: Layout) -> dict[str, bytes]:
    """Return the members of an FMU's archive that describe it, by path."""
    rows, interface = described(fmu.interface, layout), fmu.interface
    xml = {"modelDescription.xml": _model_description(fmu, layout.fmi, rows)}
    if layout.fmi == 3 and interface.terminals:
        terminals = {
            name: [row.variable.name for row in rows if row.whole in variables]
            for name, variables in interface.terminals.items()
        }
        content = render("terminals.xml.j2", terminals=terminals)
        xml["terminalsAndIcons/terminalsAndIcons.xml"] = content
    return xml | _documents(fmu, layout)


def _model_description(fmu: NativeFmu, fmi: int, rows: Sequence[Described]) -> bytes:
    variables = [row.variable for row in rows]
    used = {v.unit for v in variables} - {""} | ({"s"} if fmi == 3 else set())
    return render(
        f"fmi{fmi}.xml.j2",
        fmu=fmu,
        about={"author": fmu.interface.author or None} if fmu.law else ABOUT,  # who uses us, or we
        version=version("panda-cosim"),
        date=DATE,
        log_categories=LOG_CATEGORIES,
        # Of a slave, which may have any names.
        naming="structured" if all(_STRUCTURED.fullmatch(v.name) for v in variables) else "flat",
        units={name: OUR_UNITS[name] for name in sorted(map(str, used))},
        display_units=DISPLAY_UNITS,
        rows=rows,
    )


def _type(variable: Variable) -> dict[str, object]:
    """Attributes of a variable's type; bounds of an array are the widest of its elements'."""
    scalars, unit = variable.scalars(0), str(variable.unit)
    starts = [literal(scalar, scalar.start) for scalar in scalars if scalar.start is not None]
    return {
        # FMI wants a type's name to be different from all variables'.
        "declaredType": f"{variable.name}_type" if variable.kind == "Enumeration" else None,
        "unit": unit or None,
        "displayUnit": DISPLAY_UNITS.get(unit, (None,))[0],
        "nominal": NOMINALS.get(unit) if variable.kind == "Real" else None,
        "min": _widest(variable.minimum, min),
        "max": _widest(variable.maximum, max),
        "start": " ".join(starts) if starts else None,
    }


def _widest(bounds: Numbers | None, choose: Callable[[Iterable[float]], float]) -> float | None:
    """Return the widest of some bounds; None: there is none."""
    if bounds is None:
        return None
    widest = choose(bounds) if isinstance(bounds, tuple) else bounds
    return float(widest) if math.isfinite(widest) else None


def literal(scalar: Scalar, value: Value) -> str:
    """Format a value for an XML attribute of FMI or SSP; an enumeration's is a number."""
    converted = value if scalar.variable.kind == "Binary" else scalar.converted(value)
    return str(converted).lower() if isinstance(converted, bool) else str(converted)


def _documents(fmu: NativeFmu, layout: Layout) -> dict[str, bytes]:
    needs, folder = fmu.needs, "documentation/licenses"
    if fmu.backend != "pythonfmu":
        glibc = "2.27" if fmu.backend in NEED_MUJOCO else "2.17"
        needs += (f"Linux: glibc {glibc} or newer. Windows: 10 or newer. macOS: 11 or newer.",)
    packages = {package: version(package) for package in fmu.holds}
    files = {
        "documentation/index.html": documentation(fmu, layout, needs),
        DEPENDENCIES: "\n".join((*needs, "")).encode(),
        f"{folder}/third_party.txt": render("third_party.txt.j2", fmu=fmu, packages=packages),
    }
    texts = own_licences()
    for package in packages:
        texts |= {f"{package}-{name}.txt": text for name, text in licences(package).items()}
    files |= {f"{folder}/{name}": text for name, text in texts.items()}
    if fmu.model in PICTURES:
        place = "model.png" if layout.fmi == 2 else "terminalsAndIcons/icon.png"
        files[place] = Path(__file__).with_name(PICTURES[fmu.model]).read_bytes()
    return files


def documentation(fmu: NativeFmu, layout: Layout, needs: tuple[str, ...]) -> bytes:
    """Make documentation/index.html."""
    tables: dict[str, list[tuple[str, Variable]]] = {}
    names = {r.reference: r.variable.name for r in described(fmu.interface, layout)}
    for row in described(fmu.interface, replace(layout, fmi=3, scalars=False)):
        last = names.get(row.reference + row.variable.size - 1)
        label = names[row.reference] + (f" to {last}" if last and row.variable.size > 1 else "")
        tables.setdefault(row.variable.causality, []).append((label, row.variable))
    return render(
        "documentation.html.j2",
        fmu=fmu,
        fmi=layout.fmi,
        tables=tables,
        law=cleandoc(fmu.law),
        coupled=fmu.model in PICTURES,
        needs=needs,
    )


def listed(value: object) -> str:
    """Format a value, or several; none and infinite bounds as "". Shortens long lists."""
    values = value if isinstance(value, tuple) else (value,)
    if all(v is None or v in (math.inf, -math.inf) for v in values):
        return ""
    shown = [f"{v:g}" if isinstance(v, float) else str(v) for v in values[:_FEW]]
    return ", ".join(shown) + ", ..." * (len(values) > _FEW)


def render(name: str, **context: Any) -> bytes:
    """Fill in a file of `templates/`; text is escaped for XML and HTML."""
    import jinja2  # noqa: PLC0415 - takes 50 ms

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_escaped,
        keep_trailing_newline=True,
    )
    environment.filters |= {"shown": _escaped, "type": _type, "listed": listed}
    return environment.get_template(name).render(**context).encode()


# Escapes characters that XML cannot hold, such as those in names of an MJCF file.
_escaped: Final = partial(shown, limit=None)
