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
from pathlib import Path
from typing import Any, Final

from ...plant.parameters import ARM_JOINTS
from ..build.description import BASE_UNITS
from ..errors import InputError, did_you_mean, one_line
from ..interface.plant import PLANT
from ..interface.variables import Causality, Interface, Variable, output
from ..reading import open_regular
from .mjcf_sources import OBJECTS, TUNABLE, Sources, words_of

SECTIONS: Final[Mapping[str, Causality]] = {
    "inputs": "input",
    "outputs": "output",
    "parameters": "parameter",
}
# Keys of a file and of a variable, with their types.
HEAD: Final = {"name": str, "description": str, "keyframe": str, "extends": str,
               **dict.fromkeys(SECTIONS, dict)}  # fmt: skip
KEYS: Final = {"source": str, "unit": str, "description": str, "start": object, "min": object,
               "max": object, "tunable": bool}  # fmt: skip
_WORDS: Final = {str: "a text", bool: "true or false", dict: "a table"}
Variables = dict[str, dict[str, dict[str, Any]]]
# Interfaces that a model with the same objects can take over, by name.
EXTENDED: Final = {PLANT.model: PLANT}
# Objects of PandaPlant whose values its vectors begin with, by kind.
FIRST: Final = {
    "joint": (*ARM_JOINTS, "finger_joint1", "finger_joint2", "obj_freejoint"),
    "actuator": tuple(f"actuator{i}" for i in range(1, 9)),
}
_MAX_BYTES: Final = 4 * 1024 * 1024
IDENTIFIER: Final = re.compile(r"[A-Za-z_]\w*", re.A)


@dataclass
class Description:
    """The content of an interface file."""

    name: str  # model name of the FMU
    text: str = ""  # description, one line
    keyframe: str = ""  # to start at; "": qpos0
    # Keys of each variable, `source` at least, by section and name.
    variables: Variables = field(default_factory=lambda: {section: {} for section in SECTIONS})
    extends: str = ""  # name of an interface that it takes over and adds to

    def add(self, section: str, source: str) -> None:
        """Add a variable, named after its source; a longer name if the first is taken."""
        name = variable_name(source)
        if section == "parameters" and name.endswith(("qpos", "qvel")):
            name = f"start_{name}"
        if any(name in variables for variables in self.variables.values()):
            name = re.sub(r"\W+", "_", source.strip(), flags=re.A)
        self.variables[section][name] = {"source": source}


def variable_name(source: str) -> str:
    """Name of a variable by its source: hand_xpos for `body hand xpos`, gyro for `sensor gyro`."""
    words = words_of(source)
    if len(words) > 1 and words[0] in OBJECTS:
        words = words[1:3]
    name = re.sub(r"\W+", "_", "_".join(words), flags=re.A)
    return name if IDENTIFIER.fullmatch(name) else f"_{name}"


def default_description(model: Any, name: str) -> Description:
    """Describe a model's controls, positions, velocities, forces and sensors."""
    description = Description(name, f"MuJoCo model {name}")
    fields = [("inputs", "ctrl", model.nu), ("outputs", "qpos", model.nq),
              ("outputs", "qvel", model.nv), ("outputs", "act", model.na),
              ("outputs", "qfrc_bias", model.nv), ("outputs", "actuator_force", model.nu),
              ("parameters", "gravity", 3), ("parameters", "keyframe", model.nkey)]  # fmt: skip
    for section, source, size in fields:
        if size:
            description.add(section, source)
    for sensor in Sources(model).names("sensor"):
        description.add("outputs", f"sensor {shlex.quote(sensor)}")
    return description


def suggestions(model: Any) -> dict[str, list[str]]:
    """Further sources for a description, by section."""
    sources = Sources(model)
    names = {kind: [shlex.quote(n) for n in sources.names(kind)] for kind in ("body", "site")}
    bodies = [name for name in names["body"] if name != "world"]
    return {
        "inputs": [f"body {b} force" for b in bodies],
        "outputs": [
            *(f"body {b} {what}" for b in bodies for what in ("xpos", "xquat", "jacobian")),
            *(f"site {s} {what}" for s in names["site"] for what in ("xpos", "xmat")),
        ],
        "parameters": ["qpos", "qvel", *(f"body {b} mass" for b in bodies)],
    }


def written(description: Description, extra: Mapping[str, Iterable[str]]) -> str:
    """Format a description as TOML, with suggestions as commented lines."""
    whole = deepcopy(description)
    for section in SECTIONS:
        present = [keys["source"] for keys in whole.variables[section].values()]
        for source in extra[section]:
            if source not in present:
                whole.add(section, source)
    lines = [
        "# One line per variable; `source` names it in the model. unit, description, start, min",
        "# and max are optional; parameters with `tunable = true` may change between steps.",
        f"name = {json.dumps(description.name)}",
        f"description = {json.dumps(description.text)}",
        f"keyframe = {json.dumps(description.keyframe)}  # empty: start at qpos0",
    ]
    for section in SECTIONS:
        lines += ["", f"[{section}]"]
        for name, keys in whole.variables[section].items():
            mark = "" if name in description.variables[section] else "# "
            # JSON's strings, numbers and lists are valid TOML.
            pairs = ", ".join(f"{key} = {json.dumps(value)}" for key, value in keys.items())
            lines.append(f"{mark}{name} = {{ {pairs} }}")
    return "\n".join(lines) + "\n"


def read_description(path: Path) -> Description:
    """Read a description; refuses a file that cannot be read or has invalid content."""
    try:
        with open_regular(path) as file:
            raw = file.read(_MAX_BYTES)
        content = tomllib.loads(raw.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from error
    _check(str(path), content, HEAD)
    variables: Variables = {section: content.get(section, {}) for section in SECTIONS}
    for section, rows in variables.items():
        for name, keys in rows.items():
            place = f"{path}: {section}.{name}"
            if not IDENTIFIER.fullmatch(name):
                raise InputError(f"{place}: a name must be of letters, digits and _")
            if not isinstance(keys, dict) or "source" not in keys:
                raise InputError(f'{place}: must be a table such as {{ source = "ctrl" }}')
            _check(place, keys, KEYS)
    extends = content.get("extends", "")
    if extends not in ("", *EXTENDED):
        raise InputError(f"{path}: extends: value {extends!r}; valid: {', '.join(EXTENDED)}")
    return Description(
        content.get("name", path.stem),
        content.get("description", ""),
        content.get("keyframe", ""),
        variables,
        extends,
    )


def _check(place: str, content: Mapping[str, Any], valid: Mapping[str, type]) -> None:
    for key, value in content.items():
        if key not in valid:
            raise InputError(
                f"{place}: no key {key!r}; valid: {', '.join(valid)}{did_you_mean(key, valid)}"
            )
        if not isinstance(value, valid[key]):
            raise InputError(f"{place}: {key}: must be {_WORDS[valid[key]]}")


def interface(description: Description, model: Any) -> Interface:
    """Complete a description with shapes, units, start values and bounds from the model."""
    if not IDENTIFIER.fullmatch(description.name):
        raise InputError(f"name {description.name!r}: must be of letters, digits and _")
    sources = Sources(model, description.keyframe)
    variables: list[Variable] = []
    for section, causality in SECTIONS.items():
        for name, keys in description.variables[section].items():
            row = sources.find(causality, keys["source"])
            variables.append(_variable(f"{section}.{name}", name, keys, row))
    names = [variable.name for variable in variables]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name}: two variables have this name")
    terminals = {"robot": tuple(v.name for v in variables if v.causality != "parameter")}
    if description.extends:
        base = EXTENDED[description.extends]
        variables, terminals = _extended(base, variables, sources), {**base.terminals}
    rows = tuple(variables)
    return Interface(description.name, description.text, rows, terminals, is_model=True)


def _extended(base: Interface, own: Sequence[Variable], sources: Sources) -> list[Variable]:
    """Take over an interface's variables but the user's, and the pose of each free body."""
    # The whole model's qpos and qvel begin with those of the robot and the block.
    for kind, names in FIRST.items():
        for i, name in enumerate(names):
            if sources.find_id(kind, name) != i:
                raise InputError(
                    f"extends = {base.model!r}: {kind} {name!r} must be number {i + 1} of the "
                    f"model's {kind}s; put the <include> before {kind}s of your own"
                )
    own_names = {variable.name for variable in own}
    poses = [v for v in _poses(sources) if v.name not in own_names]
    taken = []
    for variable in base.variables:
        whole = variable
        if variable.source in ("qpos", "qvel"):
            row = sources.find("output", variable.source)
            text = f"{variable.description}; then the model's further joints"
            whole = replace(variable, shape=row.shape, unit=row.unit, description=text)
        if variable.name not in own_names and variable.source != "scene":
            taken.append(whole)
    return sorted([*taken, *own, *poses], key=lambda v: list(SECTIONS.values()).index(v.causality))


def _poses(sources: Sources) -> list[Variable]:
    """Poses of all free bodies, as outputs NAME_xpos and NAME_xquat."""
    poses = []
    for body in sources.free_bodies():
        source = f"body {shlex.quote(body)}"
        name = variable_name(source)
        poses += [
            output(f"{name}_xpos", (3,), "m", f"Origin of the body {body}, world frame",
                   source=f"{source} xpos"),
            output(f"{name}_xquat", (4,), "1", f"Orientation of the body {body}, world frame, "
                   "(w, x, y, z)", source=f"{source} xquat"),
        ]  # fmt: skip
    return poses


def _variable(place: str, name: str, keys: Mapping[str, Any], row: Variable) -> Variable:
    """Complete a model's variable with the keys of the interface file."""
    unit = keys.get("unit")
    if unit and unit not in BASE_UNITS:
        near = did_you_mean(unit, BASE_UNITS)
        raise InputError(f"{place}: unit {unit!r}: valid: {', '.join(BASE_UNITS)}{near}")
    if keys.get("tunable") and row.causality != "parameter":
        raise InputError(f"{place}: tunable: only parameters have this key")
    if keys.get("tunable") and row.source.split()[0] not in TUNABLE:
        raise InputError(f"{place}: tunable: {keys['source']!r} has an effect at the start only")
    start = _numbers(place, "start", keys, row.size, row.start)
    variable = replace(
        row,
        name=name,
        unit=row.unit if unit is None else unit,
        variability="tunable" if keys.get("tunable") else row.variability,
        description=keys.get("description", row.description),
        details=() if "description" in keys else row.details,
        start=None if row.causality == "output" else start,
        minimum=_numbers(place, "min", keys, row.size, row.minimum),
        maximum=_numbers(place, "max", keys, row.size, row.maximum),
        source=keys["source"],
    )
    for scalar in variable.scalars(0):
        if scalar.start is not None:
            scalar.checked(f"{place}: start", scalar.start)
    return variable


def _numbers(place: str, key: str, keys: Mapping[str, Any], size: int, default: Any) -> Any:
    """Values given either once for all elements or for each."""
    if key not in keys:
        return default
    values = keys[key] if isinstance(keys[key], list) else [keys[key]] * size
    good = [v for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
    if len(values) != size or len(good) != size or not all(map(math.isfinite, good)):
        raise InputError(f"{place}: {key}: must be a number, or {size} of them")
    return tuple(map(float, good))
