"""Parameter sets (SSV) and mappings (SSM): start values of the FMUs of an SSP, or of any other."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from ..build.ssp import PREFIXES
from ..errors import InputError, did_you_mean, refuse
from ..interface.parameters import ParameterValue
from ..interface.units import OUR_UNITS, PLAIN, Units, conversion, doubt
from ..interface.variables import Interface, Scalar, Value
from ..reading import read_xml
from .fmu_file import read_units, read_value
from .ssp_structure import Document, End, Link, Structure, choice, converts_units, local, shown


@dataclass(frozen=True)
class _Given:
    """A value of a parameter set."""

    number: int  # of all of them; of several that lead to one variable, the last counts
    place: str  # in messages
    text: str
    unit: tuple[str, Units]  # with those that define it
    entry: ET.Element  # of a parameter mapping; an empty one if there is none


class Parameters:
    """Start values that the bindings of a structure give to its FMUs.

    `system_from_ssp` makes it, once all connections are read, along which values go on. A set that
    belongs to no SSP is read by `read_parameters`.
    """

    def __init__(self, structure: Structure) -> None:
        self.values: dict[str, dict[str, Value]] = defaultdict(dict)  # by component and variable
        self.warnings: list[str] = []
        self._structure, self._document = structure, structure.document
        self._given: dict[End, _Given] = {}
        self._number = 0
        # What a parameter sets, by its name from the whole system; two elements may share a name.
        self._targets: dict[str, list[list[End]]] = defaultdict(list)
        for element, names in structure.items.items():
            for name, items in names.items():
                ends = [(element, item) for item in items]
                self._targets[_full_name(element, name)].append(ends)
        for binding, owner in structure.bindings:
            self._read(binding, owner)
        for instance, fmu in structure.fmus.items():
            for name in fmu.variables:
                chain = structure.chain((instance, name))
                given = [
                    (self._given[e].number, i) for i, e in enumerate(chain) if e in self._given
                ]
                if given:
                    self.values[instance][name] = self._value(chain[max(given)[1] :])

    def _read(self, binding: ET.Element, owner: str) -> None:
        """Note the values of a binding at the ends that it names."""
        values, label = _content(binding, "ssd:ParameterValues/ssv:ParameterSet", self._document)
        entries, unused = _entries(binding, self._document), []
        for own_name, texts, unit in _rows(values, label, self._document.units):
            name = binding.get("prefix", "") + own_name
            as_it_is = [ET.Element("", target=name)]
            for entry in as_it_is if entries is None else entries[name]:
                target = _full_name(owner, entry.get("target", ""))
                place = f"{label}: parameter {target}"
                for ends in self._targets.get(target, ()):
                    self._number += 1
                    for end, text in _paired(place, ends, texts):
                        self._given[end] = _Given(self._number, place, text, unit, entry)
                if target not in self._targets:
                    unused.append(target)
        if unused:
            self.warnings.append(
                f"{label}: no variable is called {', '.join(unused[:3])}"
                f"{', ...' * (len(unused) > 3)}{did_you_mean(unused[0], self._targets)}"
            )

    def _value(self, chain: list[End]) -> Value:
        """Value at the end of a chain; its unit is converted first, then it is transformed."""
        structure, (instance, name), given = self._structure, chain[-1], self._given[chain[0]]
        scalar = structure.fmus[instance].variable(name)
        kind, causality = scalar.variable.kind, scalar.variable.causality
        if causality not in ("parameter", "input") and not scalar.variable.has_start:
            must = "parameter or input, or initial exact or approx"
            raise InputError(f"{given.place}: causality {causality}; must be {must}")
        change, text, linear = choice(given.entry), given.text, PLAIN
        if change is not None and local(change).endswith("MappingTransformation"):
            text = _mapped(change, text, given.place)
        else:
            linear = self._document.linear(given.place, given.entry)
        value = read_value(f"{given.place} =", scalar.variable, text)
        first = Link(("", ""), linear, converts_units(given.entry))
        links = [(chain[0], first), *((end, structure.links[end]) for end in chain[1:])]
        factor, offset = structure.linear(given.place, given.unit, links)
        reason = doubt(*given.unit, scalar.unit, structure.fmus[instance].units)
        have_units = given.unit[0] and scalar.unit
        if reason and have_units and all(link.converts_units for _, link in links):
            self.warnings.append(f"{given.place}: {reason}, so the value is taken as it is")
        if (factor, offset) != PLAIN:
            if kind != "Real":
                raise InputError(f"{given.place}: a transformation of a {kind}; must be of a Real")
            value = factor * float(value) + offset
        return scalar.checked(given.place, value)


def read_parameters(file: Path, interfaces: Mapping[str, Interface]) -> dict[str, ParameterValue]:
    """Read a parameter set (.ssv) for FMUs of any origin: values in their units, by FMU.VARIABLE.

    Raises:
        InputError: It names no variable of the FMUs, or a value or unit is not one of it.
    """
    root = read_xml(file, str(file))
    if local(root) != "ParameterSet":
        refuse(f"{file}: root element", local(root), "must be a ParameterSet")
    targets: dict[str, list[tuple[str, Scalar]]] = defaultdict(list)
    for instance, interface in interfaces.items():
        for scalar in interface.scalars():
            for name in {scalar.name, scalar.variable.name}:
                targets[_full_name(instance, name)].append((instance, scalar))
    values: dict[str, ParameterValue] = {}
    for name, texts, unit in _rows(root, str(file), {}):
        place = f"{file}: parameter {name}"
        if name not in targets:
            refuse(f"{file}: parameter", name, "must be a variable, as FMU.NAME", targets)
        for (instance, scalar), text in _paired(place, targets[name], texts):
            value = read_value(f"{place} =", scalar.variable, text)
            units = (*unit, scalar.unit, interfaces[instance].units or OUR_UNITS)
            values[f"{instance}.{scalar.name}"] = _converted(place, value, units)
    return values


def _converted(place: str, value: Value, units: tuple[str, Units, str, Units]) -> Value:
    """Convert a value between two units, as far as both sides have one."""
    unit, _, other, _ = units
    linear = conversion(*units)
    if linear is None or (unit and other and doubt(*units)):
        refuse(f"{place}: unit", unit, f"must be {other}, or defined by the same SI base units")
    return value if linear == PLAIN else linear[0] * float(value) + linear[1]


def _paired(place: str, targets: list[Any], texts: list[str]) -> Iterator[tuple[Any, str]]:
    """What a parameter sets, and its values, which must be as many."""
    if len(texts) != len(targets):
        refuse(f"{place}: number of values", len(texts), f"must be {len(targets)}")
    return zip(targets, texts, strict=True)


def _mapped(change: ET.Element, text: str, place: str) -> str:
    """What a mapping of Booleans, Integers or Enumerations makes of a value."""
    words = {"1": "true", "0": "false"} if local(change).startswith("Boolean") else {}
    entries = change.findall("ssc:MapEntry", PREFIXES)
    table = {words.get(e.get("source", ""), e.get("source", "")): e for e in entries}
    if words.get(text, text) not in table:
        raise InputError(f"{place} = {text!r}; must be one of {', '.join(table)}, which are mapped")
    return table[words.get(text, text)].get("target", "")


def _full_name(element: str, name: str) -> str:
    return shown((element.replace("/", "."), name))


def _rows(
    values: ET.Element, label: str, units: Units
) -> Iterator[tuple[str, list[str], tuple[str, Units]]]:
    """Yield the parameters of a set: name, value of each element, and unit."""
    units = {**units, **read_units(label, values.iterfind("ssv:Units/ssc:Unit", PREFIXES))}
    for parameter in values.iterfind("ssv:Parameters/ssv:Parameter", PREFIXES):
        typed = choice(parameter)
        typed = parameter if typed is None else typed
        texts, text = [child.get("value", "") for child in typed], typed.get("value")
        if text is not None:
            is_one = local(typed) in ("String", "Enumeration", "Binary")
            texts = [text] if is_one else text.split()
        yield parameter.get("name", ""), texts, (typed.get("unit", ""), units)


def _entries(binding: ET.Element, document: Document) -> dict[str, list[ET.Element]] | None:
    """Entries of a parameter mapping by the names of their sources."""
    mapping = binding.find("ssd:ParameterMapping", PREFIXES)
    if mapping is None:
        return None
    entries: dict[str, list[ET.Element]] = defaultdict(list)
    content, _ = _content(mapping, "ssm:ParameterMapping", document)
    for entry in content.iterfind("ssm:MappingEntry", PREFIXES):
        entries[entry.get("source", "")].append(entry)
    return entries


def _content(holder: ET.Element, path: str, document: Document) -> tuple[ET.Element, str]:
    """What an element holds, or names as its source; and what messages call it."""
    source, tag, label = holder.get("source"), path.rpartition(":")[2], document.label
    if source and holder.get("sourceBase", "SSD") != "SSD":
        document.refuse(f"{local(holder)} {source!r} in a component", "one in the .ssp file")
    if source:
        label = f"{label}: {source}"
    content = read_xml(document.member(source), label) if source else holder.find(path, PREFIXES)
    if content is None or local(content) != tag:
        raise InputError(f"{label}: {local(holder)}: no {tag}; must hold one, or name its file")
    return content, label
