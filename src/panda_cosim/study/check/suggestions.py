"""Suggests lines of [connect] for inputs that nothing feeds."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import Final

from ...fmus.errors import InputError, nearest
from ...fmus.interface.variables import Variable
from ...run.system.assembly import Assembly
from ...run.system.connector import OPTIONAL, Connector

LOOKED_AT: Final = 20  # unconnected inputs
_SIDE: Final = re.compile(r"[_.]?(input|output|in|out|cmd|meas|measured)$", re.I)


def suggestions(assembly: Assembly) -> Iterator[str]:
    """Yield lines of [connect] for inputs that nothing feeds: shape, type, unit and name fit."""
    connector = Connector(assembly.parts)
    fed = {*assembly.external, *(connection.target for connection in assembly.connections)}
    unfed = (
        (part.name, variable)
        for part in assembly.parts
        if part.file is not None
        for variable in part.interface.of("input")
        if variable.name not in OPTIONAL
        if not any((part.name, name) in fed for name in variable.names())
    )
    for name, variable in islice(unfed, LOOKED_AT):
        if source := _nearest(connector, name, variable):
            target = f"{name}.{variable.name}"
            yield f'nothing feeds {target}; perhaps [connect] "{target}" = "{source}"'


def _nearest(connector: Connector, name: str, fed: Variable) -> str:
    """Return the output that fits an input: of a name like its own, or the only one of its unit."""
    fitting = dict(_fitting(connector, name, fed))
    stems = {_stem(giving): source for source, giving in reversed(fitting.items())}
    if near := nearest(_stem(fed), stems):
        return stems[near]
    same_unit = [source for source, giving in fitting.items() if giving.unit]
    return same_unit[0] if len(same_unit) == 1 and fed.unit not in ("", "1") else ""


def _fitting(connector: Connector, name: str, fed: Variable) -> Iterator[tuple[str, Variable]]:
    """Yield the outputs of other FMUs whose shape, type and unit fit an input."""
    for part in connector.parts.values():
        for giving in part.interface.of("output") if part.name != name else ():
            with suppress(InputError):
                source = f"{part.name}.{giving.name}"
                connector.check(source, giving, f"{name}.{fed.name}", fed)
                yield source, giving


def _stem(variable: Variable) -> str:
    return _SIDE.sub("", variable.name.lower())
