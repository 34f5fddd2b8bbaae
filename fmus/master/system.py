"""A coupled system: its FMUs, whether they can be coupled, and opening it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from graphlib import CycleError, TopologicalSorter
from typing import Final, TypeAlias

import numpy as np

from ...assets import STEP_SIZE
from ..errors import InputError, SimulationError, refuse
from ..interface.tables import Connection
from ..interface.types import OBJECTS, can_convert, is_lossless, type_of
from ..interface.units import PLAIN, conversion, doubt
from ..interface.variables import Scalar, Value, by_array
from .calls import Experiment, OnMessage, unheard
from .fmu import FmuSlave, return_to, working_directory
from .fmu_file import Fmu, read_fmu
from .master import Master
from .nursery import nursery
from .remote_slave import RemoteSlave
from .step import Coupling, Stepper
from .wiring import Array, Name, System

SHOWN: Final = 4  # connections of an FMU that a warning names
Instance: TypeAlias = FmuSlave | RemoteSlave


@dataclass(frozen=True)
class OpenSystem:
    """An initialized system, ready to be stepped."""

    master: Master
    slaves: Mapping[str, Instance]
    fmus: Mapping[str, Fmu]


def read_fmus(
    system: System,
    start_values: Mapping[str, Mapping[str, Value]],
    coupling: Coupling = "gauss-seidel",
    *,
    isolate: bool = False,
) -> dict[str, Fmu]:
    """Read the files of a system, and check that they can be coupled; none of their code runs."""
    fmus = {
        name: read_fmu(path, system.labels.get(name, "")).restructured(start_values.get(name, {}))
        for name, path in system.fmus.items()
    }
    for name, fmu in fmus.items() if coupling == "iterated" else ():
        fmu.check_restorable(f'coupling = "iterated": {name}')
    _check_connections(fmus, system)
    if not isolate:
        _check_single_instances(fmus)
    return fmus


def _check_connections(fmus: Mapping[str, Fmu], system: System) -> None:
    """Check that connections exist, lead from output to input, in units that can be converted."""
    inputs = [*system.external, *(connection.target for connection in system.connections)]
    outputs = [*(connection.source for connection in system.connections), *system.read]
    ends = dict.fromkeys(inputs, "input") | dict.fromkeys(outputs, "output")
    for (instance, name), causality in ends.items():
        own = fmus[instance].variable(name).variable.causality
        if own != causality:
            refuse(f"{fmus[instance].label}: {name}: causality", own, f"must be {causality}")
    for connection in system.connections:
        source, target = (scalar.variable for _, scalar in _ends(fmus, connection))
        if not (can_convert if connection.converts_types else is_lossless)(source, target):
            types = f"type {type_of(source)} feeds type {type_of(target)}"
            raise InputError(f"{connection}: {types}; must be one that holds all its values")
        in_units(fmus, connection)


def conversions(fmus: Mapping[str, Fmu], system: System) -> list[str]:
    """Formulas of the connections that convert numbers, one for all elements of an array."""
    formulas = (
        f"{_shown(fmus, each.target)} = {each.factor:g} * {_shown(fmus, each.source)} "
        f"+ {each.offset:g}"
        for each in (in_units(fmus, connection) for connection in system.connections)
        if (each.factor, each.offset) != PLAIN
    )
    return list(dict.fromkeys(formulas))


def _ends(fmus: Mapping[str, Fmu], connection: Connection) -> list[tuple[Fmu, Scalar]]:
    """Source and target of a connection, each with its FMU."""
    return [(fmus[i], fmus[i].variable(n)) for i, n in (connection.source, connection.target)]


def _shown(fmus: Mapping[str, Fmu], end: Name) -> str:
    """Variable with its unit, without the indices of an element."""
    return f"{'.'.join(end).partition('[')[0]} [{fmus[end[0]].variable(end[1]).unit}]"


def _doubts(fmus: Mapping[str, Fmu], system: System) -> Iterator[tuple[str, str]]:
    """Yield warnings about connections whose units or names of values may not be meant so."""
    found: dict[tuple[str, str], dict[str, None]] = {}
    for each in system.connections:
        (one, source), (other, target) = _ends(fmus, each)
        reason = doubt(source.unit, one.units, target.unit, other.units)
        names = [v.variable.choices for v in (source, target)]
        if all(names) and not {*names[0]} <= {*names[1]}:
            reason = "other names for the same numbers"
        is_asked = each.converts_types or not each.converts_units
        if reason and not is_asked and source.variable.kind == target.variable.kind:
            text = f"{_shown(fmus, each.target)} from {_shown(fmus, each.source)}"
            found.setdefault((each.target[0], reason), {})[text] = None
    for (instance, reason), texts in found.items():
        some = ", ".join([*texts][:SHOWN]) + ", ..." * (len(texts) > SHOWN)
        yield instance, f"{reason}, so values are taken as they are: {some}"


def in_units(fmus: Mapping[str, Fmu], connection: Connection) -> Connection:
    """Return a connection whose factor and offset convert units, too."""
    if not connection.converts_units:
        return connection
    ends = _ends(fmus, connection)
    (source, one), (target, other) = ends
    scale = conversion(one.unit, source.units, other.unit, target.units)
    if scale is None and not connection.converts_types:
        must = "must be the same, or both defined by the same SI base units"
        raise InputError(f"{connection}: unit {one.unit!r} feeds unit {other.unit!r}; {must}")
    if scale in (None, PLAIN):  # no copy of each of the many
        return connection
    is_difference = any(scalar.variable.name in fmu.relative for fmu, scalar in ends)
    factor, offset = scale[0], 0.0 if is_difference else scale[1]
    return replace(
        connection,
        factor=connection.factor * factor,
        offset=connection.factor * offset + connection.offset,
    )


def _check_single_instances(fmus: Mapping[str, Fmu]) -> None:
    """Refuse two instances of an FMU that can be instantiated only once per process."""
    seen: dict[str, str] = {}
    for instance, fmu in fmus.items():
        other = seen.setdefault(fmu.sha256, instance)
        if other != instance and fmu.description.coSimulation.canBeInstantiatedOnlyOncePerProcess:
            raise InputError(
                f"{fmu.label}: {other!r} and {instance!r} are both instances of it, but it can be "
                f"instantiated only once per process; --isolate gives each a process of its own"
            )


def multiples_of(fmus: Mapping[str, Fmu], system: System, step_size: float) -> dict[str, int]:
    """Steps of FMUs in the system's: as asked for, else as their own fixed step size wants."""
    multiples = dict(system.steps)
    for name, fmu in fmus.items():
        interface = fmu.description.coSimulation
        own = float(interface.fixedInternalStepSize or 0.0)
        if fmu.fmi == 3 and not interface.canHandleVariableCommunicationStepSize:
            multiple = round(own / step_size) if own < 1e6 * step_size else 0
            if multiple > 1 and abs(own - multiple * step_size) <= 1e-9 * own:
                multiples.setdefault(name, multiple)
    return multiples


def notes(fmus: Mapping[str, Fmu], system: System, step_size: float) -> Iterator[tuple[str, str]]:
    """Yield warnings, by FMU: of units, steps [s] that it does not name, and algebraic loops."""
    multiples = multiples_of(fmus, system, step_size)
    yield from _doubts(fmus, system)
    for instance, fmu in fmus.items():
        if fmu.clocked:
            yield instance, f"clocks are not supported; left out: {', '.join(fmu.clocked)}"
        multiple, is_asked = multiples.get(instance, 1), instance in system.steps
        if text := _note_on_steps(fmu, multiple, step_size, is_asked=is_asked):
            yield instance, text
    loop = _loop(tuple(fmus.items()), tuple(system.connections))
    if loop:
        text = f"algebraic loop {' -> '.join(map('.'.join, loop))}: each step uses values of the "
        yield loop[0][0], text + 'step before, unless coupling = "iterated"'


def _note_on_steps(fmu: Fmu, multiple: int, step_size: float, *, is_asked: bool) -> str:
    """Warn of steps that an FMU does not name; "" if there is no reason to."""
    interface, experiment = fmu.description.coSimulation, fmu.description.defaultExperiment
    named = interface.fixedInternalStepSize or (experiment and experiment.stepSize)
    own, size = float(named or 0.0), multiple * step_size
    single = f"supports a single step size, {own:g} s"
    if multiple > 1 and not is_asked:
        return f"{single}: {multiple} system steps"
    if not 0.0 < own < math.inf or abs(size - round(size / own) * own) <= 1e-9 * size:
        return ""
    if fmu.is_model:
        return (
            f"steps itself by {own:g} s, so that after steps of {size:g} s its outputs may be "
            "older than their row; must be a whole multiple"
        )
    is_fixed = not interface.canHandleVariableCommunicationStepSize
    return f"{single}; steps of {size:g} s may be refused" if is_fixed else ""


@lru_cache(maxsize=4)  # rows of a sweep have the same system
def _loop(fmus: tuple[tuple[str, Fmu], ...], connections: tuple[Connection, ...]) -> Sequence[Name]:
    """Find a cycle of connections and of outputs that depend on inputs, as ModelStructure says."""
    fed = {connection.target: connection.source for connection in connections}
    before: dict[Name, set[Name]] = {target: {source} for target, source in fed.items()}
    for instance, fmu in fmus:
        arrays = by_array(fmu.variables.values())
        for unknown in fmu.description.outputs:
            fed_by = (each for v in unknown.dependencies or () for each in arrays.get(v.name, ()))
            inputs = {(instance, scalar.name) for scalar in fed_by}
            for output in arrays.get(unknown.variable.name, ()) if inputs else ():
                before[instance, output.name] = fed.keys() & inputs
    try:
        TopologicalSorter(before).prepare()
    except CycleError as error:
        return list(error.args[1])
    return ()


@contextmanager
def open_system(  # noqa: PLR0913 - a run has this many sides
    system: System,
    start_values: Mapping[str, Mapping[str, Value]],
    *,
    stop: float,
    start: float = 0.0,
    step_size: float = STEP_SIZE,
    coupling: Coupling = "gauss-seidel",
    on_message: OnMessage = unheard,
    isolate: bool = False,
    step_timeout: float | None = None,
    stepper: Stepper = "kernel",
    external: Array | None = None,  # external inputs at the start (1, n)
    tolerance: float = 0.0,  # relative, of FMUs that integrate; 0: as their descriptions say
) -> Iterator[OpenSystem]:
    """Open the FMUs, instantiate and initialize them; free them at the end."""
    with ExitStack() as stack:
        make: Callable[..., Instance]
        if isolate:
            forking = nursery()  # it imports meanwhile
            stack.callback(forking.end)
            make = partial(RemoteSlave, nursery=forking, step_timeout=step_timeout)
        else:
            from .fmi import open_slave as make  # noqa: PLC0415 - FMPy takes 0.2 s
        fmus = read_fmus(system, start_values, coupling, isolate=isolate)
        for instance, text in notes(fmus, system, step_size):
            on_message(instance, "Warning", text)
        multiples = multiples_of(fmus, system, step_size)
        ends = ((fmus[end[0]].variable(end[1]), end) for end in (*system.external, *system.read))
        here = working_directory()
        stack.callback(return_to, here)
        slaves: dict[str, Instance] = {}
        for name, fmu in fmus.items():
            slaves[name] = make(name, fmu, on_message)
            stack.callback(slaves[name].close)
        for name, slave in slaves.items():
            # Ours may take a step beyond the end, for the last row.
            more = multiples.get(name, 1) * step_size if fmus[name].is_ours else 0.0
            experiment = Experiment(tolerance or fmus[name].tolerance, start, stop + more)
            slave.enter_initialization(start_values.get(name, {}), experiment)
        converted = [in_units(fmus, connection) for connection in system.connections]
        master = Master(
            list(slaves.values()),
            replace(system, connections=converted, steps=multiples),
            step_size,
            coupling,
            start=start,
            objects=[end for scalar, end in ends if type_of(scalar.variable) in OBJECTS],
            stepper=stepper,
            at_end=[name for name, fmu in fmus.items() if fmu.answers_at_end],
        )
        if external is not None or not system.external:
            _settle(master, np.empty((1, 0)) if external is None else external, on_message)
        for slave in slaves.values():
            slave.exit_initialization()
        return_to(here)
        yield OpenSystem(master, slaves, fmus)


def _settle(master: Master, external: Array, on_message: OnMessage) -> None:
    """Exchange values in initialization mode until they agree, or warn that they do not."""
    try:
        unsettled = master.initialize(external)
    except SimulationError as error:  # nothing is recorded yet
        raise InputError(f"initialization: {error}") from error
    if unsettled:
        text = f"{unsettled[1]} does not settle between FMUs; start values are used"
        on_message(unsettled[0], "Warning", f"initialization: {text}")
