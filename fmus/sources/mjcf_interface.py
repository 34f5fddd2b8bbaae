"""The interface of an FMU of any MuJoCo model, as a TOML file with one line per variable."""

from __future__ import annotations

import json
import math
import re
import shlex
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, Final

from ...plant.parameters import ARM_JOINTS
from ..errors import InputError, refuse
from ..interface.engine import COUNTED
from ..interface.plant import PLANT
from ..interface.units import OUR_UNITS
from ..interface.variables import Causality, Interface, Variability, Variable
from ..reading import open_regular
from .mjcf_sources import OBJECTS, TUNABLE, Sources, unique, words_of

TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
SECTIONS: Final[Mapping[str, Causality]] = TABLES["sections"]
# Keys of a file and of a variable, with their types.
HEAD: Final = {"name": str, "description": str, "author": str, "keyframe": str, "extends": str,
               **dict.fromkeys(SECTIONS, dict)}  # fmt: skip
KEYS: Final = {"source": str, "unit": str, "description": str, "start": object, "min": object,
               "max": object, "tunable": bool}  # fmt: skip
_WORDS: Final = {str: "a text", bool: "true or false", dict: "a table"}
Keys = Mapping[str, Any]  # of a variable, or of the file
Rows = dict[str, Keys]  # of each variable, by name; each has a `source` at least
# Interfaces that a model with the same objects can take over, by name.
EXTENDED: Final = {PLANT.model: PLANT}
# Objects of PandaPlant whose values its vectors begin with, by kind.
FIRST: Final = {
    "joint": (*ARM_JOINTS, "finger_joint1", "finger_joint2", "obj_freejoint"),
    "actuator": tuple(f"actuator{i}" for i in range(1, 9)),
}
IDENTIFIER: Final = re.compile(r"[A-Za-z_]\w*", re.A)


@dataclass
class Description:
    """The content of an interface file: read from one, or what `mjcf2fmu` takes without one.

    `interface` completes it from a model; nothing in it is checked against a model before.
    """

    name: str  # model name of the FMU
    description: str = ""  # one line
    author: str = ""  # "": not told
    keyframe: str = ""  # to start at; "": qpos0
    extends: str = ""  # name of an interface that it takes over and adds to
    inputs: Rows = field(default_factory=dict)
    outputs: Rows = field(default_factory=dict)
    parameters: Rows = field(default_factory=dict)

    @property
    def sections(self) -> dict[str, Rows]:
        """The variables of each section."""
        return {section: getattr(self, section) for section in SECTIONS}

    def add(self, section: str, source: str) -> None:
        """Add a variable, named after its source; with a longer name if the first is taken."""
        if any(source == keys["source"] for keys in self.sections[section].values()):
            return
        name = variable_name(source)
        if section == "parameters" and name.endswith(("qpos", "qvel")):
            name = f"start_{name}"
        taken = [name for rows in self.sections.values() for name in rows]
        longer = re.sub(r"\W+", "_", source.strip(), flags=re.A)
        self.sections[section][unique(taken, name, longer)] = {"source": source}


def variable_name(source: str) -> str:
    """Name of a variable by its source: hand_xpos for `body hand xpos`, gyro for `sensor gyro`."""
    words = words_of(source)
    if len(words) > 1 and words[0] in OBJECTS and words[1][:1] != "#":
        words = words[1:3]
    name = re.sub(r"_#|\W+", "_", "_".join(words), flags=re.A)
    return name if IDENTIFIER.fullmatch(name) else f"_{name}"


def default_description(model: Any, name: str) -> Description:
    """Describe a model's controls, positions, velocities, forces and sensors."""
    description = Description(name, f"MuJoCo model {name}")
    for section, source, size in TABLES["default"]:
        if getattr(model, size):
            description.add(section, source)
    for i in range(model.nsensor):
        description.add("outputs", f"sensor {shlex.quote(model.sensor(i).name or f'#{i + 1}')}")
    return description


def suggestions(model: Any) -> dict[str, list[str]]:
    """Further sources for a description, by section."""
    sources = Sources(model)
    return {
        section: whole + [
            f"{kind} {shlex.quote(name)} {what}"
            for kind, properties in by_kind.items()
            for name in sources.names(kind)
            if name != "world"
            for what in properties
        ]
        for section, (whole, by_kind) in TABLES["suggested"].items()
    }  # fmt: skip


def written(description: Description, extra: Mapping[str, Iterable[str]]) -> str:
    """Format a description as TOML, with suggestions as commented lines."""
    whole = deepcopy(description)
    lines = [
        "# One line per variable; `source` names it in the model. unit, description, start, min",
        "# and max are optional; parameters with `tunable = true` may change between steps.",
        *_pairs({key: getattr(description, key) for key in HEAD if key not in SECTIONS}),
    ]
    for section, rows in whole.sections.items():
        for source in extra[section]:
            whole.add(section, source)
        lines += ["", f"[{section}]"]
        for name, keys in rows.items():
            mark = "" if name in description.sections[section] else "# "
            lines.append(f"{mark}{name} = {{ {', '.join(_pairs(keys))} }}")
    return "\n".join([*lines, ""])


def _pairs(values: Keys) -> list[str]:
    # JSON's strings, numbers and lists are valid TOML.
    return [f"{key} = {json.dumps(value)}" for key, value in values.items()]


def read_description(path: Path) -> Description:
    """Read a description; refuses a file that cannot be read or has invalid content."""
    with open_regular(path) as file:
        content = tomllib.loads(file.read().decode("utf-8-sig"))
    _check(str(path), content, HEAD)
    description = Description(**{"name": path.stem, **content})
    _check_name(f"{path}: name", description.name)
    for section, rows in description.sections.items():
        for name, keys in rows.items():
            place = f"{path}: {section}.{name}"
            _check_name(place, name)
            if not isinstance(keys, dict) or "source" not in keys:
                raise InputError(f'{place}: must be a table such as {{ source = "ctrl" }}')
            _check(place, keys, KEYS)
    if description.extends not in ("", *EXTENDED):
        refuse(f"{path}: extends", description.extends, f"must be one of {', '.join(EXTENDED)}")
    return description


def _check_name(place: str, name: str) -> None:
    if not IDENTIFIER.fullmatch(name):
        refuse(place, name, "must be of letters, digits and _")


def _check(place: str, content: Keys, valid: Mapping[str, type]) -> None:
    for key, value in content.items():
        if key not in valid:
            refuse(f"{place}: key", key, f"must be one of {', '.join(valid)}", valid)
        if not isinstance(value, valid[key]):
            raise InputError(f"{place}: {key}: must be {_WORDS[valid[key]]}")


def interface(description: Description, model: Any) -> Interface:
    """Complete a description with shapes, units, start values and bounds from the model."""
    sources = Sources(model, description.keyframe)
    base = EXTENDED.get(description.extends)
    if base is None:
        variables = _own(description, sources)
        terminals = {"robot": tuple(v.name for v in variables if v.causality != "parameter")}
    else:
        variables = _extended(base, _own(_with_poses(description, sources), sources), sources)
        terminals = {**base.terminals}
    named = tuple(_with_parts(variable, variables) for variable in variables)
    made = Interface(description.name, description.description, (*named, COUNTED), terminals,
                     is_model=True, author=description.author)  # fmt: skip
    made.check()
    return made


def _own(description: Description, sources: Sources) -> list[Variable]:
    return [
        _variable(f"{section}.{name}", name, keys, sources.find(causality, keys["source"]))
        for section, causality in SECTIONS.items()
        for name, keys in description.sections[section].items()
    ]


def _with_parts(variable: Variable, all_of_them: Sequence[Variable]) -> Variable:
    """Name a variable's parts otherwise than all variables."""
    taken = [each.name for each in all_of_them]
    parts = tuple((unique(taken, part), n, text) for part, n, text in variable.parts)
    return replace(variable, parts=parts)


def _with_poses(description: Description, sources: Sources) -> Description:
    """Add the poses of all free bodies, as outputs NAME_xpos and NAME_xquat."""
    whole = deepcopy(description)
    for body, what in product(sources.free_bodies(), ("xpos", "xquat")):
        source = f"body {shlex.quote(body)} {what}"
        if not any(variable_name(source) in rows for rows in whole.sections.values()):
            whole.add("outputs", source)
    return whole


def _extended(base: Interface, own: Sequence[Variable], sources: Sources) -> list[Variable]:
    """Take over an interface's variables but those that have a name of the user's."""
    # The whole model's qpos and qvel begin with those of the robot and the block.
    for kind, names in FIRST.items():
        for i, name in enumerate(names):
            if sources.find_id(kind, name) != i:
                raise InputError(
                    f"extends = {base.model!r}: {kind} {name!r} must be number {i + 1} of the "
                    f"model's {kind}s; put the <include> before {kind}s of your own"
                )
    own_names = {variable.name for variable in own}
    left_out = ("scene", COUNTED.source)
    taken = [v for v in base.variables if v.name not in own_names and v.source not in left_out]
    order = list(SECTIONS.values())
    return sorted([*(_grown(v, sources) for v in taken), *own],
                  key=lambda v: order.index(v.causality))  # fmt: skip


def _grown(variable: Variable, sources: Sources) -> Variable:
    """Return a variable of the base with the elements of the model's further joints."""
    if variable.source not in ("qpos", "qvel"):
        return variable
    row = sources.find("output", variable.source)
    text = f"{variable.description}; then the model's further joints"
    return replace(variable, shape=row.shape, unit=row.unit, description=text)


def _variable(place: str, name: str, keys: Keys, row: Variable) -> Variable:
    """Complete a model's variable with the keys of the interface file."""
    unit = keys.get("unit")
    if unit and unit not in OUR_UNITS:
        refuse(f"{place}: unit", unit, f"must be one of {', '.join(OUR_UNITS)}", OUR_UNITS)
    start = _numbers(place, "start", keys, row.size, row.start)
    return replace(
        row,
        name=name,
        unit=row.unit if unit is None else unit,
        variability=_variability(place, keys, row),
        description=keys.get("description", row.description),
        details=() if "description" in keys else row.details,
        parts=tuple((f"{name}_{part}", n, row.description) for part, n, _ in row.parts),
        start=None if row.causality == "output" else start,
        minimum=_numbers(place, "min", keys, row.size, row.minimum),
        maximum=_numbers(place, "max", keys, row.size, row.maximum),
        source=keys["source"],
    )


def _variability(place: str, keys: Keys, row: Variable) -> Variability:
    if not keys.get("tunable"):
        return row.variability
    if row.causality != "parameter":
        raise InputError(f"{place}: tunable: only parameters have this key")
    if row.source.split()[0] not in TUNABLE:
        raise InputError(f"{place}: tunable: {keys['source']!r} has an effect at the start only")
    return "tunable"


def _numbers(place: str, key: str, keys: Keys, size: int, default: Any) -> Any:
    """Values given either once for all elements or for each."""
    if key not in keys:
        return default
    values = keys[key] if isinstance(keys[key], list) else [keys[key]] * size
    good = tuple(float(v) for v in values if type(v) in (int, float) and math.isfinite(v))
    if not len(values) == len(good) == size:
        raise InputError(f"{place}: {key}: must be a number, or {size} of them")
    return good
