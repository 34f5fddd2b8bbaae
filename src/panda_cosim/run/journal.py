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
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, TypeAdapter

from ..fmus.atomic import writing
from ..fmus.errors import InputError, located
from ..fmus.interface.parameters import ParameterValue, expand
from ..fmus.interface.variables import Scalar, Value
from ..fmus.master.step import SWITCHED
from ..fmus.sources.targets import Kind
from ..task.fields import Whole, check_choice, check_keys, field_names, validated
from ..task.files import read_text
from ..task.scenario import MAX_STEPS
from ..task.table import TableRow, TrajectoryTable
from .prepare import Prepared
from .system.parts import split

JOURNAL_FILE = "session.jsonl"
_MAX_BYTES = 256 * 1024 * 1024

Parameters = Mapping[str, Mapping[str, Value]]  # by instance and scalar variable


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

    format: Literal[1]
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
            must = "must be the journal of a run of `live` or Session, or the run's folder"
            raise InputError(f"{path}: no such file; {must}")
        lines = io.StringIO(read_text(path, _MAX_BYTES), newline=None)
        with validated(f"{path}: line 1"):
            head = Head.model_validate_json(lines.readline())
        actions: list[Action] = []
        for number, line in enumerate(lines, start=2):  # ends at the first that cannot be used
            least = actions[-1].tick if actions else 0
            actions.append(_action(f"{path}: line {number}", line, least))
        return cls(path, head, tuple(actions))


def _action(place: str, line: str, least: int) -> Action:
    with validated(place):
        content = TypeAdapter(dict[str, Any]).validate_json(line)
    tick = Whole(least, MAX_STEPS).check(f"{place}: tick", content.pop("tick", None))
    kinds: dict[str, type[Act]] = {it.model_fields["do"].default: it for it in get_args(Act)}
    name = check_choice(f"{place}: action", content.pop("action", None), kinds)
    with validated(f"{place}: {name}"):
        return Action(tick, kinds[name].model_validate(content))


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
        instance, parameter = split("", name, self.interfaces)
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
        check_choice("coupling", coupling, SWITCHED)
        if self._scenario.coupling not in SWITCHED or self._scenario.steps:
            raise InputError('coupling: cannot change with [steps], or from "iterated"')
        self.coupling = coupling

    def _move_waypoint(self, tick: int, row: Any, changes: Mapping[str, Any]) -> None:
        if self.inputs.table is None:
            raise InputError("move_waypoint: the scenario is a system without a trajectory")
        rows, ahead = list(self.inputs.table.rows), self.inputs.guarded.ahead(tick)
        now = (tick + ahead) * self._scenario.step
        row = Whole(0, len(rows) - 1).check("move_waypoint: row", row)
        with located(f"move_waypoint: row {row}"):
            check_keys("", changes, field_names(TableRow))
            changed = replace(rows[row], **changes)
            time = min(rows[row].time, changed.time)
            if time <= now:
                raise InputError(f"time {time:g} s has passed; must be after t = {now:g} s")
            rows[row] = changed
            self.inputs.use(replace(self._scenario, table=TrajectoryTable(tuple(rows))))
