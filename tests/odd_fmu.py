"""FMUs in C with any variables, and systems of them, for the tests; see c_fmu/toy.c."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

from toy_fmu import library

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Odd" guid="odd">
<CoSimulation modelIdentifier="odd" canHandleVariableCommunicationStepSize="{varies}"{flags}/>
{experiment}<ModelVariables>{variables}</ModelVariables><ModelStructure/></fmiModelDescription>
"""
STRUCTURE = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="1.0" name="odd"
 xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
 xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
 xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">
<ssd:System name={name}><ssd:Elements>{components}</ssd:Elements></ssd:System>
{experiment}</ssd:SystemStructureDescription>
"""
# Name, type, causality and value reference.
Variable = tuple[str, str, str, int]


def odd_fmu(
    path: Path,
    variables: Sequence[Variable],
    flags: str = "",
    experiment: str = "",
    varies: str = "true",
) -> Path:
    """Write an FMU; references of outputs are 100 above those of what they follow.

    `flags` are more attributes of <CoSimulation>, `experiment` is an element <DefaultExperiment>,
    and `varies` says whether it can handle a communication step of any size.
    """
    lines = []
    for name, kind, causality, reference in variables:
        variability = {"parameter": "tunable"}.get(causality, "continuous")
        if kind != "Real" and causality == "output":
            variability = "discrete"
        start = {"Real": "0.0", "Integer": "0", "Boolean": "false", "String": "text"}[kind]
        lines.append(
            f'<ScalarVariable name={quoteattr(name)} valueReference="{reference}" '
            f'causality="{causality}" variability="{variability}">'
            + (f"<{kind}/>" if causality == "output" else f'<{kind} start="{start}"/>')
            + "</ScalarVariable>"
        )
    text = DESCRIPTION.format(
        flags=flags, experiment=experiment, variables="".join(lines), varies=varies
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("binaries/linux64/odd.so", library())
    return path


def odd_ssp(
    path: Path,
    fmus: Mapping[str, Path],
    outputs: Mapping[str, Sequence[str]],
    parameters: Mapping[str, str] | None = None,
    experiment: str = '<ssd:DefaultExperiment stopTime="0.01"/>',
    name: str = "odd",
) -> Path:
    """Write a system of FMUs that are not connected, with parts of it by component."""
    components = []
    for component, fmu in fmus.items():
        connectors = "".join(
            f'<ssd:Connector name={quoteattr(output)} kind="output"/>'
            for output in outputs.get(component, ())
        )
        values = (
            "<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues><ssv:ParameterSet "
            'version="1.0" name="p"><ssv:Parameters>'
            f"{(parameters or {}).get(component, '')}"
            "</ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding>"
            "</ssd:ParameterBindings>"
        )
        components.append(
            f'<ssd:Component name={quoteattr(component)} source="resources/{fmu.name}" '
            f'type="application/x-fmu-sharedlibrary"><ssd:Connectors>{connectors}</ssd:Connectors>'
            f"{values}</ssd:Component>"
        )
    with zipfile.ZipFile(path, "w") as archive:
        text = STRUCTURE.format(
            name=quoteattr(name), components="".join(components), experiment=experiment
        )
        archive.writestr("SystemStructure.ssd", text)
        for file in {fmu.name: fmu for fmu in fmus.values()}.values():
            archive.writestr(f"resources/{file.name}", file.read_bytes())
    return path
