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
    parts = [key for key in values if key.startswith("fmus.")]
    places = _Places(scenario, {*scenario.fmus, *(key[5:] for key in parts)})
    if parts and scenario.system:
        raise InputError(f"{parts[0]}: cannot be combined with system = {scenario.system!r}")
    if "gains" in values and not places.has_our_controller:
        raise InputError("gains: acts only on the project's own controller; must be left out here")
    given: dict[str, Any] = {key: _from_here(key, values[key]) for key in parts}
    # The scene and robot of the scenario outrank those of its plant.
    keys = sorted(values, key=lambda key: key not in _OF_SCENE)
    changes: dict[Steps, Any] = {places.steps(key): given.get(key, values[key]) for key in keys}
    if not scenario.is_commanded and any(steps[0] == "table" for steps in changes):
        raise InputError("the scenario commands no hand, so that it has no trajectory.csv")
    if "inputs.file" in values:
        file = (scenario.folder or Path()) / str(values["inputs.file"])
        changes["input_table",] = InputTable.read(file)
    return _changed(scenario, changes)


def _from_here(key: str, given: object) -> str:
    """A part, relative to the working directory, or a class; a word names one of our own."""
    if isinstance(given, type):
        from ..fmus.sources.written_class import file_of  # noqa: PLC0415 - few give a class

        given = file_of(given)
    text: str = Line().check(key, given)
    if "." not in text:
        return text
    file, colon, name = text.rpartition(":")
    has_class = colon and file.endswith(".py")
    return f"{os.path.realpath(file)}:{name}" if has_class else os.path.realpath(text)


class _Places:
    """Where the keys of a scenario lead, with the names of its own FMUs."""

    def __init__(self, scenario: Scenario, fmus: Collection[str]) -> None:
        # Its texts, numbers and switches.
        names = (name for name in field_names(scenario) if name not in _FIXED)
        self._top = [n for n in names if isinstance(getattr(scenario, n), str | bool | float)]
        ours = () if scenario.is_system else ("plant", "controller", "sensors")
        self._instances = tuple(dict.fromkeys((*ours, *sorted(fmus))))
        self._is_known = not scenario.system  # else they are in its file
        self._has_our_plant = bool(ours) and "plant" not in fmus
        self.has_our_controller = "controller" not in fmus

    def steps(self, key: str) -> Steps:
        """Return the way to a key's place."""
        section, dot, name = key.partition(".")
        if dot and section in _BY_NAME[:3]:
            return section, name
        if key in _OF_SCENE and self._has_our_plant:
            return (name,)
        if key in self._top or key.startswith(_SECTIONS):
            return self._inner(key)
        if not name:
            raise self._no_such(key)
        self._check_instance(key, section)
        return (section, name) if section in _BY_NAME else ("parameters", section, name)

    def _check_instance(self, key: str, section: str) -> None:
        if self._is_known and section not in self._instances:
            valid = f"{', '.join(self._instances)}{did_you_mean(section, self._instances)}"
            raise InputError(f"{key}: no instance {section!r}; valid: {valid}")

    def _inner(self, key: str) -> Steps:
        """Return the way into a section, a list or the table."""
        if not _WAY.fullmatch(key):
            raise self._no_such(key)
        parts = key.split(".")
        if parts[0] == "table":
            parts = [_COLUMNS.get(part, part) for part in parts]
        return tuple(name or int(index) - 1 for index, name in _STEP.findall(".".join(parts)))

    def _no_such(self, key: str) -> InputError:
        bare = key.partition("[")[0]
        owners = [f"{fmu}.{key}" for fmu, interface in INTERFACES.items()
                  if any(v.name == bare for v in interface.of("parameter"))]  # fmt: skip
        valid = (*self._top, "mismatch.preset", "table.rows[1].x", "push[1].force[1]",
                 "success.max_slip", "inputs.plant.torque", "fmus.controller",
                 "plant.block_mass")  # fmt: skip
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
    return (_of_class if is_dataclass(old) else _of_list)(old, parts, name)


def _of_class(old: Any, parts: Mapping[str, dict[Steps, Any]], _: str) -> Any:
    """Return a dataclass with some fields changed."""
    check_keys("", list(map(str, parts)), field_names(old))
    if isinstance(old, Mismatch):  # items are those of what preset and wholes result in
        old = replace(old, **{n: _whole(n, c.pop(())) for n, c in parts.items() if () in c})
    new = {n: _changed(_field(old, n), c, n) for n, c in parts.items() if c}
    return replace(old, **new)


def _of_list(old: Any, parts: Mapping[int, dict[Steps, Any]], name: str) -> tuple[Any, ...]:
    """Return a list with some items changed, by index from 0."""
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
