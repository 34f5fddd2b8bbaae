"""Parameter values in SSP files."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import NoReturn
from xml.etree import ElementTree as ET

from ..interface.variables import Value
from ..packaging.ssp import PREFIXES, SSV
from ..reading import finite_number
from .ssp_elements import check_children

Refuse = Callable[[str, str], NoReturn]  # what was found, what it must be


def bound_parameters(
    element: ET.Element, file: Callable[[str], ET.Element], refuse: Refuse
) -> Iterator[tuple[str, ET.Element]]:
    """Yield name and typed value of each parameter that is bound to a system or component.

    Args:
        element: The system or component.
        file: Function that reads a parameter set from a file in the archive.
        refuse: Raises InputError.
    """
    for binding in element.findall("ssd:ParameterBindings/ssd:ParameterBinding", PREFIXES):
        if binding.find("ssd:ParameterMapping", PREFIXES) is not None:
            refuse("a parameter mapping", "parameters under their own names")
        source, prefix = binding.get("source"), binding.get("prefix", "")
        if source:
            sets = [file(source)]
        else:
            sets = binding.findall("ssd:ParameterValues/ssv:ParameterSet", PREFIXES)
        if not sets:
            refuse("a parameter binding without values", "of a source or an ssv:ParameterSet")
        for parameter_set in sets:
            if parameter_set.tag != f"{{{SSV}}}ParameterSet":
                refuse(f"parameter set of element {parameter_set.tag!r}", "an ssv:ParameterSet")
            check_children(parameter_set, refuse)
            for parameter in parameter_set.findall("ssv:Parameters/ssv:Parameter", PREFIXES):
                if len(parameter) != 1:
                    refuse(f"parameter {parameter.get('name')!r}", "of one value")
                yield prefix + parameter.get("name", ""), parameter[0]


def parse_value(place: str, kind: str, typed: ET.Element, refuse: Refuse) -> Value:
    """Parse a value of a parameter set.

    Args:
        place: What to call it in messages.
        kind: Type of the FMU's variable.
        typed: Element such as `<ssv:Real value="0.2"/>`.
        refuse: Raises InputError.
    """
    tag, text = typed.tag.rpartition("}")[2], typed.get("value")
    if text is not None and kind == "Enumeration" and tag in ("Enumeration", "String"):
        return text  # the item's name, checked later like any start value
    if text is None or {"Enumeration": "Integer"}.get(kind, kind) != tag:
        refuse(f"{place} of type {tag}", f"a value of type {kind}")
    text = text if kind == "String" else text.strip()
    if kind == "Boolean":
        if text not in ("true", "false", "0", "1"):
            refuse(f"{place} = {text!r}", "true or false")
        return text in ("true", "1")
    if kind in ("Integer", "Enumeration"):
        if not re.fullmatch(r"[+-]?\d{1,20}", text, re.ASCII):
            refuse(f"{place} = {text!r}", "a whole number")
        return int(text)
    if kind == "Real":
        number = finite_number(text)
        return refuse(f"{place} = {text!r}", "a finite number") if number is None else number
    return text
