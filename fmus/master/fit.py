"""Whether FMUs fit together: that what is connected exists, flows the right way, in one unit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from ..errors import InputError
from ..interface.tables import Connection
from ..interface.variables import Value
from ..messages import did_you_mean
from .fmu_file import Fmu, FmuVariable

Name = tuple[str, str]  # instance and scalar variable


def check_fit(
    fmus: Mapping[str, Fmu],
    connections: Sequence[Connection],
    external: Sequence[Name],
    outputs: Mapping[str, Sequence[str]],
) -> None:
    """Check a coupled system against its FMUs' descriptions.

    Args:
        fmus: The FMU of each instance.
        connections: Which output feeds which input.
        external: Inputs that are given from outside.
        outputs: Outputs that are read, by instance.

    Raises:
        InputError: A variable is missing, is no Real, flows the other way, or is in another unit
            than what it is connected to.
    """
    for target, place in _targets(connections, external):
        _real(fmus, target, place, "input")
    for instance, names in outputs.items():
        for name in names:
            _real(fmus, (instance, name), "recording", "output")
    for connection in connections:
        place = f"connection of {'.'.join(connection.source)} to {'.'.join(connection.target)}"
        source = _real(fmus, connection.source, place, "output")
        fed = _real(fmus, connection.target, place, "input")
        if None not in (source.unit, fed.unit) and source.unit != fed.unit:
            raise InputError(
                f"{place}: unit {source.unit!r} feeds unit {fed.unit!r}; must be the same"
            )


def check_start_values(
    fmus: Mapping[str, Fmu], start_values: Mapping[str, Mapping[str, Value]]
) -> None:
    """Check start values against the FMUs' descriptions.

    Raises:
        InputError: A variable is missing, cannot be set, or its value is out of its bounds.
    """
    for instance, values in start_values.items():
        if instance not in fmus:
            raise InputError(f"start value of {instance!r}: no such instance")
        for name, value in values.items():
            variable = fmus[instance].variable(name)
            place = f"{fmus[instance].path}: {name}"
            if variable.causality not in ("parameter", "input"):
                raise InputError(f"{place}: causality {variable.causality}; cannot be set")
            if variable.type in ("Real", "Integer"):
                _check_bounds(place, variable, value)
            elif variable.type == "Enumeration":
                _check_choice(place, variable, value)


def _check_bounds(place: str, variable: FmuVariable, value: Value) -> None:
    low = -math.inf if variable.minimum is None else variable.minimum
    high = math.inf if variable.maximum is None else variable.maximum
    if isinstance(value, str) or not (math.isfinite(value) and low <= value <= high):
        raise InputError(f"{place}: value {value!r}; must be a number from {low:g} to {high:g}")


def _check_choice(place: str, variable: FmuVariable, value: Value) -> None:
    """Refuse what is neither the name nor the number of an enumeration's item."""
    if value not in variable.choices.values() and value not in variable.choices:
        near = did_you_mean(str(value), variable.choices.values())
        valid = ", ".join(variable.choices.values())
        raise InputError(f"{place}: value {value!r}; valid: {valid}{near}")


def _targets(
    connections: Sequence[Connection], external: Sequence[Name]
) -> Iterator[tuple[Name, str]]:
    for name in external:
        yield name, "command"
    for connection in connections:
        yield connection.target, f"connection from {'.'.join(connection.source)}"


def _real(fmus: Mapping[str, Fmu], name: Name, place: str, causality: str) -> FmuVariable:
    """Return the variable's description."""
    instance, variable_name = name
    if instance not in fmus:
        raise InputError(f"{place}: no instance {instance!r}; valid: {', '.join(fmus)}")
    fmu = fmus[instance]
    variable = fmu.variable(variable_name)
    if variable.type != "Real":
        raise InputError(
            f"{fmu.path}: {variable_name}: type {variable.type}; must be Real ({place})"
        )
    if variable.causality != causality:
        raise InputError(
            f"{fmu.path}: {variable_name}: causality {variable.causality}; must be {causality} "
            f"({place})"
        )
    return variable
