"""Changes values of a scenario by key, for `--set` and sweeps.

Besides the FMUs' parameters (`plant.block_mass`, `controller.kp[3]`), a key is one of the scenario:
`duration`, `table.rows[3].x`, `push[1].force[2]`, `success.max_slip`. Indices start at 1.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

from ...fmus.errors import InputError
from ...fmus.interface.parameters import ParameterValue, literal
from ...fmus.messages import did_you_mean
from ..fields import field_names
from ..scenario.mismatch import Mismatch, default_of
from ..scenario.scenario import DURATION, TABLE_FILE, Push, Scenario
from ..scenario.success import Success
from ..scenario.table import OPTIONAL_COLUMNS, QUATERNION_COLUMNS, TableRow, TrajectoryTable
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
_ROW: Final = re.compile(r"table\.rows\[(\d{1,6})\]\.(\w+)", re.A)
_PUSH: Final = re.compile(r"push\[(\d{1,6})\]\.(start|duration|force\[[123]\]|on)", re.A)
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
            found[key] = literal(value, f"--set {text!r}: ")
        else:
            others.append(text)
    return found, others


def with_values(scenario: Scenario, values: Mapping[str, ParameterValue]) -> Scenario:
    """Return a scenario with some values changed."""
    try:
        return _with_all(scenario, values)
    except InputError as error:
        raise InputError(_blamed(scenario, values, str(error))) from None


def _blamed(scenario: Scenario, values: Mapping[str, ParameterValue], told: str) -> str:
    """Return an error with the key before it without which there would be none."""
    for key in values:
        with suppress(InputError):
            _with_all(scenario, {k: v for k, v in values.items() if k != key})
            own = key.rpartition(".")[2]  # which most messages begin with
            return told if told.startswith(key) else f"{key}: {told.removeprefix(f'{own}: ')}"
    return told


def _with_all(scenario: Scenario, values: Mapping[str, ParameterValue]) -> Scenario:
    """Change each part of the scenario once, so that no order of the keys is seen."""
    parts: dict[str, dict[str, Any]] = {}
    for key, value in values.items():
        part, name = _part_of(key)
        parts.setdefault(part, {})[name] = value
    changes = parts.pop("", {})
    if "duration" in changes and not scenario.is_system:
        DURATION.check("duration", changes["duration"])
    for part, change in {"table": _with_rows, "push": _with_pushes, "mismatch": _with_mismatch,
                         "success": _with_success}.items():  # fmt: skip
        if part in parts:
            changes[part] = change(scenario, parts.pop(part))
    changed = replace(scenario, **changes)
    return with_options(changed, Options(parts)) if parts else changed


def _part_of(key: str) -> tuple[str, str]:
    """Return what a key belongs to ("" for the scenario itself, or an FMU), and its name there."""
    if key in TOP:
        return "", key
    if found := _ROW.fullmatch(key) or _PUSH.fullmatch(key):
        return key.partition("." if key.startswith("table") else "[")[0], found[0]
    part, dot, name = key.partition(".")
    is_success = part == "success" and name in field_names(Success)
    if dot and (part == "mismatch" or is_success or not is_setting(key)):
        return part, name
    valid = (
        *TOP,
        "mismatch.preset",
        "table.rows[1].x",
        "push[1].force[1]",
        "success.max_slip",
        "plant.block_mass",
    )
    raise InputError(f"no such key; valid: {', '.join(valid)}{did_you_mean(key, valid)}")


def _with_success(scenario: Scenario, values: Mapping[str, Any]) -> Success:
    return replace(scenario.success, **values)


def _with_mismatch(scenario: Scenario, values: Mapping[str, Any]) -> Mismatch:
    """Return the mismatch with keys changed, then single elements of what results."""
    valid = field_names(Mismatch)
    for name in values:
        key = name.partition("[")[0]
        if key not in valid:
            raise InputError(f"no key {key!r}; valid: {', '.join(valid)}{did_you_mean(key, valid)}")
    whole = {n: _whole(v) if n == "seed" else v for n, v in values.items() if "[" not in n}
    mismatch = replace(scenario.mismatch, **whole)
    changed: dict[str, Any] = {}
    for name in sorted(values.keys() - whole.keys()):
        key, _, index = name.partition("[")
        found = mismatch.values.get(key, None if key in ("preset", "seed") else default_of(key))
        now = changed.get(key, found if isinstance(found, tuple) else ())
        number = int(index[:-1]) if re.fullmatch(r"\d{1,3}\]", index, re.A) else 0
        if not 1 <= number <= len(now):
            raise InputError(f"no element {name!r}; {key} has {len(now) or 'no'} elements")
        changed[key] = _with_item(now, number - 1, values[name])
    return replace(mismatch, **changed)


def _whole(value: Any) -> Any:
    """Return the integer part of a seed, so that seeds can be drawn from an interval."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return int(value) if is_number and math.isfinite(value) else value


def _with_rows(scenario: Scenario, values: Mapping[str, Any]) -> TrajectoryTable:
    """Return the table with values changed, all of a row at once."""
    if scenario.is_system:
        raise InputError(f"the scenario is a system, which has no {TABLE_FILE}")
    rows = list(scenario.table.rows)
    changes: dict[int, dict[str, Any]] = {}
    for key, value in values.items():
        number, column = _ROW.fullmatch(key).groups()  # type: ignore[union-attr]
        _check_number(int(number), len(rows), "row")
        if column not in _ROW_COLUMNS:
            hint = did_you_mean(column, _ROW_COLUMNS)
            raise InputError(f"no column {column!r}; valid: {', '.join(_ROW_COLUMNS)}{hint}")
        changes.setdefault(int(number), {})[column] = value
    for number, columns in changes.items():
        rows[number - 1] = _changed_row(rows[number - 1], columns)
    return replace(scenario.table, rows=tuple(rows))


def _changed_row(row: TableRow, columns: Mapping[str, Any]) -> TableRow:
    changes: dict[str, Any] = {}
    for column, value in columns.items():
        if column in ("time", "grip", *OPTIONAL_COLUMNS):
            changes[column] = value
        elif column in "xyz":
            items = changes.get("position", row.position)
            changes["position"] = _with_item(items, "xyz".index(column), value)
        elif row.orientation is None:
            raise InputError(
                "the row has no orientation; only one that the table gives can be changed"
            )
        else:
            items, at = (
                changes.get("orientation", row.orientation),
                QUATERNION_COLUMNS.index(column),
            )
            changes["orientation"] = _with_item(items, at, value)
    return replace(row, **changes)


def _with_pushes(scenario: Scenario, values: Mapping[str, Any]) -> tuple[Push, ...]:
    pushes = list(scenario.push)
    changes: dict[int, dict[str, Any]] = {}
    for key, value in values.items():
        number, name = int(_PUSH.fullmatch(key)[1]), key.partition(".")[2]  # type: ignore[index]
        _check_number(number, len(pushes), "push")
        change = changes.setdefault(number - 1, {})
        if name.startswith("force"):
            force = change.get("force", pushes[number - 1].force)
            change["force"] = _with_item(force, int(name[6]) - 1, value)
        else:
            change[name] = value
    for index, change in changes.items():
        pushes[index] = replace(pushes[index], **change)
    return tuple(pushes)


def _check_number(number: int, count: int, what: str) -> None:
    if not 1 <= number <= count:
        bound = f"must be 1 to {count}" if count else "the scenario has none"
        raise InputError(f"there is no {what} {number}; {bound}")


def _with_item(items: tuple[Any, ...], index: int, value: Any) -> Any:
    return (*items[:index], value, *items[index + 1 :])
