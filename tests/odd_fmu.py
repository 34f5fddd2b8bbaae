"""FMUs in C with any variables, and systems of them, for the tests; see c_fmu/toy.c."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

from fmu_support import pack
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
<ssd:System name={name}><ssd:Elements>{components}</ssd:Elements>{connections}</ssd:System>
{experiment}</ssd:SystemStructureDescription>
"""
COMPONENT = """<ssd:Component name={name} source="resources/{file}"
 type="application/x-fmu-sharedlibrary"><ssd:Connectors>{connectors}</ssd:Connectors>
<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>
<ssv:ParameterSet version="1.0" name="p"><ssv:Parameters>{parameters}</ssv:Parameters>
</ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>
</ssd:Component>"""
# Name, type, causality (after it, `initial`, if it is given) and value reference.
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
        own, _, initial = causality.partition(" ")
        lines.append(
            f'<ScalarVariable name={quoteattr(name)} valueReference="{reference}" '
            f'causality="{own}" variability="{variability}"'
            + (f' initial="{initial}">' if initial else ">")
            + (f"<{kind}/>" if causality == "output" else f'<{kind} start="{start}"/>')
            + "</ScalarVariable>"
        )
    more = {"flags": flags, "experiment": experiment, "varies": varies}
    text = DESCRIPTION.format(variables="".join(lines), **more)
    return pack(path, {"modelDescription.xml": text, "binaries/linux64/odd.so": library()})


def odd_ssp(
    path: Path,
    fmus: Mapping[str, Path],
    outputs: Mapping[str, Sequence[str]],
    parameters: Mapping[str, str] | None = None,
    experiment: str = '<ssd:DefaultExperiment stopTime="0.01"/>',
    name: str = "odd",
    connections: Sequence[tuple[str, str, str, str]] = (),
) -> Path:
    """Write a system of FMUs, with parts of it by component.

    A connection is element and connector, and these of what it feeds.
    """
    inputs = {(to, end) for _, _, to, end in connections}
    components = []
    for component, fmu in fmus.items():
        kinds = dict.fromkeys(outputs.get(component, ()), "output")
        kinds |= {end: "input" for to, end in sorted(inputs) if to == component}
        connectors = "".join(
            f'<ssd:Connector name={quoteattr(each)} kind="{kind}"/>' for each, kind in kinds.items()
        )
        components.append(COMPONENT.format(
            name=quoteattr(component), file=fmu.name, connectors=connectors,
            parameters=(parameters or {}).get(component, ""),
        ))  # fmt: skip
    lines = "".join(
        f'<ssd:Connection startElement="{of}" startConnector="{start}" endElement="{to}" '
        f'endConnector="{end}"/>'
        for of, start, to, end in connections
    )
    text = STRUCTURE.format(
        name=quoteattr(name), components="".join(components), experiment=experiment,
        connections=f"<ssd:Connections>{lines}</ssd:Connections>" if lines else "",
    )  # fmt: skip
    files = {f"resources/{fmu.name}": fmu.read_bytes() for fmu in fmus.values()}
    return pack(path, {"SystemStructure.ssd": text, **files})
