"""`panda-cosim info`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import compress, groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

from rich.table import Table

from ...fmus.build.engines import known_faults
from ...fmus.errors import InputError, did_you_mean, excerpt
from ...fmus.interface.tables import CONNECTIONS, INTERFACES, Connection
from ...fmus.interface.variables import Interface, Variable
from ...fmus.master.fmu_file import Fmu, described_interface, read_fmu
from ...fmus.master.order import by_variable, late, shown, stepping_order
from ...fmus.sources.targets import ONLY_PYTHON, OWN, Target
from ...run.system.assembly import assemble, system_scenario
from ...run.system.parts import UnreadSlaveError
from ...task.scenario import SCENARIO_FILE, Scenario
from ..console import as_cell, show, show_json, table
from ..forms import argument, flag, option
from ..options import JSON, announce_python

_COLUMNS = ("name", "unit*", "start*", "range*", "description*")
WIDTH = 100  # characters of a line
LATE = "a step late"
_MANY = 3  # different bounds; more are shown as one range


def command(
    fmu: str | None = argument(
        "[plant|controller|sensors|FILE.fmu|FILE.ssp|FOLDER]", None, show_default=False
    ),
    markdown: bool = flag("--markdown"),
    text: str = option("--filter TEXT", ""),
    json: bool = JSON,
) -> None:
    """Show the FMUs' variables and how they are connected.

    Of a scenario's parts in Python, PythonFMU slaves are run to learn their variables.

    ```
    panda-cosim info
    panda-cosim info controller --filter torque
    panda-cosim info Motor.fmu
    panda-cosim info ./my-scenario
    ```

    Args:
        fmu: One of the project's FMUs, any .fmu or .ssp file, or a scenario's folder. Default:
            plant and controller.
        markdown: Print the variables as a Markdown table.
        text: Show only variables with this text in their names or descriptions.
    """
    interfaces, connections, order, held = _read(fmu)
    faults = known_faults(Path(fmu)) if fmu and fmu.endswith(".fmu") else []
    code = {name: _code(name, interface, Path(fmu or "")) for name, interface in interfaces.items()}
    if text:
        interfaces, connections = _filtered(text.lower(), interfaces, connections)
    if json:
        described = _described(interfaces, connections)
        show_json({**described, "code": code, "order": order, "late": held,
                   "faults": faults})  # fmt: skip
        return
    if markdown:
        drawing = [_drawing(order, connections, held)] if len(order) > 1 else []
        show("\n\n".join([*map(variables_markdown, interfaces.values()), *drawing]))
        return
    for name, interface in interfaces.items():
        _show_fmu(name, interface, code[name])
    for fault in faults:
        show(as_cell(fault), "yellow")
    announce_python()
    _show_connections(connections, held)
    if len(order) > 1:
        show(shown(order, []))


def _show_fmu(name: str, interface: Interface, code: str) -> None:
    """Print what an FMU is, what runs in it, and its variables."""
    show(f"{interface.model} (instance {name}): {interface.description}", "bold", most=WIDTH)
    show(f"What runs in it: {code}{', as it has no twin in C' * (name in ONLY_PYTHON)}")
    for variables in _variables_tables(interface):
        show(variables, most=WIDTH)
    show("")


def _show_connections(connections: Sequence[Connection], held: Sequence[str]) -> None:
    if connections:
        show("Connections\n", "bold")
        rows = [(s, t, LATE * (f"{s} -> {t}" in held)) for s, t, _ in by_variable(connections)]
        show(table(("from", "to", ""), (map(as_cell, row) for row in rows)), most=WIDTH)


def _read(
    name: str | None,
) -> tuple[Mapping[str, Interface], Sequence[Connection], list[str], list[str]]:
    """Return FMUs, connections, order and what is late; of code, only PythonFMU slaves are run."""
    if name is None:
        order = stepping_order(INTERFACES, CONNECTIONS)
        return INTERFACES, CONNECTIONS, order, late(order, CONNECTIONS, Scenario.coupling)
    if name in INTERFACES:
        return {name: INTERFACES[name]}, CONNECTIONS, [name], []
    if name in OWN:
        return {name: OWN[name].interface}, (), [name], []
    path = Path(name)
    if path.suffix == ".fmu":
        return {path.stem: described_interface(Fmu(path))}, (), [path.stem], []
    if path.suffix == ".ssp":
        scenario = system_scenario(path)
    elif (path / SCENARIO_FILE).is_file():
        scenario = Scenario.read(path)
    else:
        raise InputError(
            f"{excerpt(name)}: must be {', '.join(OWN)}, an .fmu or .ssp file, or a "
            f"scenario's folder{did_you_mean(name, OWN)}"
        )
    try:
        assembly = assemble(scenario, run_code=False)
    except UnreadSlaveError:  # its variables are only known when it is run
        assembly = assemble(scenario)
    order, held = [*assembly.interfaces], assembly.late(scenario.coupling)
    return assembly.interfaces, assembly.connections, order, held


def _filtered(
    text: str, interfaces: Mapping[str, Interface], connections: Sequence[Connection]
) -> tuple[dict[str, Interface], list[Connection]]:
    """Return the variables with a text in name or description, and connections with it in names."""
    shown = {}
    for name, interface in interfaces.items():
        named = ((v, f"{name}.{v.name} {v.description}".lower()) for v in interface.variables)
        shown[name] = replace(interface, variables=tuple(v for v, words in named if text in words))
    ends = ((each, f"{'.'.join(each.source)} {'.'.join(each.target)}") for each in connections)
    return shown, [each for each, words in ends if text in words.lower()]


def _code(name: str, interface: Interface, file: Path) -> str:
    """Return what runs in one of the project's own FMUs or in an .fmu file."""
    if any(interface is own.interface for own in OWN.values()):
        return Target().kind_of(name)
    return read_fmu(file).code if file.suffix == ".fmu" else "its own"


def _drawing(order: Sequence[str], connections: Iterable[Connection], held: Sequence[str]) -> str:
    """Draw FMUs in the order of stepping, and connections, dashed if late, as Mermaid does."""
    lines = [f'  {i}["{i} {_quoted(name)}"]' for i, name in enumerate(order, 1)]
    ways: dict[tuple[int, str, int], list[str]] = {}
    for source, target, ((feeder, _), (fed, _)) in by_variable(connections):
        line = "-.->" if f"{source} -> {target}" in held else "-->"
        way = (order.index(feeder) + 1, line, order.index(fed) + 1)
        ways.setdefault(way, []).append(_quoted(target.removeprefix(f"{fed}.")))
    lines += [f'  {a} {line}|"{", ".join(names)}"| {b}' for (a, line, b), names in ways.items()]
    return "\n".join(["```mermaid", "flowchart LR", *lines, "```"])


def _quoted(text: str) -> str:
    return text.replace('"', "#quot;")


def _described(
    interfaces: Mapping[str, Interface], connections: Iterable[Connection]
) -> dict[str, object]:
    """Return all variables of some instances, and the connections from or to them."""
    about = ("model", "description", "variables")
    fmus = {name: {key: getattr(i, key) for key in about} for name, i in interfaces.items()}
    wires = [
        {"from": ".".join(c.source), "to": ".".join(c.target)}
        for c in connections
        if {c.source[0], c.target[0]} & interfaces.keys()
    ]
    return {"fmus": fmus, "connections": wires}


def _variables_tables(interface: Interface) -> Iterator[Table]:
    """Yield a table for each kind of variable, with one row per variable."""
    kind = attrgetter("causality", "variability")
    order = ("input", "output", "parameter", "local", "calculatedParameter")
    variables = [v for v in interface.variables if v.causality in order]
    variables.sort(key=lambda v: (order.index(v.causality), v.variability))
    for (causality, variability), group in groupby(variables, kind):
        rows = [
            (_named(v), _short(v.unit), _short(v.start), _range(v), v.description) for v in group
        ]
        filled = [any(cells) for cells in zip(*rows, strict=True)]
        cells = (map(as_cell, compress(row, filled)) for row in rows)
        title = f"\n{causality}s, {variability}"
        yield table([*compress(_COLUMNS, filled)], cells, title=title)


def variables_markdown(interface: Interface) -> str:
    """Return a Markdown table with one row per variable, for the documentation."""
    lines = [
        "| variable | unit | causality | start | description |",
        "| --- | --- | --- | --- | --- |",
    ]
    for v in interface.variables:
        causality = "tunable parameter" if v.variability == "tunable" else v.causality
        cells = (f"`{_named(v)}`", _short(v.unit), causality, _short(v.start), v.description)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _named(variable: Variable) -> str:
    """Return the name with the ranges of its indices, such as jac[1..6,1..7]."""
    ranges = ",".join(f"1..{n}" for n in variable.shape)
    return f"{variable.name}[{ranges}]" if ranges else variable.name


def _short(values: Any) -> str:
    """Return one value, or several with equal neighbours counted, such as `rad (7), 1`."""
    runs = [(_written(value), len(list(group))) for value, group in groupby(_items(values))]
    return ", ".join(f"{text} ({n})" if n > 1 and len(runs) > 1 else text for text, n in runs)


def _written(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.4g}" if isinstance(value, float | int) else str(value)


def _range(variable: Variable) -> str:
    """Return the valid values, as one range that contains those of all elements."""
    if variable.choices:
        return " | ".join(variable.choices)
    low, high = (_items(bound) for bound in (variable.minimum, variable.maximum))
    several = "each its own, " if max(len(set(low)), len(set(high))) > _MANY else ""
    if low and high:
        return f"{several}{min(low):.4g} to {max(high):.4g}"
    return f">= {min(low):.4g}" if low else f"<= {max(high):.4g}" if high else ""


def _items(value: Any) -> tuple[Any, ...]:
    return () if value is None else value if isinstance(value, tuple) else (value,)
