"""The journal of a session: the actions on a run, and the tick before which each was taken.

`session.jsonl` holds one JSON object per line. The first is the head: `format`, `scenario` (its
name; the scenario itself lies beside the journal in `scenario/`), `kind` and `fmus` (GUID and
SHA-256 of each); that of a page, which has an engine of its own, also `seen`: values at its end.
Each other line is an action: `tick`, `action` and its arguments:

    {"tick": 1200, "action": "set", "name": "controller.kp", "value": 6.0}
    {"tick": 1300, "action": "release", "name": "plant.push_force"}
    {"tick": 1300, "action": "set_coupling", "coupling": "jacobi"}
    {"tick": 1400, "action": "move_waypoint", "row": 4, "position": [0.5, 0.0, 0.3]}
    {"tick": 6500, "action": "end"}

An action takes effect from its tick on. Without an `end`, the session failed or was killed.

`Adjustments` takes an action before a session changes an FMU; `replay` checks a whole journal with
it before anything is run; and a session is written as a scenario from the inputs that result.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from ..fmus.atomic import writing
from ..fmus.errors import InputError, excerpt
from ..fmus.interface.parameters import ParameterValue, expand
from ..fmus.interface.variables import Scalar, Value
from ..fmus.master.step import SWITCHED
from ..fmus.sources.targets import Kind
from ..task.fields import check_choice, check_keys, field_names
from ..task.files import read_text
from ..task.table import TableRow, TrajectoryTable
from .prepare import Prepared

JOURNAL_FILE = "session.jsonl"
FORMAT = 1
_MAX_BYTES = 256 * 1024 * 1024

Parameters = Mapping[str, Mapping[str, Value]]  # by instance and scalar variable
T = TypeVar("T", bound=BaseModel)


def _plain(value: Any) -> Any:
    """Return arrays and tuples as lists, which nobody changes later and JSON can hold."""
    value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    return list(map(_plain, value)) if isinstance(value, list | tuple) else value


Plain = Annotated[Any, BeforeValidator(_plain)]


class _Act(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Set(_Act):
    """Set a tunable parameter, or hold an input at a value until it is released."""

    do: Literal["set"] = "set"
    name: str
    value: Plain


class Release(_Act):
    """Give an input that is held back to the scenario."""

    do: Literal["release"] = "release"
    name: str


class MoveWaypoint(_Act, extra="allow"):
    """Change a later row of the trajectory table, counted from 0: the fields that are given."""

    __pydantic_extra__: dict[str, Plain]
    do: Literal["move_waypoint"] = "move_waypoint"
    row: Any


class SetCoupling(_Act):
    """Change the coupling."""

    do: Literal["set_coupling"] = "set_coupling"
    coupling: Any


class End(_Act):
    """End the run, for a reason if it ends before its scenario does."""

    do: Literal["end"] = "end"
    reason: str = ""


Act = Set | Release | MoveWaypoint | SetCoupling | End


@dataclass(frozen=True)
class Action:
    """One action on a session."""

    tick: int  # completed steps before it
    act: Act


class Head(BaseModel):
    """First line of a journal: what was run."""

    format: Literal[1] = 1
    scenario: str  # its name
    kind: Kind
    fmus: dict[str, dict[str, str | None]]  # GUID and SHA-256 of each
    seen: dict[str, float] = {}  # values at its end, if a page has simulated it


def begin_journal(path: Path, head: Head) -> None:
    """Write the first line of a journal, which must not exist."""
    _write(path, "x", head.model_dump(exclude={"seen"}))


def append_action(path: Path, action: Action) -> None:
    """Append a line to a journal; it is passed to the operating system at once."""
    arguments = action.act.model_dump(exclude_defaults=True)
    _write(path, "a", {"tick": action.tick, "action": action.act.do, **arguments})


def _write(path: Path, mode: str, content: Mapping[str, object]) -> None:
    with writing(path), path.open(mode, encoding="utf-8") as file:
        file.write(json.dumps(content) + "\n")


@dataclass(frozen=True)
class Journal:
    """A journal as it was read."""

    path: Path
    head: Head
    actions: tuple[Action, ...]  # in order; the last is `end` if the session came to an end

    @classmethod
    def read(cls, place: str | Path) -> Self:
        """Read a journal."""
        path = Path(place)
        if path.is_dir():
            path = path / JOURNAL_FILE
        if not path.exists():
            raise InputError(
                f"{path}: no such file; must be the journal of a run of `live` or "
                "Session, or the run's folder"
            )
        lines = io.StringIO(read_text(path, _MAX_BYTES), newline=None)
        head = _head(f"{path}: line 1", lines.readline())
        actions: list[Action] = []
        for number, line in enumerate(lines, start=2):  # ends at the first that cannot be used
            place = f"{path}: line {number}"
            actions.append(_action(place, _parse(place, line), actions))
        return cls(path, head, tuple(actions))


def _parse(place: str, line: str) -> dict[str, object]:
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise InputError(f"{place}: {excerpt(line.rstrip())}; must be a JSON object")
    return content


def _head(place: str, line: str) -> Head:
    content = _parse(place, line)
    if content.get("format") != FORMAT:
        raise InputError(
            f"{place}: format {excerpt(content.get('format'))}; must be {FORMAT}, as the "
            f"{JOURNAL_FILE} of a session of this version"
        )
    check_choice(f"{place}: kind", content.get("kind"), get_args(Kind))
    return _checked(place, Head, content)


def _action(place: str, content: dict[str, object], before: list[Action]) -> Action:
    tick, name = content.pop("tick", None), content.pop("action", None)
    least = before[-1].tick if before else 0
    if isinstance(tick, bool) or not isinstance(tick, int) or tick < least:
        raise InputError(f"{place}: tick {excerpt(tick)}; must be a whole number from {least} on")
    if before and isinstance(before[-1].act, End):
        raise InputError(f"{place}: {excerpt(name)} after the end; must be the last line")
    kinds = {kind.model_fields["do"].default: kind for kind in get_args(Act)}
    kind = kinds[check_choice(f"{place}: action", name, kinds)]
    return Action(tick, _checked(f"{place}: {name}", kind, content))


def _checked(place: str, kind: type[T], content: object) -> T:
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{place}: {first_problem(error)}") from None


def first_problem(error: ValidationError) -> str:
    """Return the first problem of what was read, in one line."""
    first = error.errors(include_input=False, include_url=False)[0]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"


class Adjustments:
    """The inputs, parameters, waypoints and coupling of a run, as its actions change them.

    `Execution` makes one for each run, and `replay` one to check a journal before it runs. It
    knows no FMUs: `Session.act` gives them what `take` returns. A scenario that is to run otherwise
    from its start is changed before it is prepared, by `Scenario.changed`.
    """

    def __init__(self, prepared: Prepared) -> None:
        self._scenario = prepared.scenario
        self.interfaces = prepared.assembly.interfaces
        self.values = {name: dict(values) for name, values in prepared.values.items()}
        self.inputs = prepared.inputs()
        self.coupling = prepared.scenario.coupling

    @cached_property
    def tunables(self) -> dict[str, Scalar]:
        """Parameters that `set` can change, with unit, bounds and description."""
        return {
            f"{instance}.{scalar.name}": scalar
            for instance, interface in self.interfaces.items()
            for scalar in interface.scalars()
            if scalar.variable.variability == "tunable"
        }

    def copied(self) -> Adjustments:
        """Return a copy, which later actions do not change."""
        other = copy(self)
        other.values = {name: dict(values) for name, values in self.values.items()}
        other.inputs = self.inputs.copied()
        return other

    def take(self, action: Action) -> Parameters:
        """Take an action; returns the parameters that FMUs are to be given."""
        match action.act:
            case Set(name=name, value=value):
                return self._set(name, value)
            case Release(name=name):
                self.inputs.release(name)
            case MoveWaypoint(row=row, model_extra=changes):
                self._move_waypoint(action.tick, row, changes or {})
            case SetCoupling(coupling=coupling):
                self._set_coupling(coupling)
        return {}

    def _set(self, name: str, value: ParameterValue) -> Parameters:
        if name in self.inputs:
            self.inputs.hold(name, value)
            return {}
        instance, _dot, parameter = name.partition(".")
        if instance not in self.interfaces:
            names = ", ".join(self.interfaces)
            raise InputError(f"{name}: no instance {instance!r}; valid: {names}")
        values = expand(instance, self.interfaces[instance], {parameter: value})
        if any(f"{instance}.{scalar}" not in self.tunables for scalar in values):
            valid = dict.fromkeys(s.variable.name for s in self.tunables.values())
            raise InputError(
                f"{name}: is a fixed parameter, which cannot change during a run; tunable: "
                f"{', '.join(valid) or 'none'}"
            )
        self.values[instance] |= values
        return {instance: values}

    def _set_coupling(self, coupling: Any) -> None:
        if coupling not in SWITCHED:
            raise InputError(f"coupling: {excerpt(coupling)}; valid: {', '.join(SWITCHED)}")
        if self._scenario.coupling not in SWITCHED or self._scenario.steps:
            raise InputError('coupling: cannot change with [steps], or from "iterated"')
        self.coupling = coupling

    def _move_waypoint(self, tick: int, row: Any, changes: Mapping[str, Any]) -> None:
        if self.inputs.table is None:
            raise InputError("move_waypoint: the scenario is a system without a trajectory")
        rows, ahead = list(self.inputs.table.rows), self.inputs.guarded.ahead(tick)
        now = (tick + ahead) * self._scenario.step
        if isinstance(row, bool) or not isinstance(row, int) or not 0 <= row < len(rows):
            last = len(rows) - 1
            raise InputError(f"move_waypoint: row {row!r}; must be a whole number from 0 to {last}")
        try:
            check_keys("", changes, field_names(TableRow))
            changed = replace(rows[row], **changes)
            time = min(rows[row].time, changed.time)
            if time <= now:
                raise InputError(f"time {time:g} s has passed; must be after t = {now:g} s")
            rows[row] = changed
            table = TrajectoryTable(tuple(rows))
            self.inputs.use(replace(self._scenario, table=table))
        except InputError as error:
            raise InputError(f"move_waypoint: row {row}: {error}") from None
