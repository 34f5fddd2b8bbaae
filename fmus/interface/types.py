"""Types of values: how rows and columns hold them, and which can feed which without loss."""

from __future__ import annotations

from typing import Any, Final

from .variables import INTEGERS, Scalar, Value, Variable

# Bits of the whole numbers that a type holds without a gap, and whether one is the sign's.
_WHOLE: Final = {
    **INTEGERS,
    "Float64": (54, True),
    "Float32": (25, True),
    "Enumeration": (32, True),
}
_FMI2: Final = {"Real": "Float64", "Integer": "Int32"}
# Values that a float64 cannot hold; rows with such values hold Python's objects.
OBJECTS: Final = ("Int64", "UInt64", "String", "Binary")
_COLUMNS: Final = {
    "Float64": "double", "Float32": "float", "Boolean": "bool", "Enumeration": "int64",
}  # fmt: skip


def type_of(variable: Variable) -> str:
    """Type of a variable, as FMI 3.0 names it."""
    name = variable.fmi_type or variable.kind
    return _FMI2.get(name, name)


def column_type(variable: Variable) -> str:
    """Type of a variable's column in a recording, as Arrow names it."""
    name = type_of(variable)
    return _COLUMNS.get(name, name.lower())


def in_row(scalar: Scalar, value: Value | None) -> Any:
    """Return a value as rows hold it; None: the start value, or zero."""
    held = scalar.start_value() if value is None else scalar.converted(value)
    return held if type_of(scalar.variable) in OBJECTS else float(held)


def is_lossless(source: Variable, target: Variable) -> bool:
    """Whether the target's type holds every value of the source's."""
    one, other = type_of(source), type_of(target)
    if other == "Enumeration":  # that an integer is one of its numbers is checked at run time
        return one in INTEGERS or (one == other and _numbered_alike(source, target))
    if one == other:
        return True
    if one.startswith("Float") or not {one, other} <= _WHOLE.keys():
        return (one, other) == ("Float32", "Float64")
    (bits, signed), (room, can_be_negative) = _WHOLE[one], _WHOLE[other]
    return room - can_be_negative >= bits - signed and can_be_negative >= signed


def _numbered_alike(source: Variable, target: Variable) -> bool:
    """Whether an enumeration has another's numbers, and the same number for the same name."""
    ours, theirs = ({n: each.number_of(n) for n in each.choices} for each in (source, target))
    is_same = all(theirs.get(name, number) == number for name, number in ours.items())
    return not theirs or (is_same and {*ours.values()} <= {*theirs.values()})


def can_convert(source: Variable, target: Variable) -> bool:
    """Whether a source's values can be converted where that is asked for: all numbers can."""
    return not {type_of(source), type_of(target)} & {"String", "Binary"}
