"""A coupled system: its FMUs, connections and start values; and opening it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from ...assets import STEP_SIZE
from ..errors import InputError
from ..files.fmu_file import Fmu, read_fmu
from ..interface.tables import Connection
from ..interface.variables import Value
from .compatibility import (
    check_connections,
    check_single_instances,
    check_start_values,
    step_notes,
)
from .fmu import FmuSlave, return_to, working_directory
from .master import Master
from .message_log import OnMessage
from .step import Coupling
from .wiring import Name

if TYPE_CHECKING:
    from .remote_slave import RemoteSlave

Instance: TypeAlias = "FmuSlave | RemoteSlave"


@dataclass(frozen=True)
class System:
    """The FMUs of a system, and their connections."""

    fmus: Mapping[str, Path]  # by instance, in the order of stepping
    connections: Sequence[Connection]
    external: Sequence[Name] = ()  # inputs that are given from outside at each tick
    outputs: Mapping[str, Sequence[str]] = field(default_factory=dict)  # to read, by instance
    refuses_non_finite: bool = False  # whether all FMUs refuse inputs that are not finite
    labels: Mapping[str, str] = field(default_factory=dict)  # what messages call files, not paths


@dataclass(frozen=True)
class OpenSystem:
    """An initialized system, ready to be stepped."""

    master: Master
    slaves: Mapping[str, Instance]
    fmus: Mapping[str, Fmu]


def open_slave(name: str, fmu: Fmu, on_message: OnMessage | None = None) -> FmuSlave:
    """Instantiate an FMU of FMI 2.0 or 3.0."""
    if fmu.fmi == 3:
        from .fmi3 import Fmi3Slave  # noqa: PLC0415 - FMPy takes 0.2 s

        return Fmi3Slave(name, fmu, on_message)
    from .fmi2 import Fmi2Slave  # noqa: PLC0415 - see above

    return Fmi2Slave(name, fmu, on_message)


def check_step_timeout(seconds: float | None, *, isolate: bool) -> None:
    """Refuse a --step-timeout that is no number above 0, or that nothing could be ended by."""
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

    `start_values` are by instance and scalar variable.
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
    on_message: OnMessage | None = None,
    isolate: bool = False,
    step_timeout: float | None = None,
) -> Iterator[OpenSystem]:
    """Open the FMUs, instantiate and initialize them; free them at the end."""
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
            if isolate:
                from .remote_slave import RemoteSlave  # noqa: PLC0415 - loads multiprocessing

                slaves[name] = RemoteSlave(name, fmu, on_message, step_timeout)
            else:
                slaves[name] = open_slave(name, fmu, on_message)
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
