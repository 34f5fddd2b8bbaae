"""Writes a coupled system as one FMU, by the FMU Manipulation Toolbox."""

from __future__ import annotations

import logging
import shutil
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final
from xml.etree import ElementTree as ET

from ..errors import InputError
from ..extras import needing
from ..interface.tables import Connection
from ..interface.units import PLAIN, conversion
from .description import ABOUT, literal
from .native import archive
from .ssp import WrittenSystem

DESCRIPTION: Final = "modelDescription.xml"
CONTAINER_FILE: Final = "Panda.fmu"


def write_container(path: Path, system: WrittenSystem, fmi: int) -> Path:
    """Write an FMU that steps a system of FMUs; those of FMI 2.0 may be within one of FMI 3.0."""
    # With Gauss-Seidel coupling it steps them one after another, else all with the same inputs.
    with needing("fmu-manipulation-toolbox", "container", "--container"):
        from fmu_manipulation_toolbox.container import FMUContainer  # noqa: PLC0415 - an extra
        from fmu_manipulation_toolbox.container.errors import FMUContainerError  # noqa: PLC0415
    if system.coupling == "iterated" or any(c.steps > 1 for c in system.components.values()):
        raise InputError('--container: coupling "iterated" or [steps]; must be built without')
    logging.getLogger("fmu_manipulation_toolbox").setLevel(logging.CRITICAL)
    with TemporaryDirectory() as name:
        folder = Path(name)
        container = FMUContainer(Path(CONTAINER_FILE).stem, folder, fmi_version=fmi)
        try:
            _fill(container, system, folder)
            container.start_time, container.stop_time = 0.0, system.stop_time
            in_turn = system.coupling == "gauss-seidel"
            container.make_fmu(CONTAINER_FILE, system.step_size, sequential=in_turn)
        except FMUContainerError as error:
            raise InputError(f"--container: {error.reason}") from error
        path.write_bytes(_signed(folder / CONTAINER_FILE))
    return path


def _fill(container: Any, system: WrittenSystem, folder: Path) -> None:
    for name, component in system.components.items():
        shutil.copy(component.file, folder / f"{name}.fmu")
        container.get_fmu(f"{name}.fmu")
        for key, value in component.start_values.items():
            scalar = component.variables[key]
            container.add_start_value(f"{name}.fmu", scalar.variable.name, literal(scalar, value))
    for connection in system.connections:
        _link(container, system, connection)
    for label, (name, variable) in system.outputs().items():
        container.add_output(f"{name}.fmu", variable.name, label)


def _link(container: Any, system: WrittenSystem, connection: Connection) -> None:
    source, target = connection.source, connection.target
    one, other = (system.scalar(end) for end in (source, target))
    known = (system.components[end[0]].units for end in (source, target))
    scale = conversion(one.unit, next(known), other.unit, next(known))
    if (connection.factor, connection.offset) != PLAIN or scale != PLAIN:
        raise InputError(f"--container: {connection} converts values; must be a plain one")
    feeder, fed = f"{source[0]}.fmu", f"{target[0]}.fmu"
    container.add_link(feeder, one.variable.name, fed, other.variable.name)


def _signed(file: Path) -> bytes:
    """Return an FMU with this project as its author; the toolbox names who is logged in."""
    with zipfile.ZipFile(file) as packed:
        members = {name: packed.read(name) for name in packed.namelist() if name[-1] != "/"}
    root = ET.fromstring(members[DESCRIPTION])  # noqa: S314 - made just now
    root.attrib.update({**ABOUT, "generationTool": f"panda-cosim, {root.get('generationTool')}"})
    members[DESCRIPTION] = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return archive(members)
