"""Suggests lines of [connect] for inputs that nothing feeds."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from typing import Final

from ...fmus.errors import InputError, nearest
from ...fmus.interface.variables import Variable
from ...run.system.assembly import Assembly
from ...run.system.connector import OPTIONAL, Connector

_SIDE: Final = re.compile(r"[_.]?(input|output|in|out|cmd|meas|measured)$", re.I)


def suggestions(assembly: Assembly) -> Iterator[str]:
    """Yield lines of [connect] for inputs that nothing feeds: shape, type, unit and name fit."""
    connector = Connector(assembly.parts)
    fed = {*assembly.external, *(connection.target for connection in assembly.connections)}
    foreign = [part for part in assembly.parts if part.file is not None]
    inputs = [(part.name, each) for part in foreign for each in part.interface.of("input")]
    for name, variable in inputs:
        if variable.name in OPTIONAL or any((name, scalar) in fed for scalar in variable.names()):
            continue
        stems = {_stem(giving): source for source, giving in _fitting(connector, name, variable)}
        if near := nearest(_stem(variable), stems):
            target = f"{name}.{variable.name}"
            yield f'nothing feeds {target}; perhaps [connect] "{target}" = "{stems[near]}"'


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
