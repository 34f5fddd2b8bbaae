"""Tables and Markdown of the FMUs' interfaces, for `info`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import compress, groupby
from typing import Any

from rich.table import Table

from ...fmus.interface.controller import COMMANDS
from ...fmus.interface.plant import FORCES
from ...fmus.interface.tables import CONNECTIONS, INTERFACES, Connection
from ...fmus.interface.variables import Causality, Interface, Variable
from .console import as_cell, table

_COLUMNS = ("name", "unit*", "start*", "range*", "description*")
_MANY = 3  # different bounds; more are shown as one range


def variables_tables(interface: Interface) -> Iterator[Table]:
    """Yield a table for each kind of variable, with one row per variable."""
    causalities: tuple[Causality, ...] = ("input", "output", "parameter")
    for causality in causalities:
        rows = sorted(interface.of(causality), key=lambda variable: variable.variability)
        for variability, group in groupby(rows, key=lambda variable: variable.variability):
            yield _variables_table(f"{causality}s, {variability}", list(group))


def _variables_table(title: str, variables: list[Variable]) -> Table:
    """Return a table without its empty columns."""
    rows = [
        (shaped_name(v), condensed(v.unit), condensed(v.start), _range(v), v.description)
        for v in variables
    ]
    filled = [any(cells) for cells in zip(*rows, strict=True)]
    made = table([*compress(_COLUMNS, filled)], title=f"\n{title}")
    for row in rows:
        made.add_row(*map(as_cell, compress(row, filled)))
    return made


def variables_markdown(interface: Interface) -> str:
    """Return a Markdown table with one row per variable, for REFERENCE.md."""
    lines = [
        "| variable | unit | causality | start | description |",
        "| --- | --- | --- | --- | --- |",
    ]
    for v in interface.variables:
        causality = "tunable parameter" if v.variability == "tunable" else v.causality
        cells = (f"`{shaped_name(v)}`", condensed(v.unit), causality, condensed(v.start))
        lines.append("| " + " | ".join((*cells, v.description)) + " |")
    return "\n".join(lines)


def described(
    interfaces: Mapping[str, Interface], connected: Iterable[Connection] = CONNECTIONS
) -> dict[str, Any]:
    """Return all variables of some instances, and the connections from or to them."""
    fmus = {
        name: {
            "model": interface.model,
            "description": interface.description,
            "variables": interface.variables,
        }
        for name, interface in interfaces.items()
    }
    connections = [
        {"from": ".".join(c.source), "to": ".".join(c.target)}
        for c in connected
        if {c.source[0], c.target[0]} & interfaces.keys()
    ]
    return {"fmus": fmus, "connections": connections}


def shaped_name(variable: Variable) -> str:
    """Return the name with the ranges of its indices, such as jac[1..6,1..7]."""
    ranges = ",".join(f"1..{n}" for n in variable.shape)
    return f"{variable.name}[{ranges}]" if ranges else variable.name


def condensed(values: Any) -> str:
    """Return one value, or several with equal neighbours counted, such as `rad (7), 1`."""
    if values is None or values == "":
        return ""
    if not isinstance(values, tuple):
        return _written(values)
    runs = [(value, len(list(group))) for value, group in groupby(values)]
    if len(runs) == 1:
        return _written(values[0])
    return ", ".join(f"{_written(v)} ({n})" if n > 1 else _written(v) for v, n in runs)


def _written(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.4g}" if isinstance(value, float | int) else str(value)


def _range(variable: Variable) -> str:
    """Return the valid values, as one range that contains those of all elements."""
    if variable.choices:
        return " | ".join(variable.choices)
    low, high = (_numbers(bound) for bound in (variable.minimum, variable.maximum))
    several = "each its own, " if max(len(set(low)), len(set(high))) > _MANY else ""
    if low and high:
        return f"{several}{min(low):.4g} to {max(high):.4g}"
    return f">= {min(low):.4g}" if low else f"<= {max(high):.4g}" if high else ""


def _numbers(bound: float | tuple[float, ...] | None) -> tuple[float, ...]:
    return () if bound is None else bound if isinstance(bound, tuple) else (bound,)


def connections_table(
    fmu: str | None = None, connections: Sequence[Connection] | None = None
) -> Table:
    """Return a table with one row per group of connections."""
    made = table(("from", "to"))
    given = _given() if connections is None else []
    for source, target in (*given, *_connected(connections or CONNECTIONS)):
        if fmu is None or any(end.startswith(f"{fmu}.") for end in (source, target)):
            made.add_row(as_cell(source), as_cell(target))
    return made


def _given() -> list[tuple[str, str]]:
    """The inputs that the scenario gives at each tick."""
    rows = [("the scenario's table", f"controller.{_of('controller', c)}") for c in COMMANDS]
    pushes = [("the scenario's pushes", f"plant.{_of('plant', n)}") for n in FORCES.values()]
    return [*rows, *pushes]


def _of(instance: str, name: str) -> str:
    return shaped_name(INTERFACES[instance].variable(name))


def _connected(connections: Iterable[Connection]) -> list[tuple[str, str]]:
    """Group connections by variable."""

    def key(connection: Connection) -> tuple[str, ...]:
        ends = (connection.source, connection.target)
        return tuple(f"{instance}.{name.partition('[')[0]}" for instance, name in ends)

    rows = []
    for (source, target), group in groupby(connections, key):
        members = list(group)
        rows.append(
            (
                source + _span([c.source[1] for c in members]),
                target + _span([c.target[1] for c in members]),
            )
        )
    return rows


def _span(names: list[str]) -> str:
    """Return the ranges of scalar variables' indices, such as [1..7]."""
    indices = [[int(i) for i in re.findall(r"\d+(?=[,\]])", name)] for name in names]
    if not indices[0]:
        return ""
    axes = [(min(axis), max(axis)) for axis in zip(*indices, strict=True)]
    if len(indices) == 1:
        return f"[{','.join(str(low) for low, _ in axes)}]"
    ranges = [f"{low}..{high}" for low, high in axes]
    return f"[{','.join(ranges)}]"
