"""`panda-cosim info`."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, compress, groupby
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table
from rich.text import Text

from ...fmus.build.engines import known_faults
from ...fmus.errors import InputError, did_you_mean, excerpt
from ...fmus.interface.tables import CONNECTIONS, INTERFACES, Connection
from ...fmus.interface.variables import Interface, Variable
from ...fmus.master.fmu_file import Fmu, described_interface, read_fmu
from ...fmus.master.order import by_variable, late, stepping_order
from ...fmus.master.order import shown as order_line
from ...fmus.sources.model_fmu import load
from ...fmus.sources.targets import ONLY_PYTHON, OWN, Target
from ...result.view.model import describe
from ...run.system.assembly import assemble, system_scenario
from ...run.system.parts import UnreadSlaveError
from ...task.scenario import SCENARIO_FILE, Scenario
from ..common import JSON, announce_python
from ..console import WIDEST, Item, show_result, table
from ..forms import argument, flag, option

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

    Of a scenario's parts in Python, PythonFMU slaves are run to learn their variables. Of a scene
    of its own, all fixed and free bodies are listed.

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
    found, path = _read(fmu), Path(fmu or "")
    faults = known_faults(path) if path.suffix == ".fmu" else []
    code = {name: _code(name, interface, path) for name, interface in found.interfaces.items()}
    shown = _filtered(text.lower(), found)
    announce_python()
    content = {**_described(shown), "code": code, "faults": faults}
    items = _markdown(shown) if markdown else _texts(shown, code, faults)
    show_result(content, items, json=json, most=WIDEST if markdown else WIDTH)


class _Shown(NamedTuple):
    """FMUs, how they are connected, and in which order they are stepped."""

    interfaces: Mapping[str, Interface]
    connections: Sequence[Connection]
    order: Sequence[str]
    late: Sequence[str] = ()  # connections
    objects: Sequence[tuple[str, str, str, str]] = ()  # of a model's scene; see `_objects`


def _markdown(shown: _Shown) -> Iterator[str]:
    """Yield a table of each FMU's variables, and a drawing of how they are connected."""
    parts = [*map(variables_markdown, shown.interfaces.values())]
    if len(shown.order) > 1:
        parts.append(_drawing(shown))
    yield "\n\n".join(parts)


def _texts(shown: _Shown, code: Mapping[str, str], faults: Sequence[str]) -> Iterator[Item]:
    """Yield what each FMU is, what runs in it, its variables, and how they are connected."""
    for name, interface in shown.interfaces.items():
        yield Text(f"{interface.model} (instance {name}): {interface.description}", "bold")
        yield f"What runs in it: {code[name]}{', as it has no twin in C' * (name in ONLY_PYTHON)}"
        yield from _variables_tables(interface)
        yield ""
    if shown.objects:
        heads = ("body", "", "place [m]", "shapes, with sizes as in MJCF*")
        yield table(heads, shown.objects, title="What stands in the scene")
    for fault in faults:
        yield Text(fault, "yellow")
    if shown.connections:
        yield Text("Connections\n", "bold")
        ends = [(source, target) for source, target, _ in by_variable(shown.connections)]
        wires = [(*each, LATE * (" -> ".join(each) in shown.late)) for each in ends]
        yield table(("from", "to", ""), wires)
    if len(shown.order) > 1:
        yield order_line(shown.order, [])


def _read(name: str | None) -> _Shown:
    """Read what is asked for; of its code, only PythonFMU slaves are run."""
    if name is None:
        order = stepping_order(INTERFACES, CONNECTIONS)
        return _Shown(INTERFACES, CONNECTIONS, order, late(order, CONNECTIONS, Scenario.coupling))
    if name in OWN:
        wires = [each for each in CONNECTIONS if name in (each.source[0], each.target[0])]
        return _Shown({name: OWN[name].interface}, wires, [name])
    path = Path(name)
    if path.suffix == ".fmu":
        return _Shown({path.stem: described_interface(Fmu(path))}, (), [path.stem])
    if path.suffix == ".ssp":
        return _of_scenario(system_scenario(path))
    if (path / SCENARIO_FILE).is_file():
        return _of_scenario(Scenario.read(path))
    must = f"must be {', '.join(OWN)}, an .fmu or .ssp file, or a scenario's folder"
    raise InputError(f"{excerpt(name)}: {must}{did_you_mean(name, OWN)}")


def _of_scenario(scenario: Scenario) -> _Shown:
    """Return the parts of a scenario, and what stands in the scenes of its models."""
    try:
        made = assemble(scenario, run_code=False)
    except UnreadSlaveError:  # its variables are only known when it is run
        made = assemble(scenario)
    held = made.late(scenario.coupling)
    models = (part.file for part in made.parts if part.is_model and part.file)
    objects = [*chain.from_iterable(map(_objects, models))]
    return _Shown(made.interfaces, made.connections, [*made.interfaces], held, objects)


def _objects(model: Path) -> Iterator[tuple[str, str, str, str]]:
    """Yield what stands in a model's scene: bodies that are fixed or free, and their shapes."""
    bodies: Any = describe(load(model))["bodies"]
    for body in bodies:
        joints = ", ".join(joint["kind"] for joint in body["joints"])
        if body["fixed"] or joints == "free":
            place = " ".join(map(str, body["pos"]))
            shapes = (" ".join(map(str, (it["kind"], *it["size"]))) for it in body["shapes"])
            yield body["name"], joints or "fixed", place, "; ".join(shapes)


def _filtered(text: str, shown: _Shown) -> _Shown:
    """Keep the variables with a text in name or description, and connections with it in names."""
    interfaces = {}
    for name, interface in shown.interfaces.items():
        kept = (v for v in interface.variables if _has(text, (name, v.name), (v.description,)))
        interfaces[name] = replace(interface, variables=tuple(kept))
    wires = [each for each in shown.connections if _has(text, each.source, each.target)]
    return shown._replace(interfaces=interfaces, connections=wires)


def _has(text: str, *names: Sequence[str]) -> bool:
    return text in " ".join(map(".".join, names)).lower()


def _code(name: str, interface: Interface, file: Path) -> str:
    """Return what runs in one of the project's own FMUs or in an .fmu file."""
    if any(interface is own.interface for own in OWN.values()):
        return Target().kind_of(name)
    return read_fmu(file).code if file.suffix == ".fmu" else "its own"


def _drawing(shown: _Shown) -> str:
    """Draw FMUs in the order of stepping, and connections, dashed if late, as Mermaid does."""
    number = {name: i for i, name in enumerate(shown.order, 1)}
    lines = [f'  {i}["{i} {_quoted(name)}"]' for name, i in number.items()]
    ways = defaultdict[tuple[int, str, int], list[str]](list)
    for source, target, ((feeder, _), (fed, _)) in by_variable(shown.connections):
        line = "-.->" if f"{source} -> {target}" in shown.late else "-->"
        names = ways[number[feeder], line, number[fed]]
        names.append(_quoted(target.removeprefix(f"{fed}.")))
    lines += [f'  {a} {line}|"{", ".join(names)}"| {b}' for (a, line, b), names in ways.items()]
    return "\n".join(["```mermaid", "flowchart LR", *lines, "```"])


def _quoted(text: str) -> str:
    return text.replace('"', "#quot;")


def _described(shown: _Shown) -> dict[str, object]:
    """Return plain values, for JSON."""
    about = ("model", "description", "variables")
    fmus = {name: {k: getattr(it, k) for k in about} for name, it in shown.interfaces.items()}
    ends = [{"from": ".".join(it.source), "to": ".".join(it.target)} for it in shown.connections]
    return {"fmus": fmus, "connections": ends, "order": shown.order, "late": shown.late,
            "objects": shown.objects}  # fmt: skip


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
        cells = (compress(row, filled) for row in rows)
        yield table([*compress(_COLUMNS, filled)], cells, title=f"\n{causality}s, {variability}")


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
