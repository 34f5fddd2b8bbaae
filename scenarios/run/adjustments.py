"""The actions on a run: what each is checked for and changes, as far as no FMU is needed.

A session takes an action here before it changes an FMU; `replay` checks a whole journal here before
anything is run; and a session is written as a scenario from the inputs that result.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, Final

from ...fmus.errors import InputError
from ...fmus.interface.parameters import ParameterValue, expand
from ...fmus.interface.variables import Scalar, Value
from ...fmus.master.step import SWITCHED
from ...fmus.messages import did_you_mean, excerpt
from ..fields import check_keys, field_names
from ..scenario.table import TableRow, TrajectoryTable
from .journal import END, Action
from .prepare import Prepared

ACTIONS: Final = ("set", "release", "move_waypoint", "set_coupling", END)
Parameters = Mapping[str, Mapping[str, Value]]  # by instance and scalar variable


class Adjustments:
    """The inputs, parameters, waypoints and coupling of a run, as its actions change them."""

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

    def take(self, action: Action) -> Parameters:
        """Take an action; returns the parameters that FMUs are to be given."""
        if action.name not in ACTIONS:
            hint = did_you_mean(action.name, ACTIONS)
            raise InputError(f"action {excerpt(action.name)}; valid: {', '.join(ACTIONS)}{hint}")
        method = getattr(self, f"_{action.name}")
        try:
            inspect.signature(method).bind(action, **action.arguments)
        except TypeError as error:
            raise InputError(f"{action.name}: {error}; must be as `Session` writes it") from None
        parameters: Parameters | None = method(action, **action.arguments)
        return parameters or {}

    def _set(self, _: Action, /, name: str, value: ParameterValue) -> Parameters:
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

    def _release(self, _: Action, /, name: str) -> None:
        self.inputs.release(name)

    def _set_coupling(self, _: Action, /, coupling: Any) -> None:
        if coupling not in SWITCHED:
            raise InputError(f"coupling: {excerpt(coupling)}; valid: {', '.join(SWITCHED)}")
        if self._scenario.coupling not in SWITCHED or self._scenario.steps:
            raise InputError('coupling: cannot change with [steps], or from "iterated"')
        self.coupling = coupling

    def _move_waypoint(self, action: Action, /, row: int, **changes: Any) -> None:
        if self._scenario.is_system:
            raise InputError("move_waypoint: the scenario is a system without a trajectory")
        rows, ahead = list(self.inputs.table.rows), self.inputs.guarded.ahead(action.tick)
        now = (action.tick + ahead) * self._scenario.step
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

    def _end(self, _: Action, /, reason: str = "") -> None:
        if not isinstance(reason, str):
            raise InputError(f"end: reason {excerpt(reason)}; must be text")
