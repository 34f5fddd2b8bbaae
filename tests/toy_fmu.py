"""Small FMUs in C, compiled by the tests, in FMI 2.0 and 3.0 from one source."""

import re
import subprocess
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import mkdtemp

import fmpy
import fmpy.fmi2
import fmpy.fmi3

from fmu_support import compiler, pack

SOURCE = Path(__file__).parent / "c_fmu" / "toy.c"
HEADERS = Path(fmpy.__file__).parent / "c-code"
IDENTITY = 'modelName="toy" generationTool="by hand"'
CO_SIMULATION = '<CoSimulation modelIdentifier="toy"/>'
UNITS = '<UnitDefinitions><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit></UnitDefinitions>'
MODES = '<Item name="once" value="1"/><Item name="twice" value="2"/>'
INDICES = [f"[{i},{j}]" for i, j in product((1, 2), (1, 2, 3))]


@cache
def library(source: Path = SOURCE) -> bytes:
    """A compiled FMU in C, with all functions that FMPy wants to find and the source lacks."""
    folder, tool = Path(mkdtemp()), compiler()
    assert tool
    slaves = (fmpy.fmi2.FMU2Slave, fmpy.fmi3.FMU3Slave)
    names = {n for slave in slaves for n in dir(slave) if re.match("fmi[23][A-Z]", n)}
    weak = [f"__attribute__((weak)) int {name}(void) {{ return 3; }}\n" for name in sorted(names)]
    (folder / "rest.c").write_text("".join(weak))
    command = [tool, "-shared", "-fPIC", "-O1", f"-I{HEADERS}", source, folder / "rest.c"]
    subprocess.run([*command, "-o", folder / "fmu.so"], check=True, timeout=300)
    return (folder / "fmu.so").read_bytes()


def toy_fmu(path: Path, fmi: int, more: str = "") -> Path:
    """Write the FMU, in FMI 3.0 with more variables if any; returns the path."""
    platform = fmpy.platform if fmi == 2 else fmpy.platform_tuple
    text = _fmi2() if fmi == 2 else _fmi3(more)
    binary = f"binaries/{platform}/toy.so"
    content = {"modelDescription.xml": text, binary: library(), "resources/empty.txt": ""}
    return pack(path, content)


def _fmi2() -> str:
    def scalar(name: str, reference: int, causality: str, typed: str, more: str = "") -> str:
        return (
            f'<ScalarVariable name="{name}" valueReference="{reference}" '
            f'causality="{causality}" {more}>{typed}</ScalarVariable>'
        )

    tunable, fixed = 'variability="tunable"', 'variability="fixed"'
    variables = [
        *(scalar(f"u{n}", i, "input", '<Real unit="N" start="0"/>')
          for i, n in enumerate(INDICES)),
        *(scalar(f"y{n}", 6 + i, "output", '<Real unit="N"/>') for i, n in enumerate(INDICES)),
        scalar("k", 12, "parameter", '<Real start="1" min="-10" max="10"/>', tunable),
        scalar("flip", 0, "parameter", '<Boolean start="false"/>', fixed),
        scalar("mode", 0, "parameter", '<Enumeration declaredType="modes" start="1"/>', fixed),
        scalar("act", 0, "parameter", '<String start=""/>', fixed),
    ]  # fmt: skip
    types = f'<SimpleType name="modes"><Enumeration>{MODES}</Enumeration></SimpleType>'
    outputs = "".join(f'<Unknown index="{7 + i}"/>' for i in range(6))
    return (
        f'<fmiModelDescription fmiVersion="2.0" guid="toy" {IDENTITY} '
        f'variableNamingConvention="structured">{CO_SIMULATION}{UNITS}'
        f"<TypeDefinitions>{types}</TypeDefinitions>"
        f"<ModelVariables>{''.join(variables)}</ModelVariables>"
        f"<ModelStructure><Outputs>{outputs}</Outputs>"
        f"<InitialUnknowns>{outputs}</InitialUnknowns></ModelStructure></fmiModelDescription>"
    )


def _fmi3(more: str) -> str:
    shape = '<Dimension start="2"/><Dimension start="3"/>'
    parameter = 'causality="parameter" variability'
    variables = [
        '<Float64 name="time" valueReference="99" causality="independent" '
        'variability="continuous"/>',
        f'<Float64 name="u" valueReference="0" causality="input" unit="N" start="0">{shape}'
        "</Float64>",
        f'<Float64 name="y" valueReference="6" causality="output" unit="N">{shape}</Float64>',
        f'<Float64 name="k" valueReference="12" {parameter}="tunable" min="-10" max="10" '
        'start="1"/>',
        f'<Boolean name="flip" valueReference="13" {parameter}="fixed" start="false"/>',
        f'<Enumeration name="mode" valueReference="14" {parameter}="fixed" '
        'declaredType="modes" start="1"/>',
        f'<String name="act" valueReference="15" {parameter}="fixed"><Start value=""/></String>',
        more,
    ]
    types = f'<EnumerationType name="modes">{MODES}</EnumerationType>'
    return (
        f'<fmiModelDescription fmiVersion="3.0" instantiationToken="toy" {IDENTITY} '
        f'variableNamingConvention="structured">{CO_SIMULATION}{UNITS}'
        f"<TypeDefinitions>{types}</TypeDefinitions>"
        f"<ModelVariables>{''.join(variables)}</ModelVariables>"
        '<ModelStructure><Output valueReference="6"/><InitialUnknown valueReference="6"/>'
        "</ModelStructure></fmiModelDescription>"
    )
