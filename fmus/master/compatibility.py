"""Whether FMUs can be coupled: connections exist, lead from output to input, in one unit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from ..errors import InputError
from ..files.fmu_file import Fmu
from ..interface.tables import Connection
from ..interface.variables import Scalar, Value
from .wiring import Name

RECORDED_KINDS: Final = ("Real", "Float32", "Integer", "Enumeration", "Boolean")  # as float64


def check_connections(
    fmus: Mapping[str, Fmu],
    connections: Sequence[Connection],
    external: Sequence[Name],
    outputs: Mapping[str, Sequence[str]],
) -> None:
    """Check a coupled system against its FMUs' descriptions."""
    targets = [(name, "command") for name in external]
    targets += [(c.target, f"connection from {'.'.join(c.source)}") for c in connections]
    fed: set[Name] = set()
    for target, place in targets:
        _scalar(fmus, target, place, "input")
        if target in fed:
            raise InputError(f"{place}: {'.'.join(target)} is fed twice; must be fed once")
        fed.add(target)
    for instance, names in outputs.items():
        for name in names:
            _scalar(fmus, (instance, name), "recording", "output", RECORDED_KINDS)
    for connection in connections:
        place = f"connection of {'.'.join(connection.source)} to {'.'.join(connection.target)}"
        source = _scalar(fmus, connection.source, place, "output").unit
        target_unit = _scalar(fmus, connection.target, place, "input").unit
        if source and target_unit and source != target_unit:
            raise InputError(
                f"{place}: unit {source!r} feeds unit {target_unit!r}; must be the same"
            )


def _scalar(
    fmus: Mapping[str, Fmu],
    name: Name,
    place: str,
    causality: str,
    kinds: Sequence[str] = ("Real",),
) -> Scalar:
    instance, variable = name
    if instance not in fmus:
        raise InputError(f"{place}: no instance {instance!r}; valid: {', '.join(fmus)}")
    scalar = fmus[instance].variable(variable)
    where = f"{fmus[instance].label}: {variable}"
    if scalar.variable.kind not in kinds:
        raise InputError(
            f"{where}: type {scalar.variable.kind}; must be {' or '.join(kinds)} ({place})"
        )
    if scalar.variable.causality != causality:
        raise InputError(
            f"{where}: causality {scalar.variable.causality}; must be {causality} ({place})"
        )
    return scalar


def check_start_values(
    fmus: Mapping[str, Fmu], start_values: Mapping[str, Mapping[str, Value]]
) -> None:
    """Check start values, by instance and scalar variable, against the FMUs' descriptions."""
    for instance, values in start_values.items():
        if instance not in fmus:
            raise InputError(f"start value of {instance!r}: no such instance")
        for name, value in values.items():
            scalar = fmus[instance].variable(name)
            place, causality = f"{fmus[instance].label}: {name}", scalar.variable.causality
            if causality not in ("parameter", "input"):
                raise InputError(f"{place}: causality {causality}; cannot be set")
            scalar.checked(place, value)


def check_single_instances(fmus: Mapping[str, Fmu]) -> None:
    """Refuse two instances of an FMU that can be instantiated only once per process."""
    seen: dict[str, str] = {}
    for instance, fmu in fmus.items():
        other = seen.setdefault(fmu.sha256, instance)
        if other != instance and fmu.description.coSimulation.canBeInstantiatedOnlyOncePerProcess:
            raise InputError(
                f"{fmu.label}: {other!r} and {instance!r} are both instances of it, but it can be "
                f"instantiated only once per process; --isolate gives each a process of its own"
            )


def step_notes(fmus: Mapping[str, Fmu], step_size: float) -> Iterator[tuple[str, str, str]]:
    """Yield a warning for each FMU that names one step size [s], and will be stepped by another.

    Whether it minds is only known when it is stepped.
    """
    for instance, fmu in fmus.items():
        interface, experiment = fmu.description.coSimulation, fmu.description.defaultExperiment
        named = interface.fixedInternalStepSize or (experiment and experiment.stepSize)
        own = float(named or 0.0)
        if interface.canHandleVariableCommunicationStepSize or not (0.0 < own < math.inf):
            continue
        if abs(step_size - round(step_size / own) * own) > 1e-9 * step_size:
            text = f"takes one step size, {own:g} s; steps of {step_size:g} s may be refused"
            yield instance, "Warning", text
