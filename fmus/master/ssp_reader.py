"""Reads SSP 1.0 and 2.0 files of any origin: a flat system of co-simulation FMUs for our master."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ...assets import STEP_SIZE
from ..build.ssp import PREFIXES, STEP_SIZES
from ..interface.tables import Connection
from ..interface.variables import Value
from .order import stepping_order
from .ssp_parameters import Parameters
from .ssp_structure import End, Structure
from .wiring import System

DEFAULT_STOP: Final = 1.0  # [s] after the start, if neither the system nor an FMU gives a stop time
MASTER: Final = "ssd:Annotations/ssc:Annotation/panda:Master"


@dataclass(frozen=True)
class CoupledSystem:
    """The content of an SSP file, ready for `open_system`."""

    name: str
    system: System  # FMUs, connections, and the outputs to read
    start_values: Mapping[str, Mapping[str, Value]]  # by component and variable
    start_time: float  # [s]
    stop_time: float  # [s]
    step_size: float  # [s]
    coupling: str  # one of `COUPLINGS`
    warnings: tuple[str, ...] = ()  # parts of the file that have no effect


def system_from_ssp(path: Path) -> CoupledSystem:
    """Read an .ssp file; the order in which it lists things has no effect."""
    structure = Structure(path)
    parameters = Parameters(structure)
    connections = list(structure.connections())
    start, stop, step = _experiment(structure)
    master = structure.document.system.find(MASTER, PREFIXES)
    stated = "" if master is None else master.get("order", "")
    order = stated.split() or stepping_order(structure.fmus, connections)
    if sorted(order) != sorted(structure.fmus):
        structure.document.refuse(f"order {stated!r}", f"of {', '.join(sorted(structure.fmus))}")
    names = ((name, variable) for name in order for variable in structure.fmus[name].variables)
    places = {name: place for place, name in enumerate(names)}
    connections.sort(key=lambda each: places[each.target])
    return CoupledSystem(
        structure.document.system.get("name", "system"),
        System(
            {name: structure.fmus[name].path for name in order},
            connections,
            outputs=_outputs(structure, connections, places),
            steps={n: max(round(size / step), 1) for n, size in structure.step_sizes.items()},
            labels={name: fmu.label for name, fmu in structure.fmus.items()},
        ),
        parameters.values,
        start,
        stop,
        step,
        "jacobi" if master is None else master.get("coupling", ""),  # as other tools do
        tuple(parameters.warnings),
    )


def _outputs(
    structure: Structure, connections: Sequence[Connection], places: Mapping[End, int]
) -> dict[str, list[str]]:
    """Outputs of each component, connected ones first, in the order of their targets."""
    connected = dict.fromkeys(connection.source for connection in connections)
    others = {
        (name, item)
        for name in structure.fmus
        for connector, row in structure.connectors[name].items()
        if row.kind == "output"
        for item in structure.items[name][connector]
    }
    outputs: dict[str, list[str]] = {name: [] for name, _ in places}
    for name, variable in [*connected, *sorted(others - connected.keys(), key=places.__getitem__)]:
        outputs[name].append(variable)
    return outputs


def _experiment(structure: Structure) -> tuple[float, float, float]:
    """Start, stop and step size [s]: what the file says, or else what the FMUs do."""
    root, document = structure.document.root, structure.document

    def times(key: str, stated: Iterable[str | None]) -> list[float]:
        texts = [(key, text) for text in stated if text is not None][:1]
        for name, fmu in structure.fmus.items() if not texts else ():
            text = getattr(fmu.description.defaultExperiment, key, None)
            texts += [(f"{name}: modelDescription.xml: {key}", text)] if text else []
        return [document.number(place, text) for place, text in texts]

    experiment = root.find("ssd:DefaultExperiment", PREFIXES)
    stated = {} if experiment is None else experiment.attrib
    annotated = (
        each.get(key) for tag, key in STEP_SIZES.items() for each in root.iterfind(tag, PREFIXES)
    )
    start = min(times("startTime", [stated.get("startTime")]), default=0.0)
    stop = max(times("stopTime", [stated.get("stopTime")]), default=start + DEFAULT_STOP)
    step = min(times("stepSize", annotated), default=STEP_SIZE)
    if step <= 0:
        document.refuse(f"stepSize = {step!r}", "above 0")
    return start, stop, step
