"""The order in which FMUs are stepped, by their connections: who feeds comes first.

Some order has to give way where FMUs feed each other in a loop. A MuJoCo model gives way first: its
outputs belong to the end of a step, so it comes after all that it feeds, and its rows hold them at
their instant. Next gives way what is fed by outputs that depend on no input. The rest goes by name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from ..interface.tables import Connection

if TYPE_CHECKING:
    from ..interface.variables import Interface
    from .fmu_file import Fmu

Ends = tuple[tuple[str, str], tuple[str, str]]  # source and target: instance and scalar
OF_MODEL, OF_STATE, OF_INPUT = range(3)  # what gives way first, next and last


def stepping_order(
    fmus: Mapping[str, Fmu | Interface], connections: Sequence[Connection]
) -> list[str]:
    """Return the FMUs' names in the order of stepping; no order of the arguments has an effect."""
    firmness = _firmness(fmus, connections)
    before: dict[str, set[str]] = {name: set() for name in fmus}
    # Among equals, the pairs that make the last name wait for others are taken first.
    for earlier, later in sorted(firmness, key=lambda p: (firmness[p], *p[::-1]), reverse=True):
        if earlier != later and later not in before[earlier]:
            for name in fmus:
                if name == later or later in before[name]:
                    before[name] |= {earlier, *before[earlier]}
    return sorted(fmus, key=lambda name: (len(before[name]), name))


def _firmness(
    fmus: Mapping[str, Fmu | Interface], connections: Sequence[Connection]
) -> dict[tuple[str, str], int]:
    """What gives way when, by what is stepped earlier and later."""
    firmness: dict[tuple[str, str], int] = {}
    for (source, output), target in ((c.source, c.target[0]) for c in connections):
        pair, kind = (source, target), OF_INPUT
        if fmus[source].is_model:
            pair, kind = (target, source), OF_MODEL
        elif output in fmus[source].independent:
            kind = OF_STATE
        firmness[pair] = max(kind, firmness.get(pair, kind))
    return firmness


def late(order: Sequence[str], connections: Sequence[Connection], coupling: str) -> list[str]:
    """Name the connections whose target gets values of the step before."""
    place = {name: i for i, name in enumerate(order)}
    return [
        f"{source} -> {target}"
        for source, target, ((feeder, _), (fed, _)) in by_variable(connections)
        if coupling == "jacobi" or (coupling != "iterated" and place[feeder] >= place[fed])
    ]


def shown(order: Sequence[str], held: Sequence[str]) -> str:
    """Say in one line in which order FMUs are stepped, and which connections are late."""
    more = f"; a step late: {', '.join(held)}" if held else ""
    return f"FMUs are stepped in the order {', '.join(order)}{more}"


def by_variable(connections: Iterable[Connection]) -> Iterator[tuple[str, str, Ends]]:
    """Yield sources and targets as variables, with ranges of indices, and one of their pairs."""

    def key(connection: Connection) -> tuple[tuple[str, int], ...]:
        ends = (connection.source, connection.target)
        return tuple((f"{fmu}.{n.partition('[')[0]}", len(_indices(n))) for fmu, n in ends)

    for ((source, _), (target, _)), group in groupby(connections, key):
        wires = list(group)
        sources, targets = ([getattr(w, end)[1] for w in wires] for end in ("source", "target"))
        ends = (wires[0].source, wires[0].target)
        yield source + _span(sources), target + _span(targets), ends


def _indices(name: str) -> list[int]:
    return [int(index) for index in re.findall(r"\d+(?=[,\]])", name)]


def _span(names: list[str]) -> str:
    """Return the ranges of scalar variables' indices, such as [1..7]."""
    axes = zip(_indices(names[0]), _indices(names[-1]), strict=True)
    ranges = [str(low) if len(names) == 1 else f"{low}..{high}" for low, high in axes]
    return f"[{','.join(ranges)}]" if ranges else ""
