"""Suggests lines of [connect] for inputs that nothing feeds."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from difflib import SequenceMatcher
from itertools import islice
from typing import Final

from ...fmus.errors import InputError
from ...fmus.interface.variables import Variable
from ...run.system.assembly import Assembly
from ...run.system.connector import OPTIONAL, Connector

ALIKE: Final = 0.6  # of two names, as `SequenceMatcher` measures it
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
        source = _nearest(connector, name, variable)
        if source:
            target = f"{name}.{variable.name}"
            yield f'nothing feeds {target}; perhaps [connect] "{target}" = "{source}"'


def _nearest(connector: Connector, name: str, fed: Variable) -> str:
    """Return the output that fits an input: of a name like its own, or the only one of its unit."""
    fitting, stem = [], _SIDE.sub("", fed.name.lower())
    for part in connector.parts.values():
        for giving in part.interface.of("output") if part.name != name else ():
            with suppress(InputError):
                source = f"{part.name}.{giving.name}"
                connector.check(source, giving, f"{name}.{fed.name}", fed)
                alike = SequenceMatcher(None, _SIDE.sub("", giving.name.lower()), stem).ratio()
                fitting.append((alike, source, giving))
    likeness, source, _ = max(fitting, default=(0.0, "", fed), key=lambda each: each[0])
    if likeness >= ALIKE:
        return source
    same_unit = [each for each in fitting if fed.unit not in ("", "1") and each[2].unit]
    return same_unit[0][1] if len(same_unit) == 1 else ""
