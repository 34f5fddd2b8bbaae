"""Turns a user's parameters into FMI start values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import InputError
from ..messages import did_you_mean, excerpt, nearest
from .tables import INTERFACES
from .variables import Interface, Scalar, Value

MULTIPLE_TOLERANCE = 1e-6  # relative to the `multiple_of` of a variable

ParameterValue = float | bool | str | Sequence[float]


def expand(
    instance: str, interface: Interface, given: Mapping[str, ParameterValue]
) -> dict[str, Value]:
    """Turn given parameters into start values of scalar variables.

    Args:
        instance: Name of the FMU instance, for messages.
        interface: Its table.
        given: Parameters by name. One number for `kp` sets all seven gains, a sequence sets each
            of them, and `kp[3]`, wherever it stands, the third.

    Returns:
        Start values by scalar variable.

    Raises:
        InputError: A name is unknown or not a parameter's, or a value has the wrong type or is
            out of range.
    """
    scalars = {s.name: s for s in interface.scalars()}
    values: dict[str, Value] = {}
    for name, value in general_first(given, scalars):
        targets = _targets(instance, interface, scalars, name)
        parts = _parts(f"{instance}.{name}", value, len(targets))
        for scalar, part in zip(targets, parts, strict=True):
            values[scalar.name] = _checked(f"{instance}.{scalar.name}", scalar, part)
    return values


def general_first(
    given: Mapping[str, ParameterValue], scalars: Mapping[str, Scalar]
) -> list[tuple[str, ParameterValue]]:
    """Return whole vectors before single elements, so that no order of the names is seen."""
    return sorted(
        given.items(),
        key=lambda item: item[0] in scalars and scalars[item[0]].variable.name != item[0],
    )


def grouped(interface: Interface, values: Mapping[str, Value]) -> dict[str, Any]:
    """Group parameters of scalar variables into vectors: the inverse of `expand`.

    Args:
        interface: Their table.
        values: All parameters by scalar variable.

    Returns:
        By name without indices: a number, boolean or text, or a tuple of numbers for a vector.
    """
    return {
        variable.name: tuple(values[name] for name in variable.names())
        if variable.shape
        else values[variable.name]
        for variable in interface.of("parameter")
    }


def _targets(
    instance: str, interface: Interface, scalars: Mapping[str, Scalar], name: str
) -> list[Scalar]:
    if name in scalars:
        found = [scalars[name]]
    else:
        found = [s for s in scalars.values() if s.variable.name == name]
    if not found:
        _refuse_index(instance, interface, name)
        parameters = interface.of("parameter")
        names = [v.name for v in parameters] + [n for v in parameters for n in v.names()]
        valid = list(dict.fromkeys(names))  # for a scalar both names are the same
        near = nearest(name, valid)
        told = ", ".join([v.name for v in parameters][:40]) or "none"
        hint = f"did you mean {near!r}?" if near else f"valid: {told}"
        raise InputError(f"{instance}.{name}: no such parameter of {interface.model}; {hint}")
    if found[0].variable.causality != "parameter":
        valid = [v.name for v in interface.of("parameter")]
        raise InputError(
            f"{instance}.{name}: an {found[0].variable.causality} of {interface.model}, not a "
            f"parameter; valid: {', '.join(valid)}"
        )
    return found


def _refuse_index(instance: str, interface: Interface, name: str) -> None:
    """Say which elements a vector has, if only the index of a name is wrong."""
    for variable in interface.of("parameter"):
        if variable.shape and name.startswith(f"{variable.name}["):
            first, *_, last = variable.names()
            raise InputError(f"{instance}.{name}: no such element; must be {first} to {last}")


def _parts(place: str, value: ParameterValue, count: int) -> list[Value]:
    wanted = f"one number for all, or {count} values" if count > 1 else "one number"
    value = _plain(value)
    if isinstance(value, (bool, str, int, float)):
        return [value] * count
    if not isinstance(value, Sequence) or isinstance(value, bytes):
        raise InputError(f"{place}: value {excerpt(value)}; must be {wanted}")
    if len(value) != count:
        raise InputError(f"{place}: a list of {len(value)}; must be {wanted}")
    return list(map(_plain, value))


def _plain(value: Any) -> Any:
    """Return numpy's numbers and arrays as Python's, everything else as it is."""
    return value.tolist() if hasattr(value, "tolist") else value


def _checked(place: str, scalar: Scalar, value: Value) -> Value:
    kind = scalar.variable.kind
    if kind in ("String", "Enumeration"):
        return _checked_text(place, scalar, value)
    if kind in ("Binary", "Clock"):
        raise InputError(f"{place}: is of type {kind}; its start value cannot be changed")
    if kind == "Boolean":
        return _checked_boolean(place, value)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{place}: {value!r} is not a number{_bounds(scalar)}")
    number = float(value)
    low = -math.inf if scalar.minimum is None else scalar.minimum
    high = math.inf if scalar.maximum is None else scalar.maximum
    if not (math.isfinite(number) and low <= number <= high):
        raise InputError(f"{place}: {number!r}{_unit(scalar)} is out of range{_bounds(scalar)}")
    part = scalar.variable.multiple_of
    if part is not None and abs(number - round(number / part) * part) > MULTIPLE_TOLERANCE * part:
        raise InputError(
            f"{place}: {number!r}{_unit(scalar)}; must be a whole multiple of "
            f"{part:g}{_unit(scalar)}"
        )
    return number


def _checked_text(place: str, scalar: Scalar, value: Value) -> str:
    valid = scalar.variable.choices
    if not isinstance(value, str):
        raise InputError(f"{place}: {value!r} is not text; valid: {', '.join(valid)}")
    if valid and value not in valid:
        raise InputError(
            f"{place}: {value!r} is not one of {', '.join(valid)}{did_you_mean(value, valid)}"
        )
    return value


def _checked_boolean(place: str, value: Value) -> bool:
    if isinstance(value, bool):
        return value
    if value in (0, 1):
        return bool(value)
    raise InputError(f"{place}: {value!r} is not a boolean; must be true or false")


def _bounds(scalar: Scalar) -> str:
    low, high, unit = scalar.minimum, scalar.maximum, _unit(scalar)
    if low is not None and high is not None:
        return f"; must be between {low:g} and {high:g}{unit}"
    if low is not None:
        return f"; must be at least {low:g}{unit}"
    if high is not None:
        return f"; must be at most {high:g}{unit}"
    return "; must be a finite number"


def _unit(scalar: Scalar) -> str:
    """Unit to write after a number; "" for a dimensionless one."""
    return "" if scalar.unit in ("", "1") else f" {scalar.unit}"


def parse_assignment(
    text: str, instances: Sequence[str], keys: Sequence[str] = ()
) -> tuple[str, str, ParameterValue]:
    """Read `INSTANCE.NAME=VALUE`, such as `plant.block_pos[1]=0.45` or `controller.kp=8`.

    Args:
        text: The assignment; a list is written as `1,2,3`.
        instances: Valid instances.
        keys: What else the caller takes instead of INSTANCE.NAME; only named in the message.

    Returns:
        Instance, name and value.

    Raises:
        InputError: The text has another form, or the instance is unknown.
    """
    left, equals, right = text.partition("=")
    instance, dot, name = left.strip().partition(".")
    if not (equals and dot and name and right.strip()):
        owner = next((each for each in instances if not dot and _has(each, instance)), None)
        others = f", or KEY=VALUE with KEY one of {', '.join(keys)}" if keys else ""
        hint = f", such as plant.block_pos[1]=0.45{others}{did_you_mean(left.strip(), keys)}"
        if equals and right.strip() and owner:
            hint = f"; did you mean {owner}.{text.strip()}?"
        raise InputError(f"--set {text!r}: must be INSTANCE.NAME=VALUE{hint}")
    if instance not in instances:
        raise InputError(
            f"--set {text!r}: no instance {instance!r}; valid: {', '.join(instances)}"
            f"{did_you_mean(instance, instances)}"
        )
    return instance, name.strip(), literal(right.strip(), f"--set {text!r}: ")


def _has(instance: str, name: str) -> bool:
    """Whether one of the project's own FMUs has a parameter."""
    known = INTERFACES[instance].of("parameter") if instance in INTERFACES else ()
    return name.partition("[")[0] in [variable.name for variable in known]


def literal(text: str, place: str = "") -> ParameterValue:
    """Read a value of `--set`: true, false, numbers or text.

    Raises:
        InputError: It is a number with `_` or digits of another script; begins with the place.
    """
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    parts = text.strip("[]").split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        return text.strip("\"'")
    if not text.isascii() or "_" in text:
        plain = ",".join(f"{number:.17g}" for number in numbers)
        raise InputError(f"{place}value {excerpt(text)}; must be in the digits 0 to 9, as {plain}")
    return numbers[0] if len(numbers) == 1 else numbers
