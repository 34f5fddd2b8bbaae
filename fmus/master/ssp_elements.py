"""The elements that an SSP file may have; one that is mistyped must not be skipped silently."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NoReturn
from xml.etree import ElementTree as ET

from ..messages import did_you_mean
from ..packaging.ssp import SSD, SSV

_ANYWHERE: Final = ("Annotations", "MetaData", "Signature")
# Ref: SSP 1.0 and 2.0, schemas of SystemStructureDescription and SystemStructureParameterValues.
_CHILDREN: Final = {
    f"{{{SSD}}}System": (
        "Connectors", "ElementGeometry", "ParameterBindings", "Elements", "Connections",
        "SignalDictionaries", "SystemGeometry", "GraphicalElements",
    ),
    f"{{{SSD}}}Component": ("Connectors", "ElementGeometry", "ParameterBindings"),
    f"{{{SSD}}}Connectors": ("Connector",),
    f"{{{SSD}}}Connections": ("Connection",),
    f"{{{SSD}}}ParameterBindings": ("ParameterBinding",),
    f"{{{SSD}}}ParameterBinding": ("ParameterValues", "ParameterMapping"),
    f"{{{SSD}}}ParameterValues": ("ParameterSet",),
    f"{{{SSV}}}ParameterSet": ("Parameters", "Enumerations", "Units"),
    f"{{{SSV}}}Parameters": ("Parameter",),
}  # fmt: skip


def check_children(element: ET.Element, refuse: Callable[[str, str], NoReturn]) -> None:
    """Check that the children of an element, and theirs, are elements of SSP.

    Args:
        element: A system, component, parameter binding or parameter set.
        refuse: Raises InputError.
    """
    valid = _CHILDREN.get(element.tag, ())
    for child in element if valid else ():
        space, _, name = child.tag.rpartition("}")
        if name in _ANYWHERE:
            continue
        parent = element.tag.rpartition("}")[2]
        if name not in valid:
            refuse(f"{parent} with element {name!r}", f"as in SSP{did_you_mean(name, valid)}")
        expected = SSV if name == "ParameterSet" else element.tag.rpartition("}")[0][1:]
        if space[1:] != expected:
            refuse(f"element {name!r} of namespace {space[1:]!r}", f"of {expected}")
        check_children(child, refuse)


__all__ = ["check_children"]
