"""Changes values of a scenario by key, for `--set` and sweeps.

Besides the FMUs' parameters (`plant.block_mass`, `controller.kp[3]`), a key is one of the scenario:
`duration`, `table.rows[3].x`, `push[1].force[2]`, `success.max_slip`. Indices start at 1.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from ...fmus.errors import InputError
from ...fmus.interface.parameters import ParameterValue, literal
from ...fmus.messages import did_you_mean
from ..definition.mismatch import Mismatch, default_of
from ..definition.scenario import DURATION, SYSTEM_DURATION, TABLE_FILE, Push, Scenario
from ..definition.success import Success
from ..definition.table import OPTIONAL_COLUMNS, QUATERNION_COLUMNS, TableRow
from ..fields import field_names
from .options import Options, with_options

TOP: Final = (
    "duration",
    "scene",
    "gains",
    "coupling",
    "interpolation",
    "timing",
    "timing_share",
    "align",
)
_ROW: Final = re.compile(r"table\.rows\[(\d+)\]\.(\w+)")
_PUSH: Final = re.compile(r"push\[(\d+)\]\.(start|duration|force\[[123]\]|on)")
_ROW_COLUMNS: Final = ("time", "x", "y", "z", *QUATERNION_COLUMNS, "grip", *OPTIONAL_COLUMNS)


def is_setting(key: str) -> bool:
    """Return whether a key belongs to the scenario, not to an FMU."""
    return key in TOP or key.startswith(("table.", "push[", "success.", "mismatch."))


def split_settings(assignments: Sequence[str]) -> tuple[dict[str, ParameterValue], list[str]]:
    """Split the texts of `--set` into the scenario's settings and those of the FMUs."""
    found: dict[str, ParameterValue] = {}
    others = []
    for text in assignments:
        key, equals, value = (part.strip() for part in text.partition("="))
        if equals and value and is_setting(key):
            found[key] = literal(value)
        else:
            others.append(text)
    return found, others


def with_values(scenario: Scenario, values: Mapping[str, ParameterValue]) -> Scenario:
    """Return a scenario with some values changed.

    Args:
        scenario: The scenario.
        values: By key.

    Raises:
        InputError: A key is unknown, or a value out of its bounds; the message names the key.
    """
    overrides: dict[str, dict[str, ParameterValue]] = {}
    for key, value in values.items():
        instance, dot, name = key.partition(".")
        if dot and not is_setting(key):
            overrides.setdefault(instance, {})[name] = value
        else:
            scenario = _changed(scenario, key, value)
    return with_options(scenario, Options(overrides)) if overrides else scenario


def _changed(scenario: Scenario, key: str, value: Any) -> Scenario:
    try:
        if key in TOP:
            return replace(
                scenario, **{key: _ticks(value, scenario) if key == "duration" else value}
            )
        if found := _ROW.fullmatch(key):
            return _with_row(scenario, int(found[1]), found[2], value)
        if found := _PUSH.fullmatch(key):
            return _with_push(scenario, int(found[1]), found[2], value)
        section, _, name = key.partition(".")
        if section == "mismatch":
            return replace(scenario, mismatch=_with_mismatch(scenario.mismatch, name, value))
        if section == "success" and name in field_names(Success):
            return replace(scenario, success=replace(scenario.success, **{name: value}))
    except InputError as error:
        own = key.rpartition(".")[2]  # which most messages begin with
        raise InputError(f"{key}: {str(error).removeprefix(f'{own}: ')}") from None
    valid = (
        *TOP,
        "mismatch.preset",
        "table.rows[1].x",
        "push[1].force[1]",
        "success.max_slip",
        "plant.block_mass",
    )
    raise InputError(f"{key}: no such key; valid: {', '.join(valid)}{did_you_mean(key, valid)}")


def _with_mismatch(mismatch: Mismatch, name: str, value: Any) -> Mismatch:
    """Return a mismatch with a key, or one element of it, changed."""
    key, bracket, index = name.partition("[")
    if key not in field_names(Mismatch):
        valid = field_names(Mismatch)
        raise InputError(f"no key {key!r}; valid: {', '.join(valid)}{did_you_mean(key, valid)}")
    if bracket:
        found = mismatch.values.get(key, None if key in ("preset", "seed") else default_of(key))
        now = found if isinstance(found, tuple) else ()
        count = len(now)
        number = int(index[:-1]) if re.fullmatch(r"\d{1,3}\]", index) else 0
        if not 1 <= number <= count:
            raise InputError(f"no element {name!r}; {key} has {count or 'no'} elements")
        value = _with_item(now, number - 1, value)
    return replace(mismatch, **{key: _whole(value) if key == "seed" else value})


def _whole(value: Any) -> Any:
    """Return the integer part of a seed, so that seeds can be drawn from an interval."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return int(value) if is_number and math.isfinite(value) else value


def _ticks(value: Any, scenario: Scenario) -> Any:
    """Round a duration to a whole number of steps."""
    bounds = SYSTEM_DURATION if scenario.is_system else DURATION
    seconds = bounds.check("duration", value)
    return round(round(seconds / scenario.step) * scenario.step, 9)


def _with_row(scenario: Scenario, number: int, column: str, value: Any) -> Scenario:
    if scenario.is_system:
        raise InputError(f"the scenario is a system, which has no {TABLE_FILE}")
    rows = list(scenario.table.rows)
    _check_number(number, len(rows), "row")
    if column not in _ROW_COLUMNS:
        hint = did_you_mean(column, _ROW_COLUMNS)
        raise InputError(f"no column {column!r}; valid: {', '.join(_ROW_COLUMNS)}{hint}")
    rows[number - 1] = _changed_row(rows[number - 1], column, value)
    return replace(scenario, table=replace(scenario.table, rows=tuple(rows)))


def _changed_row(row: TableRow, column: str, value: Any) -> TableRow:
    if column in ("time", "grip", *OPTIONAL_COLUMNS):
        return replace(row, **{column: value})
    if column in "xyz":
        return replace(row, position=_with_item(row.position, "xyz".index(column), value))
    if row.orientation is None:
        raise InputError("the row has no orientation; only one that the table gives can be changed")
    at = QUATERNION_COLUMNS.index(column)
    return replace(row, orientation=_with_item(row.orientation, at, value))


def _with_push(scenario: Scenario, number: int, name: str, value: Any) -> Scenario:
    pushes = list(scenario.push)
    _check_number(number, len(pushes), "push")
    push: Push = pushes[number - 1]
    if name.startswith("force"):
        pushes[number - 1] = replace(push, force=_with_item(push.force, int(name[6]) - 1, value))
    else:
        pushes[number - 1] = replace(push, **{name: value})
    return replace(scenario, push=tuple(pushes))


def _check_number(number: int, count: int, what: str) -> None:
    if not 1 <= number <= count:
        bound = f"must be 1 to {count}" if count else "the scenario has none"
        raise InputError(f"there is no {what} {number}; {bound}")


def _with_item(items: tuple[Any, ...], index: int, value: Any) -> Any:
    return (*items[:index], value, *items[index + 1 :])


__all__ = ["TOP", "is_setting", "split_settings", "with_values"]
