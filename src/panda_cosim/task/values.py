"""Values of a scenario, changed by flat keys: those of `--set`, sweeps, sessions, tests and Python.

A key is a parameter of an FMU (`plant.block_mass`, `controller.kp[3]`) or a place in the scenario:
`duration`, `table.rows[3].x`, `push[1].force[2]`, `success.max_slip`, `fmus.controller`. Indices
start at 1.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any, Final

from ..fmus.errors import InputError, did_you_mean
from ..fmus.interface.parameters import ParameterValue
from ..fmus.interface.tables import INTERFACES
from .fields import Line, check_keys, field_names
from .input_table import InputTable
from .mismatch import Mismatch, default_of
from .table import QUATERNION_COLUMNS

Scenario = Any  # that of scenario.py, which imports this module
Values = Mapping[str, ParameterValue]
# Texts and numbers of a scenario that have no key: they say what it is, not how it is.
_FIXED: Final = ("name", "purpose", "system", "expect", "expect_reason")
_SECTIONS: Final = ("table.", "push[", "success.", "mismatch.")
_BY_NAME: Final = ("inputs", "fmus", "plant", "controller")  # sections with names of variables
_OF_SCENE: Final = ("plant.scene", "plant.robot")  # parameters of our plant that a scenario states
_STEP: Final = re.compile(r"(\w+)(?:\[(\d{1,6})\])?", re.A)
_COLUMNS: Final = {  # of the table's file, whose rows have them in vectors
    **{name: ("position", i) for i, name in enumerate("xyz")},
    **{name: ("orientation", i) for i, name in enumerate(QUATERNION_COLUMNS)},
}
Steps = tuple[str | int, ...]  # to a place in a scenario: names of fields, and indices from 0


def changed(scenario: Scenario, values: Values) -> Scenario:
    """Return a scenario with some values changed; see `Scenario.changed`."""
    try:
        return _with_all(scenario, values)
    except InputError as error:
        raise InputError(_blamed(scenario, values, str(error))) from None


def _blamed(scenario: Scenario, values: Values, text: str) -> str:
    """Return an error with the key before it without which there would be none."""
    for key in values:
        with suppress(InputError):
            _with_all(scenario, {k: v for k, v in values.items() if k != key})
            own = key.rpartition(".")[2]  # which most messages begin with
            return text if text.startswith(key) else f"{key}: {text.removeprefix(f'{own}: ')}"
    return text


def _with_all(scenario: Scenario, values: Values) -> Scenario:
    """Change all values at once, so that no order of the keys is seen."""
    parts = {key[5:]: value for key, value in values.items() if key.startswith("fmus.")}
    fmus, top = {*scenario.fmus, *parts}, _top(scenario)
    ours = () if scenario.is_system else ("plant", "controller", "sensors")
    instances = None if scenario.system else tuple(dict.fromkeys((*ours, *sorted(fmus))))
    for name in parts if scenario.system else ():
        raise InputError(f"fmus.{name}: cannot be combined with system = {scenario.system!r}")
    if "gains" in values and "controller" in fmus:
        raise InputError("gains: acts only on the project's own controller; must be left out here")
    changes: dict[Steps, Any] = {
        ("fmus", name): _from_here(Line().check(f"fmus.{name}", file))
        for name, file in parts.items()
    }
    for key, value in values.items():
        if key in _OF_SCENE and "plant" in ours and "plant" not in fmus:
            changes.setdefault((key.partition(".")[2],), value)
        elif not key.startswith("fmus."):
            changes[_steps(key, top, instances)] = value
    if scenario.is_system and any(steps[0] == "table" for steps in changes):
        raise InputError("the scenario is a system, which has no trajectory.csv")
    if "inputs.file" in values:
        file = (scenario.folder or Path()) / str(values["inputs.file"])
        changes["input_table",] = InputTable.read(file)
    return _changed(scenario, changes)


def _top(scenario: Scenario) -> list[str]:
    """Return the keys of a scenario's texts, numbers and switches."""
    names = (name for name in field_names(scenario) if name not in _FIXED)
    return [name for name in names if isinstance(getattr(scenario, name), str | bool | float)]


def _from_here(text: str) -> str:
    """A part, relative to the working directory."""
    file, colon, name = text.rpartition(":")
    has_class = colon and file.endswith(".py")
    return f"{os.path.realpath(file)}:{name}" if has_class else os.path.realpath(text)


def _steps(key: str, top: Collection[str], instances: Collection[str] | None) -> Steps:
    """Return the way to a key's place; instances None: the scenario's FMUs are not known yet."""
    section, dot, name = key.partition(".")
    if dot and section in _BY_NAME[:2]:
        return section, name
    if key not in top and not key.startswith(_SECTIONS):
        if not dot or not name:
            raise _no_such(key, top)
        if instances is not None and section not in instances:
            hint = did_you_mean(section, instances)
            raise InputError(f"{key}: no instance {section!r}; valid: {', '.join(instances)}{hint}")
        return (section, name) if section in _BY_NAME else ("parameters", section, name)
    steps: list[str | int] = []
    for part in key.split("."):
        match = _STEP.fullmatch(part)
        if match is None:
            raise _no_such(key, top)
        is_column = steps[:1] == ["table"] and part in _COLUMNS
        steps += _COLUMNS[part] if is_column else [match[1]]
        steps += [int(match[2]) - 1] if match[2] else []
    return tuple(steps)


def _no_such(key: str, top: Collection[str]) -> InputError:
    bare = key.partition("[")[0]
    owners = [f"{fmu}.{key}" for fmu, interface in INTERFACES.items()
              if bare in {variable.name for variable in interface.of("parameter")}]  # fmt: skip
    valid = (*top, "mismatch.preset", "table.rows[1].x", "push[1].force[1]", "success.max_slip",
             "inputs.plant.torque", "fmus.controller", "plant.block_mass")  # fmt: skip
    hint = f"; did you mean {owners[0]!r}?" if owners else did_you_mean(key, valid)
    return InputError(f"{key}: no such key; valid: {', '.join(valid)}{hint}")


def _changed(old: Any, changes: Mapping[Steps, Any], name: str = "") -> Any:
    """Return an object, mapping or tuple with values changed at some places, wholes first."""
    old = changes.get((), old)
    parts: dict[Any, dict[Steps, Any]] = {}
    for steps, value in changes.items():
        if steps:
            parts.setdefault(steps[0], {})[steps[1:]] = value
    if not parts:
        return old
    if isinstance(old, Mapping):
        return _merged(old, {n: _changed(old.get(n, {}), c, n) for n, c in parts.items()})
    if is_dataclass(old):
        check_keys("", list(map(str, parts)), field_names(old))
        if isinstance(old, Mismatch):  # items are those of what preset and wholes result in
            old = replace(old, **{n: _whole(n, c.pop(())) for n, c in parts.items() if () in c})
        new = {n: _changed(_field(old, n), c, n) for n, c in parts.items() if c}
        return replace(old, **new)
    items = list(old) if isinstance(old, tuple | list) else []
    for index, inner in parts.items():
        if index not in range(len(items)):
            bound = f"must be 1 to {len(items)}" if items else "the scenario has none"
            number = index + 1 if isinstance(index, int) else index
            raise InputError(f"there is no {name.removesuffix('s')} {number}; {bound}")
        items[index] = _changed(items[index], inner, name)
    return tuple(items)


def _merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """Merge both; a new value of `kp` replaces the old one of `kp[3]`, too."""
    return {k: v for k, v in old.items() if k in new or k.partition("[")[0] not in new} | dict(new)


def _field(old: Any, name: str) -> Any:
    if isinstance(old, Mismatch) and name not in ("preset", "seed"):
        return old.values.get(name, default_of(name))
    return getattr(old, name)


def _whole(name: str | int, value: Any) -> Any:
    """Return the integer part of a seed, so that seeds can be drawn from an interval."""
    is_number = isinstance(value, float) and math.isfinite(value)
    return int(value) if name == "seed" and is_number else value
