"""Turns a session's actions into a scenario: moved waypoints, or a whole session."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...fmus.errors import InputError
from ...fmus.interface.plant import FORCES
from ...fmus.messages import did_you_mean
from ..fields import field_names
from ..scenario.scenario import Push, Scenario
from ..scenario.table import TableRow, TrajectoryTable
from .inputs import Inputs
from .journal import Action
from .options import Options, with_options

Array = NDArray[np.float64]
_PUSHES = tuple(f"plant.{force}" for force in FORCES.values())
_DIGITS = 9  # of a time in a scenario [s]; a tick is 1e-3


def moved(
    scenario: Scenario, table: TrajectoryTable, row: int, changes: Mapping[str, Any], now: float
) -> Scenario:
    """Return the scenario with one later row of its table changed."""
    rows = list(table.rows)
    if isinstance(row, bool) or not isinstance(row, int) or not 0 <= row < len(rows):
        raise InputError(f"move_waypoint: row {row!r}; must be a whole number from 0 to "
                         f"{len(rows) - 1}")  # fmt: skip
    valid = field_names(TableRow)
    for name in changes:
        if name not in valid:
            hint = did_you_mean(name, valid)
            raise InputError(f"move_waypoint: {name!r}; valid: {', '.join(valid)}{hint}")
    try:
        new = replace(rows[row], **changes)
        if min(rows[row].time, new.time) <= now:
            time = min(rows[row].time, new.time)
            raise InputError(f"time {time:g} s has passed; must be after t = {now:g} s")
        rows[row] = new
        return replace(scenario, table=TrajectoryTable(tuple(rows)))
    except InputError as error:
        raise InputError(f"move_waypoint: row {row}: {error}") from None


def as_scenario(
    scenario: Scenario,
    actions: Sequence[Action],
    ticks: int,
    make_inputs: Callable[[Scenario], Inputs],
) -> Scenario:
    """Write a session as a scenario that gives the same bits, with the criteria within its time.

    The scenario's external inputs are computed and compared with the session's.
    """
    if ticks == 0:
        raise InputError("session: no step has been taken; a scenario has at least one")
    for action in actions:
        _refuse_late(action, make_inputs(scenario), scenario.step)
    inputs = make_inputs(scenario)
    given = np.vstack(list(_given(scenario, inputs, actions, ticks)))
    duration = round(ticks * scenario.step, _DIGITS)
    written = replace(
        scenario,
        table=inputs.table,
        duration=duration,
        success=scenario.success.within(duration),
        push=tuple(_all_pushes(given, inputs)),
        folder=scenario.folder if scenario.has_own_parts else None,
    )
    for action in actions:
        written = _started_with(written, action, inputs)
    if written.coupling == "jacobi" and written.controller != scenario.controller:
        raise InputError(
            "session: a parameter was set before the first step, which with Jacobi coupling acts a "
            "tick later than a start value; give it as an override in the session's options"
        )
    same = make_inputs(written)[0:ticks] == given
    if not same.all():
        tick = int(np.flatnonzero(~same.all(axis=1))[0])
        raise InputError(_blame(actions, tick, scenario.step))
    return written


def _refuse_late(action: Action, inputs: Inputs, step: float) -> None:
    """Refuse changes during the run of what a scenario sets only once."""
    if action.tick == 0:
        return
    if action.name == "set" and action.arguments["name"] not in inputs:
        raise InputError(
            f"session: {action.arguments['name']} was set at t = {_time(action, step)} s; a "
            "scenario has values of parameters at its start only"
        )
    if action.name == "set_coupling":
        raise InputError(
            f"session: the coupling was changed at t = {_time(action, step)} s; a scenario has one"
        )


def _given(
    scenario: Scenario, inputs: Inputs, actions: Sequence[Action], ticks: int
) -> Iterator[Array]:
    """Yield the external inputs of a session, from one action to the next."""
    first = 0
    for action in actions:
        yield inputs[first : action.tick]
        first = action.tick
        arguments = dict(action.arguments)
        if action.name == "set" and arguments["name"] in inputs:
            inputs.hold(arguments["name"], arguments["value"])
        elif action.name == "release":
            inputs.release(arguments["name"])
        elif action.name == "move_waypoint":
            row = arguments.pop("row")
            inputs.use(moved(scenario, inputs.table, row, arguments, first * scenario.step))
    yield inputs[first:ticks]


def _all_pushes(given: Array, inputs: Inputs) -> Iterator[Push]:
    """Yield the pushes on all bodies."""
    for body, force in FORCES.items():
        if f"plant.{force}" in inputs:
            yield from _pushes(given[:, inputs.columns(f"plant.{force}")], body)


def _pushes(force: Array, body: str) -> Iterator[Push]:
    """Yield a push for each span of constant force (ticks, 3) [N]."""
    changes = np.flatnonzero(np.diff(force, axis=0).any(axis=1)) + 1
    edges = [0, *changes.tolist(), len(force)]
    for first, last in itertools.pairwise(edges):
        if force[first].any():
            start, duration = first * STEP_SIZE, (last - first) * STEP_SIZE
            yield Push(
                start=round(start, _DIGITS),
                duration=round(duration, _DIGITS),
                force=tuple(force[first].tolist()),
                on=body,
            )


def _started_with(scenario: Scenario, action: Action, inputs: Inputs) -> Scenario:
    """Return the scenario with all values set before the first step."""
    if action.tick > 0:
        return scenario
    if action.name == "set" and action.arguments["name"] not in inputs:
        instance, _, name = action.arguments["name"].partition(".")
        overrides = {instance: {name: action.arguments["value"]}}
        return with_options(scenario, Options(overrides=overrides))
    if action.name == "set_coupling":
        return replace(scenario, coupling=action.arguments["coupling"])
    return scenario


def _blame(actions: Sequence[Action], tick: int, step: float) -> str:
    """Name the action whose commands no table can give, from a tick where they differ."""
    for action in actions:
        if action.name == "set" and not action.arguments["name"].startswith(_PUSHES):
            return (
                f"session: {action.arguments['name']} was held from t = {_time(action, step)} s "
                "on; the commands of a scenario come from its table alone"
            )
    later = [a for a in actions if a.name == "move_waypoint" and a.tick > tick]
    action = later[0] if later else actions[-1]
    return (
        f"session: waypoint {action.arguments['row']} was moved at t = {_time(action, step)} s, "
        f"when the hand was on its way to it; with the changed table, the commands differ from "
        f"t = {tick * step:.3f} s on"
    )


def _time(action: Action, step: float) -> str:
    return f"{action.tick * step:.3f}"
