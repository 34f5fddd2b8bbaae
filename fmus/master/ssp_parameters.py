"""The parameters of an SSP: parameter sets (SSV) and mappings (SSM) as start values of its FMUs."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from ..build.ssp import PREFIXES
from ..errors import InputError
from ..interface.units import Units
from ..interface.variables import Value
from ..messages import did_you_mean
from ..reading import read_xml
from .fmu_file import read_units, read_value
from .ssp_structure import (
    PLAIN,
    Document,
    End,
    Link,
    Structure,
    choice,
    converts_units,
    local,
    shown,
)

_Elements = list[list[list[End]]]  # for each element of a parameter, the chains that it goes along


class Parameters:
    """Start values that the bindings of a structure give to its FMUs."""

    def __init__(self, structure: Structure) -> None:
        self.values: dict[str, dict[str, Value]] = {}  # by component and variable
        self.warnings: list[str] = []
        self._structure, self._document = structure, structure.document
        self._targets = _targets(structure) if structure.bindings else {}
        for binding, owner in structure.bindings:
            self._apply(binding, owner)

    def _apply(self, binding: ET.Element, owner: str) -> None:
        document = self._document
        values, label = _content(binding, "ssd:ParameterValues/ssv:ParameterSet", document)
        own_units = read_units(label, values.iterfind("ssv:Units/ssc:Unit", PREFIXES))
        entries, unused = _entries(binding, document), []
        for parameter in values.iterfind("ssv:Parameters/ssv:Parameter", PREFIXES):
            name, typed = binding.get("prefix", "") + parameter.get("name", ""), choice(parameter)
            typed = parameter if typed is None else typed
            as_it_is = [ET.Element("", target=name)]
            for entry in as_it_is if entries is None else entries[name]:
                target = _full_name(owner, entry.get("target", ""))
                given = _Given(f"{label}: parameter {target}", typed, entry, own_units)
                for elements in self._targets.get(target, ()):
                    self._set(elements, given)
                if target not in self._targets:
                    unused.append(target)
        if unused:
            self.warnings.append(
                f"{label}: no variable is called {', '.join(unused[:3])}"
                f"{', ...' * (len(unused) > 3)}{did_you_mean(unused[0], self._targets)}"
            )

    def _set(self, elements: _Elements, given: _Given) -> None:
        texts = _texts(given.typed)
        if len(texts) != len(elements):
            count = f"{len(elements)} values" if len(elements) > 1 else "one value"
            raise InputError(f"{given.place}: has {len(texts)} values; must be {count}")
        for chains, text in zip(elements, texts, strict=True):
            for chain in chains:
                instance, name = chain[-1]
                self.values.setdefault(instance, {})[name] = self._value(chain, text, given)

    def _value(self, chain: list[End], text: str, given: _Given) -> Value:
        """Value for the end of a chain; its unit is converted first, then it is transformed."""
        structure, (instance, name) = self._structure, chain[-1]
        scalar = structure.fmus[instance].variable(name)
        kind, causality = scalar.variable.kind, scalar.variable.causality
        change, linear = choice(given.entry), PLAIN
        if causality not in ("parameter", "input"):
            raise InputError(f"{given.place}: causality {causality}; must be parameter or input")
        if change is not None and local(change) == "LinearTransformation":
            linear = self._document.linear(change)
        elif change is not None:
            text = _mapped(change, text, given.place)
        value = read_value(f"{given.place} =", scalar.variable, text)
        first = Link(("", ""), linear, converts_units(given.entry))
        links = [(chain[0], first), *((end, structure.links[end]) for end in chain[1:])]
        unit = given.typed.get("unit", ""), {**self._document.units, **given.units}
        factor, offset = structure.linear(given.place, unit, links)
        if (factor, offset) != PLAIN:
            if kind != "Real":
                raise InputError(f"{given.place}: a transformation of a {kind}; must be of a Real")
            value = factor * float(value) + offset
        return scalar.checked(given.place, value)


@dataclass(frozen=True)
class _Given:
    """A parameter of a parameter set."""

    place: str  # in messages
    typed: ET.Element  # its type, with the values
    entry: ET.Element  # of a parameter mapping; an empty one if there is none
    units: Units  # of the parameter set


def _targets(structure: Structure) -> dict[str, list[_Elements]]:
    """What a parameter sets, by its name from the whole system; two elements may share a name."""
    fed: dict[End, list[list[End]]] = defaultdict(list)  # chains that begin at a system's connector
    for chain in structure.chains():
        for i, end in enumerate(chain[:-1]):
            fed[end].append(chain[i:])
    targets: dict[str, list[_Elements]] = defaultdict(list)
    for element, names in structure.items.items():
        for name, items in names.items():
            ends = [(element, item) for item in items]
            is_fmu = element in structure.fmus
            elements = [[[end]] if is_fmu else fed[end] for end in ends]
            targets[_full_name(element, name)].append(elements)
    return targets


def _full_name(element: str, name: str) -> str:
    return shown((element.replace("/", "."), name))


def _mapped(change: ET.Element, text: str, place: str) -> str:
    """What a mapping makes of a value."""
    words = {"1": "true", "0": "false"} if local(change).startswith("Boolean") else {}
    entries = change.findall("ssc:MapEntry", PREFIXES)
    table = {words.get(e.get("source", ""), e.get("source", "")): e for e in entries}
    if words.get(text, text) not in table:
        raise InputError(f"{place} = {text!r}; must be one of {', '.join(table)}, which are mapped")
    return table[words.get(text, text)].get("target", "")


def _texts(typed: ET.Element) -> list[str]:
    """Values of a parameter, one for each element."""
    if "value" not in typed.attrib:
        return [child.get("value", "") for child in typed]
    text = typed.attrib["value"]
    return [text] if local(typed) in ("String", "Enumeration", "Binary") else text.split()


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
