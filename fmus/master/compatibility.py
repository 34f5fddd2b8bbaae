"""Whether FMUs can be coupled: connections exist, lead from output to input, in one unit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from ..errors import InputError
from ..interface.tables import Connection
from ..interface.variables import Value
from ..messages import did_you_mean
from .fmu_file import Fmu, FmuVariable

Name = tuple[str, str]  # instance and scalar variable
RECORDED_TYPES: Final = ("Real", "Float32", "Integer", "Enumeration", "Boolean")  # as float64
# Bits and sign of integers, by FMI type; FMI 2.0 calls its one type Integer.
INTEGERS: Final = {
    "Integer": (32, True),
    **{f"Int{bits}": (bits, True) for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": (bits, False) for bits in (8, 16, 32, 64)},
}


def check_connections(
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
        InputError: A variable is missing, has the wrong type or causality, or is connected to
            one of another unit.
    """
    fed: set[Name] = set()
    for target, place in _targets(connections, external):
        _real(fmus, target, place, "input")
        if target in fed:
            raise InputError(f"{place}: {'.'.join(target)} is fed twice; must be fed once")
        fed.add(target)
    for instance, names in outputs.items():
        for name in names:
            _variable(fmus, (instance, name), "recording", "output", RECORDED_TYPES)
    for connection in connections:
        place = f"connection of {'.'.join(connection.source)} to {'.'.join(connection.target)}"
        source = _real(fmus, connection.source, place, "output")
        taker = _real(fmus, connection.target, place, "input")
        if None not in (source.unit, taker.unit) and source.unit != taker.unit:
            raise InputError(
                f"{place}: unit {source.unit!r} feeds unit {taker.unit!r}; must be the same"
            )


def check_start_values(
    fmus: Mapping[str, Fmu], start_values: Mapping[str, Mapping[str, Value]]
) -> None:
    """Check start values against the FMUs' descriptions.

    Raises:
        InputError: A variable is missing or cannot be set, or its value is out of range.
    """
    for instance, values in start_values.items():
        if instance not in fmus:
            raise InputError(f"start value of {instance!r}: no such instance")
        for name, value in values.items():
            variable = fmus[instance].variable(name)
            place = f"{fmus[instance].label}: {name}"
            if variable.causality not in ("parameter", "input"):
                raise InputError(f"{place}: causality {variable.causality}; cannot be set")
            check_value(place, variable, value)


def check_value(place: str, variable: FmuVariable, value: Value) -> None:
    """Check a value against a variable's bounds, or against the items of an enumeration.

    Args:
        place: What to call it in messages.
        variable: The variable.
        value: The value.

    Raises:
        InputError: It is not valid.
    """
    if variable.type in ("Real", "Float32", "Integer"):
        _check_bounds(place, variable, value)
    elif variable.type == "Enumeration":
        _check_choice(place, variable, value)
    elif variable.type in ("Binary", "Clock"):
        raise InputError(
            f"{place}: is of type {variable.type}, whose start value cannot be changed"
        )


def _check_bounds(place: str, variable: FmuVariable, value: Value) -> None:
    low = -math.inf if variable.minimum is None else variable.minimum
    high = math.inf if variable.maximum is None else variable.maximum
    valid, whole = f"a number from {low:g} to {high:g}", variable.type == "Integer"
    if whole:
        bits, signed = INTEGERS[variable.fmi_type]
        low = max(low, -(2 ** (bits - 1)) if signed else 0)
        high = min(high, 2 ** (bits - signed) - 1)
        valid = f"a whole number from {int(low)} to {int(high)}"
    if (
        isinstance(value, str)
        or not (math.isfinite(value) and low <= value <= high)
        or (whole and value != int(value))
    ):
        raise InputError(f"{place}: value {value!r}; must be {valid}")


def _check_choice(place: str, variable: FmuVariable, value: Value) -> None:
    """Check that a value is the name or the number of an enumeration's item."""
    if variable.choices and value not in (*variable.choices, *variable.choices.values()):
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
    return _variable(fmus, name, place, causality, ("Real",))


def _variable(
    fmus: Mapping[str, Fmu], name: Name, place: str, causality: str, types: Sequence[str]
) -> FmuVariable:
    """Return the variable's description."""
    instance, variable_name = name
    if instance not in fmus:
        raise InputError(f"{place}: no instance {instance!r}; valid: {', '.join(fmus)}")
    fmu = fmus[instance]
    variable = fmu.variable(variable_name)
    where = f"{fmu.label}: {variable_name}"
    if variable.type not in types:
        valid = " or ".join(types)
        raise InputError(f"{where}: type {variable.type}; must be {valid} ({place})")
    if variable.causality != causality:
        raise InputError(f"{where}: causality {variable.causality}; must be {causality} ({place})")
    return variable


def step_notes(fmus: Mapping[str, Fmu], step_size: float) -> Iterator[tuple[str, str, str]]:
    """Yield a warning for each FMU that names one step size, and will be stepped by another.

    Whether it minds is only known when it is stepped.

    Args:
        fmus: The FMU of each instance.
        step_size: Communication step [s].
    """
    for instance, fmu in fmus.items():
        interface, experiment = fmu.description.coSimulation, fmu.description.defaultExperiment
        told = interface.fixedInternalStepSize or (experiment and experiment.stepSize)
        own = float(told or 0.0)
        if interface.canHandleVariableCommunicationStepSize or not (0.0 < own < math.inf):
            continue
        if abs(step_size - round(step_size / own) * own) > 1e-9 * step_size:
            text = f"takes one step size, {own:g} s; steps of {step_size:g} s may be refused"
            yield instance, "Warning", text


def check_single_instances(fmus: Mapping[str, Fmu]) -> None:
    """Check that no FMU is instantiated twice that can be instantiated only once per process.

    Raises:
        InputError: An FMU is.
    """
    seen: dict[str, str] = {}
    for instance, fmu in fmus.items():
        other = seen.setdefault(fmu.sha256, instance)
        if other != instance and fmu.description.coSimulation.canBeInstantiatedOnlyOncePerProcess:
            raise InputError(
                f"{fmu.label}: {other!r} and {instance!r} are both instances of it, but it can be "
                f"instantiated only once per process; --isolate gives each a process of its own"
            )
