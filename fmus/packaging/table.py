"""`resources/variables.txt` of a native FMU; `fmus/native/README.md` describes the file."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from urllib.parse import quote

from ..interface.variables import Interface, Numbers, Variable

Option = tuple[str, str]


def table(interface: Interface, token: str, step_size: float, options: Iterable[Option]) -> bytes:
    """Write the table of an FMU.

    Args:
        interface: Its variables; `Variable.source` in the backend's form.
        token: Its GUID or instantiation token.
        step_size: Internal step [s].
        options: Keys and values for the backend.
    """
    lines = [["fmu", "1"], ["token", token], ["step", bits(step_size)]]
    lines += [["option", key, text(value)] for key, value in options]
    reference = 0
    for variable in interface.variables:
        lines.append(["variable", str(reference), *_fields(variable)])
        reference += variable.size
    time = [str(reference), "-", "independent", "continuous", "Real", interface.time_name]
    lines.append(["variable", *time, "-", "-", "-", "-"])
    return "".join("\t".join(fields) + "\n" for fields in lines).encode()


def _fields(variable: Variable) -> list[str]:
    return [
        "x".join(map(str, variable.shape)) or "-",
        variable.causality,
        variable.variability,
        variable.kind,
        text(variable.name),
        _start(variable),
        *map(_numbers, _bounds(variable)),
        text(variable.source) or "-",
    ]


def _start(variable: Variable) -> str:
    start = variable.start
    if variable.kind == "String":
        return text("" if start is None else str(start))
    if variable.kind == "Enumeration":
        return bits(variable.choices.index(str(start)) + 1.0)
    return _numbers(float(start) if isinstance(start, (bool, str)) else start)


def _bounds(variable: Variable) -> tuple[Numbers | None, Numbers | None]:
    """Lowest and highest values; those of an enumeration are the numbers of its items."""
    if variable.kind == "Enumeration":
        return 1.0, float(len(variable.choices))
    return variable.minimum, variable.maximum


def _numbers(values: Numbers | None) -> str:
    if values is None:
        return "-"
    parts: Sequence[float] = values if isinstance(values, tuple) else (values,)
    return " ".join(map(bits, parts))


def bits(number: float) -> str:
    """The bits of a number, independent of locale and rounding."""
    return struct.pack(">d", number).hex()


def text(written: str) -> str:
    """Text with the field separators escaped."""
    return quote(written, safe="".join(map(chr, (*range(32, 37), *range(38, 127)))))
