"""A coupled system: its FMUs, connections and start values; and opening it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from ...assets import STEP_SIZE
from ..errors import InputError
from ..interface.forces import FORCES
from ..interface.tables import COMMANDS, CONNECTIONS, INTERFACES, Connection
from ..packaging.build import Kind, Target, build
from .compatibility import (
    check_connections,
    check_single_instances,
    check_start_values,
    step_notes,
)
from .fmu import FmuSlave, Value, open_slave, return_to, working_directory
from .fmu_file import Fmu, read_fmu
from .master import Master
from .remote_slave import RemoteSlave
from .step import Coupling
from .wiring import Name

Instance = FmuSlave | RemoteSlave
INSTANCES = ("controller", "plant")  # in the order of stepping: the controller leads


@dataclass(frozen=True)
class System:
    """The FMUs of a system, and their connections.

    Attributes:
        fmus: The FMU of each instance, in the order of stepping.
        connections: Which output feeds which input.
        external: Inputs that are given from outside at each tick.
        outputs: Scalar outputs to read of each instance.
        refuses_non_finite: Whether all of the FMUs refuse inputs that are not finite.
        labels: What messages call the FMUs' files; the others are called by their paths.
    """

    fmus: Mapping[str, Path]
    connections: Sequence[Connection]
    external: Sequence[Name] = ()
    outputs: Mapping[str, Sequence[str]] = field(default_factory=dict)
    refuses_non_finite: bool = False
    labels: Mapping[str, str] = field(default_factory=dict)


def panda_system(
    *,
    pushed: Iterable[str] = (),
    fmus: Mapping[str, Path] | None = None,
    kind: Kind = "native",
    asked: Collection[str] = (),
) -> System:
    """Plant and controller, with the commands (and the push) as external inputs.

    Args:
        pushed: Bodies whose push is an external input, too: "hand", "block".
        fmus: FMU files by instance, instead of the project's own, which are built if necessary.
        kind: Kind of the project's own FMUs.
        asked: Outputs that are recorded on request, such as `plant.table_force`.

    Raises:
        InputError: There is no such instance.
    """
    given = dict(fmus or {})
    for name in given:
        if name not in INSTANCES:
            raise InputError(f"fmus: no instance {name!r}; valid: {', '.join(INSTANCES)}")
    missing = [name for name in INSTANCES if name not in given]
    files = build(missing, target=Target(kind)) | given
    return System(
        {name: files[name] for name in INSTANCES},
        CONNECTIONS,
        panda_inputs(pushed),
        {name: _outputs(name, asked) for name in reversed(INSTANCES)},  # the plant's first
        refuses_non_finite=not given,
    )


def panda_inputs(pushed: Iterable[str]) -> list[Name]:
    """Return the external inputs of plant and controller: forces on bodies, then the commands."""
    taken = [("plant", FORCES[body]) for body in pushed] + [("controller", c) for c in COMMANDS]
    return [(i, n) for i, name in taken for n in INTERFACES[i].variable(name).names()]


def _outputs(instance: str, asked: Collection[str]) -> list[str]:
    """Outputs of an instance, in the order of the FMU, which makes reading them fast."""
    outputs = INTERFACES[instance].of("output")
    read = [v for v in outputs if not v.on_request or f"{instance}.{v.name}" in asked]
    return [name for variable in read for name in variable.names()]


@dataclass(frozen=True)
class OpenSystem:
    """An initialized system, ready to be stepped.

    Attributes:
        master: The master that steps it.
        slaves: The instances.
        fmus: The opened FMU files.
    """

    master: Master
    slaves: Mapping[str, Instance]
    fmus: Mapping[str, Fmu]


def check_step_timeout(seconds: float | None, *, isolate: bool) -> None:
    """Check the value of --step-timeout.

    Raises:
        InputError: It is not a number above 0, or the FMUs run in this process, where a step
            cannot be ended.
    """
    if seconds is None:
        return
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise InputError(f"--step-timeout: value {seconds!r}; must be a number above 0 s")
    if not isolate:
        raise InputError(
            f"--step-timeout: value {seconds!r} without --isolate; a step can be ended only if the "
            f"FMU has a process of its own"
        )


def read_fmus(
    system: System,
    start_values: Mapping[str, Mapping[str, Value]],
    *,
    isolate: bool = False,
) -> dict[str, Fmu]:
    """Read the files of a system, and check that they can be coupled; none of their code runs.

    Args:
        system: The FMUs and their connections.
        start_values: By instance and scalar variable.
        isolate: Whether each FMU will run in a process of its own.

    Raises:
        InputError: A file, a name or a value cannot be used.
    """
    fmus = {name: read_fmu(path, system.labels.get(name, "")) for name, path in system.fmus.items()}
    check_start_values(fmus, start_values)
    check_connections(fmus, system.connections, system.external, system.outputs)
    if not isolate:
        check_single_instances(fmus)
    return fmus


@contextmanager
def open_system(  # noqa: PLR0913 - a run has this many sides
    system: System,
    start_values: Mapping[str, Mapping[str, Value]],
    *,
    stop: float,
    start: float = 0.0,
    step_size: float = STEP_SIZE,
    coupling: Coupling = "gauss-seidel",
    on_message: Callable[[str, str, str], None] | None = None,
    isolate: bool = False,
    step_timeout: float | None = None,
) -> Iterator[OpenSystem]:
    """Open the FMUs, instantiate and initialize them; free them at the end.

    Args:
        system: The FMUs and their connections.
        start_values: By instance and scalar variable.
        stop: Time of the last row [s]; leaders take a step from there, too, so the FMUs' stop time
            is a step later.
        start: Start time [s].
        step_size: Communication step [s].
        coupling: "gauss-seidel" or "jacobi", see `Master`.
        on_message: Called with log messages, see `open_slave`.
        isolate: Run each FMU in a process of its own.
        step_timeout: Wall time that a step of an isolated FMU may take [s]; None: unlimited.

    Raises:
        InputError: A file, a name or a value cannot be used.
        SimulationError: An FMU reports an error.
    """
    check_step_timeout(step_timeout, isolate=isolate)
    fmus = read_fmus(system, start_values, isolate=isolate)
    if on_message is not None:
        for note in step_notes(fmus, step_size):
            on_message(*note)
    with ExitStack() as stack:
        here = working_directory()
        stack.callback(return_to, here)
        slaves: dict[str, Instance] = {}
        for name, fmu in fmus.items():
            slaves[name] = (
                RemoteSlave(name, fmu, on_message, step_timeout)
                if isolate
                else open_slave(name, fmu, on_message)
            )
            stack.callback(slaves[name].close)
        for name, slave in slaves.items():
            slave.initialize(start_values.get(name, {}), start, stop + step_size)
        return_to(here)
        master = Master(
            list(slaves.values()),
            system.outputs,
            system.connections,
            system.external,
            step_size,
            coupling,
            start=start,
            late_check=system.refuses_non_finite,
        )
        yield OpenSystem(master, slaves, fmus)
