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
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, Final

from ..fmus.errors import InputError, did_you_mean, valid_names
from ..fmus.interface.parameters import ParameterValue
from ..fmus.interface.tables import INTERFACES
from .fields import Line, field_names
from .input_table import InputTable
from .mismatch import Mismatch
from .table import QUATERNION_COLUMNS

Scenario = Any  # that of scenario.py, which imports this module
Values = Mapping[str, ParameterValue | type]
# Texts and numbers of a scenario that have no key: they say what it is, not how it is.
_FIXED: Final = ("name", "purpose", "system", "expect", "expect_reason")
_SECTIONS: Final = ("table.", "push[", "success.", "mismatch.")
_BY_NAME: Final = ("inputs", "fmus", "steps", "plant", "controller")  # sections with names
_OF_SCENE: Final = ("plant.scene", "plant.robot")  # parameters of our plant that a scenario states
_WAY: Final = re.compile(r"\w+(\[\d{1,6}\])?(\.\w+(\[\d{1,6}\])?)*", re.A)
_STEP: Final = re.compile(r"\[(\d+)\]|(\w+)", re.A)
# Columns of the table's file, whose rows have them in vectors.
_COLUMNS: Final = {n: f"position[{i}]" for i, n in enumerate("xyz", 1)} | {
    n: f"orientation[{i}]" for i, n in enumerate(QUATERNION_COLUMNS, 1)
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
    fmus = {*scenario.fmus, *(key[5:] for key in values if key.startswith("fmus."))}
    if "gains" in values and "controller" in fmus:
        raise InputError("gains: acts only on the project's own controller; must be left out here")
    # The scene and robot of the scenario outrank those of its plant.
    keys = sorted(values, key=lambda key: key not in _OF_SCENE)
    changes = {_steps(scenario, fmus, key): _given(key, values[key]) for key in keys}
    if "inputs.file" in values:
        file = (scenario.folder or Path()) / str(values["inputs.file"])
        changes["input_table",] = InputTable.read(file)
    opened = _opened(scenario)
    # Wholes come before their items, and `kp` before `kp[3]`.
    for steps in sorted(changes, key=lambda steps: (len(steps), [*map(str, steps)])):
        if steps[0] == "mismatch" and steps[2:]:  # an item of what preset and wholes result in
            drawn = Mismatch(**_opened(opened["mismatch"]))
            opened["mismatch"] = _opened(drawn) | {steps[1]: drawn.items(str(steps[1]))}
        _put(opened, steps, changes[steps])
    return type(scenario)(**opened)


def _given(key: str, value: Any) -> Any:
    """Return a value as a scenario has it; seeds may be drawn from an interval."""
    if key.startswith("fmus."):
        return _from_here(key, value)
    is_seed = key == "mismatch.seed" and isinstance(value, float) and math.isfinite(value)
    return int(value) if is_seed else value


def _from_here(key: str, given: object) -> str:
    """A part, relative to the working directory, or a class; a word names one of our own."""
    if isinstance(given, type):
        from ..fmus.sources.written_class import file_of  # noqa: PLC0415 - few give a class

        given = file_of(given)
    text: str = Line().check(key, given)
    return os.path.realpath(text) if "." in text else text


def _steps(scenario: Scenario, fmus: Collection[str], key: str) -> Steps:
    """Return the way to a key's place; `fmus` are names of the scenario's own."""
    section, _, name = key.partition(".")
    if name and section in _BY_NAME[:3]:
        return section, name
    if key in _OF_SCENE and not scenario.is_system and "plant" not in fmus:
        return (name,)
    if key in _top(scenario) or key.startswith(_SECTIONS):
        return _inner(scenario, key)
    if not name:
        raise _no_such(scenario, key)
    ours = () if scenario.is_system else ("plant", "controller", "sensors")
    instances = dict.fromkeys((*ours, *sorted(fmus)))
    if section not in instances and not scenario.system:  # else they are in its file
        raise InputError(f"{key}: no instance {section!r}; {valid_names(section, instances)}")
    return (section, name) if section in _BY_NAME else ("parameters", section, name)


def _top(scenario: Scenario) -> list[str]:
    """Return its texts, numbers and switches."""
    names = (name for name in field_names(scenario) if name not in _FIXED)
    return [name for name in names if isinstance(getattr(scenario, name), str | bool | float)]


def _inner(scenario: Scenario, key: str) -> Steps:
    """Return the way into a section, a list or the table."""
    if not _WAY.fullmatch(key):
        raise _no_such(scenario, key)
    parts = key.split(".")
    if parts[0] == "table":
        parts = [_COLUMNS.get(part, part) for part in parts]
    return tuple(name or int(index) - 1 for index, name in _STEP.findall(".".join(parts)))


def _no_such(scenario: Scenario, key: str) -> InputError:
    bare = key.partition("[")[0]
    owners = [f"{fmu}.{key}" for fmu, interface in INTERFACES.items()
              if any(v.name == bare for v in interface.of("parameter"))]  # fmt: skip
    valid = (*_top(scenario), "mismatch.preset", "table.rows[1].x", "push[1].force[1]",
             "success.max_slip", "inputs.plant.torque", "fmus.controller",
             "plant.block_mass")  # fmt: skip
    hint = f"; did you mean {owners[0]!r}?" if owners else did_you_mean(key, valid)
    return InputError(f"{key}: no such key; valid: {', '.join(valid)}{hint}")


def _put(opened: Any, steps: Steps, value: Any, name: str = "") -> None:
    """Put a value at a place in an opened object, which the classes check when they are made."""
    step, *inner = steps
    if isinstance(opened, dict):
        for item in [each for each in opened if str(each).startswith(f"{step}[")]:
            del opened[item]  # a new value of `kp` replaces the old one of `kp[3]`, too
        opened.setdefault(step, {})
    elif step not in range(len(opened)):
        bound = f"must be 1 to {len(opened)}" if opened else "the scenario has none"
        number = step + 1 if isinstance(step, int) else step
        raise InputError(f"there is no {name.removesuffix('s')} {number}; {bound}")
    if inner:
        part = _opened(opened[step])
        _put(part, tuple(inner), value, str(step))
        value = part
    opened[step] = value


def _opened(value: Any) -> Any:
    """Return the fields of an object, or a copy of a mapping or list, to put values in."""
    if is_dataclass(value):
        return {name: getattr(value, name) for name in field_names(value)}
    if isinstance(value, Mapping):
        return dict(value)
    return list(value) if isinstance(value, list | tuple) else []
