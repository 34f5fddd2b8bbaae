"""Reads SSP 1.0 and 2.0 files of any origin: a flat system of co-simulation FMUs for our master."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ..build.ssp import PREFIXES
from ..inside.base import TICK
from ..interface.tables import Connection
from ..interface.variables import Value
from ..reading import finite_number
from .ssp_parameters import Parameters
from .ssp_structure import Structure
from .system import System

DEFAULT_STOP: Final = 1.0  # [s] after the start, if neither the system nor an FMU gives a stop time
# Where a file may say the master's step size.
STEP_SIZES: Final = {
    "oms:FixedStepMaster": "stepSize", "osp:FixedStepAlgorithm": "baseStepSize"
}  # fmt: skip
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
    steps: Mapping[str, int]  # of components, in the system's
    warnings: tuple[str, ...] = ()  # parts of the file that have no effect


def system_from_ssp(path: Path) -> CoupledSystem:
    """Read an .ssp file; components are stepped in the order in which it lists them."""
    structure = Structure(path)
    parameters = Parameters(structure)
    connections = list(structure.connections())
    start, stop, step = _experiment(structure)
    master = structure.document.system.find(MASTER, PREFIXES)
    return CoupledSystem(
        structure.document.system.get("name", "system"),
        System(
            {name: fmu.path for name, fmu in structure.fmus.items()},
            connections,
            outputs=_outputs(structure, connections),
            labels={name: fmu.label for name, fmu in structure.fmus.items()},
        ),
        parameters.values,
        start,
        stop,
        step,
        "gauss-seidel" if master is None else master.get("coupling", ""),
        {name: max(round(size / step), 1) for name, size in structure.step_sizes.items()},
        tuple(parameters.warnings),
    )


def _outputs(structure: Structure, connections: Sequence[Connection]) -> dict[str, list[str]]:
    """Outputs of each component, connected ones first, in the order of their targets."""
    ends = dict.fromkeys(connection.source for connection in connections)
    for name in structure.fmus:
        for connector, row in structure.connectors[name].items():
            if row.kind == "output":
                ends |= dict.fromkeys((name, item) for item in structure.items[name][connector])
    outputs: dict[str, list[str]] = {name: [] for name in structure.fmus}
    for name, variable in ends:
        outputs[name].append(variable)
    return outputs


def _experiment(structure: Structure) -> tuple[float, float, float]:
    """Start, stop and step size [s]: what the file says, or else what the FMUs do."""
    root = structure.document.root
    element = root.find("ssd:DefaultExperiment", PREFIXES)
    times = {} if element is None else element.attrib
    steps = [
        each.get(attribute)
        for tag, attribute in STEP_SIZES.items()
        for each in root.iterfind(f".//{tag}", PREFIXES)
    ]
    start = min(_times(structure, "startTime", [times.get("startTime")]), default=0.0)
    stops = _times(structure, "stopTime", [times.get("stopTime")])
    stop = max(stops, default=start + DEFAULT_STOP)
    step = min(_times(structure, "stepSize", steps[:1]), default=TICK)
    if step <= 0:
        structure.document.refuse(f"stepSize = {step!r}", "above 0")
    return start, stop, step


def _times(structure: Structure, attribute: str, texts: Sequence[str | None]) -> list[float]:
    """Times [s] that the file gives; if it gives none, those of the FMUs' experiments."""
    given = [(attribute, text) for text in texts if text is not None]
    for name, fmu in structure.fmus.items() if not given else ():
        text = getattr(fmu.description.defaultExperiment, attribute, None)
        given += [(f"{name}: modelDescription.xml: {attribute}", text)] if text else []
    times = []
    for place, text in given:
        time = finite_number(text)
        if time is None:
            structure.document.refuse(f"{place} = {text!r}", "a finite number")
        times.append(time)
    return times
