"""Turns a user's parameters into FMI start values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import InputError, nearest, refuse
from .variables import Causality, Interface, Scalar, Value, Variable

ParameterValue = float | bool | str | Sequence[float]


def expand(
    instance: str,
    interface: Interface,
    by_name: Mapping[str, ParameterValue],
    causality: Causality = "parameter",
) -> dict[str, Value]:
    """Turn parameters, or inputs, that a user sets into start values by scalar variable."""
    # One number for `kp` sets all seven gains, a sequence sets each of them, and `kp[3]`, wherever
    # it stands, the third: whole vectors come first.
    wholes, values = {v.name for v in interface.variables}, dict[str, Value]()
    for name in sorted(by_name, key=lambda name: name not in wholes):
        own = targets(instance, interface, name, causality)
        parts = _parts(f"{instance}.{name}", by_name[name], len(own))
        for scalar, part in zip(own, parts, strict=True):
            values[scalar.name] = scalar.checked(f"{instance}.{scalar.name}", part)
    return values


def grouped(interface: Interface, values: Mapping[str, Value]) -> dict[str, Any]:
    """Group values of all parameters by name without indices: the inverse of `expand`."""
    return {
        variable.name: tuple(values[name] for name in variable.names())
        if variable.shape
        else values[variable.name]
        for variable in interface.of("parameter")
    }


def targets(instance: str, interface: Interface, name: str, causality: Causality) -> list[Scalar]:
    """Scalars that a name stands for: an element, or all of a vector."""
    one = interface.named.get(name)
    scalars = [one] if one else [s for s in interface.scalars() if s.variable.name == name]
    if scalars and _is(scalars[0].variable, causality):
        return scalars
    candidates = [v for v in interface.variables if _is(v, causality)]
    hint = f"valid: {', '.join([v.name for v in candidates][:40]) or 'none'}"
    what = f"no such {causality} of {interface.model}"
    if scalars:
        own = scalars[0].variable.causality
        what = f"of causality {own} in {interface.model}, not {causality}"
    elif near := nearest(name, [n for v in candidates for n in (v.name, *v.names())]):
        hint = f"did you mean {near!r}?"
    raise InputError(f"{instance}.{name}: {what}; {hint}")


def _is(variable: Variable, causality: Causality) -> bool:
    """Whether a variable is an input, or a parameter or another with a value to start from."""
    return variable.causality == causality or (causality == "parameter" and variable.has_start)


def _parts(place: str, value: ParameterValue, count: int) -> list[Value]:
    valid = f"one number for all, or {count} values" if count > 1 else "one number"
    value = _plain(value)
    if isinstance(value, (bool, str, int, float)):
        return [value] * count
    if not isinstance(value, (list, tuple)):
        refuse(place, value, f"must be {valid}")
    if len(value) != count:
        raise InputError(f"{place}: a list of {len(value)}; must be {valid}")
    return list(map(_plain, value))


def _plain(value: Any) -> Any:
    """Return numpy's numbers and arrays as Python's, everything else as it is."""
    return value.tolist() if hasattr(value, "tolist") else value


def literal(text: str) -> ParameterValue:
    """Read a value of `--set`: true, false, numbers or text."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        numbers = [_number(part) for part in text.strip("[]").split(",")]
    except ValueError:
        return text.strip("\"'")
    return numbers[0] if len(numbers) == 1 else numbers


def _number(text: str) -> float:
    """Read a number; a whole one that a float cannot hold stays an int."""
    number = float(text)
    return int(text) if abs(number) > 2**53 and text.strip().lstrip("+-").isdigit() else number
