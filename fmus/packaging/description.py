"""The modelDescription.xml of an FMU, complete by FMI 2.0, from its interface table."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree as ET

from ..interface.variables import Interface, Scalar
from ..slaves.base import LOG_CATEGORIES, TICK

AUTHOR = "The panda-cosim engineers"
LICENSE = "Apache-2.0"
COPYRIGHT = "Copyright 2026 The panda-cosim engineers"
STOP_TIME = 6.5  # [s] of the shipped scenarios
# Exponents of the SI base units; rad is one by the standard's own list.
BASE_UNITS: dict[str, dict[str, str]] = {
    "1": {},
    "m": {"m": "1"},
    "kg": {"kg": "1"},
    "s": {"s": "1"},
    "rad": {"rad": "1"},
    "1/s": {"s": "-1"},
    "m/s": {"m": "1", "s": "-1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "m/s2": {"m": "1", "s": "-2"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "m/rad": {"m": "1", "rad": "-1"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "N.m/rad": {"kg": "1", "m": "2", "s": "-2", "rad": "-1"},
}


@dataclass(frozen=True)
class Identity:
    """What tells one build of an FMU from another.

    Attributes:
        guid: Made from the content.
        version: Version of the project.
        date: ISO 8601 in UTC; fixed, so that equal content gives equal bytes.
    """

    guid: str
    version: str
    date: str = "2026-01-01T00:00:00Z"


def model_description(interface: Interface, identity: Identity) -> bytes:
    """Make the XML.

    Args:
        interface: The FMU's table.
        identity: Which build it is.

    Returns:
        The file's bytes, UTF-8.
    """
    scalars = interface.scalars()
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=interface.model,
        guid=identity.guid,
        description=interface.description,
        author=AUTHOR,
        version=identity.version,
        copyright=COPYRIGHT,
        license=LICENSE,
        generationTool="panda-cosim with PythonFMU 0.7.0",
        generationDateAndTime=identity.date,
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=interface.model,
        # Python runs inside the importer's process; no tool of its own is started.
        needsExecutionTool="false",
        canHandleVariableCommunicationStepSize="true",
        canInterpolateInputs="false",
        maxOutputDerivativeOrder="0",
        canRunAsynchronuously="false",
        canBeInstantiatedOnlyOncePerProcess="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative="false",
    )
    _units(root, scalars)
    categories = ET.SubElement(root, "LogCategories")
    for name, description in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=description)
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=repr(STOP_TIME),
        tolerance="1e-6",
        stepSize=repr(TICK),
    )
    variables = ET.SubElement(root, "ModelVariables")
    for scalar in scalars:
        variables.append(_scalar_variable(scalar))
    _structure(root, scalars)
    ET.indent(root)
    xml: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return xml + b"\n"


def _units(root: ET.Element, scalars: list[Scalar]) -> None:
    definitions = ET.SubElement(root, "UnitDefinitions")
    used = {s.unit for s in scalars if s.unit}
    for name in sorted(used):
        unit = ET.SubElement(definitions, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", BASE_UNITS[name])


def _scalar_variable(scalar: Scalar) -> ET.Element:
    variable = scalar.variable
    element = ET.Element(
        "ScalarVariable",
        name=scalar.name,
        valueReference=str(scalar.value_reference),
        description=variable.description,
        causality=variable.causality,
        variability=variable.variability
        if variable.kind == "Real" or variable.causality == "parameter"
        else "discrete",
    )
    if variable.causality == "output":
        element.set("initial", "calculated")
    elif variable.causality == "parameter":
        element.set("initial", "exact")
    typed = ET.SubElement(element, variable.kind)
    if scalar.unit:
        typed.set("unit", scalar.unit)
    for name, bound in (("min", scalar.minimum), ("max", scalar.maximum)):
        if bound is not None:
            typed.set(name, repr(float(bound)))
    if scalar.start is not None:
        typed.set("start", literal(scalar.start))
    return element


def literal(value: float | bool | str) -> str:
    """Write a value as XML attributes of FMI and SSP have it."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else repr(float(value))


def _structure(root: ET.Element, scalars: list[Scalar]) -> None:
    """Outputs depend on no input (they are state), at the start on parameters."""
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [i for i, s in enumerate(scalars, 1) if s.variable.causality == "output"]
    parameters = [i for i, s in enumerate(scalars, 1) if s.variable.causality == "parameter"]
    declared = ET.SubElement(structure, "Outputs")
    for index in outputs:
        ET.SubElement(declared, "Unknown", index=str(index), dependencies="")
    unknowns = ET.SubElement(structure, "InitialUnknowns")
    for index in outputs:
        ET.SubElement(
            unknowns,
            "Unknown",
            index=str(index),
            dependencies=" ".join(map(str, parameters)),
            dependenciesKind=" ".join(["dependent"] * len(parameters)),
        )
