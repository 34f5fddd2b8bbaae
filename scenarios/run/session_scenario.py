"""Writes a session as a scenario that gives the same bits."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...fmus.errors import InputError
from ...fmus.interface.plant import FORCES
from ..scenario.scenario import Push, Scenario
from .adjustments import Adjustments
from .journal import Action
from .options import Options, with_options
from .prepare import Inputs, Prepared

Array = NDArray[np.float64]
_DIGITS: Final = 9  # of a time in a scenario [s]; a tick is 1e-3


def as_scenario(prepared: Prepared, actions: Sequence[Action], ticks: int) -> Scenario:
    """Write a session as a scenario, with the criteria within its time.

    The scenario's external inputs are computed and compared with the session's.
    """
    if ticks == 0:
        raise InputError("session: no step yet; a scenario needs at least one")
    scenario, adjustments = prepared.scenario, Adjustments(prepared)
    inputs, rows, first = adjustments.inputs, [], 0
    started = scenario
    for action in actions:
        rows.append(inputs[first : action.tick])
        first = action.tick
        if action.name == "set" and action.arguments["name"] not in inputs:
            started = _with_parameter(started, action)
        elif action.name == "set_coupling" and action.tick > 0:
            raise InputError(f"session: the coupling was changed at {_time(scenario, action.tick)};"
                             " a scenario has one")  # fmt: skip
        adjustments.take(action)
    session = np.vstack([*rows, inputs[first:ticks]])
    duration = round(ticks * scenario.step, _DIGITS)
    written = replace(
        started,
        coupling=adjustments.coupling,
        table=inputs.table,
        duration=duration,
        success=scenario.success.within(duration),
        push=tuple(_all_pushes(session, inputs)),
        folder=scenario.folder if scenario.has_own_parts else None,
    )
    if written.coupling == "jacobi" and written.controller != scenario.controller:
        raise InputError(
            "session: a parameter was set before the first step, which with Jacobi coupling acts a "
            "tick later than a start value; give it as an override in the session's options"
        )
    same = prepared.inputs(written)[0:ticks] == session
    if not same.all():
        tick = int(np.flatnonzero(~same.all(axis=1))[0])
        raise InputError(
            f"session: from {_time(scenario, tick)} on, no table gives its commands: they were "
            "held, or a waypoint was moved when the hand was on its way to it"
        )
    return written


def _with_parameter(scenario: Scenario, action: Action) -> Scenario:
    """Return the scenario with a parameter that was set before the first step."""
    name, value = action.arguments["name"], action.arguments["value"]
    if action.tick > 0:
        raise InputError(
            f"session: {name} was set at {_time(scenario, action.tick)}; a scenario has values of "
            "parameters at its start only"
        )
    instance, _, parameter = name.partition(".")
    return with_options(scenario, Options(overrides={instance: {parameter: value}}))


def _all_pushes(rows: Array, inputs: Inputs) -> Iterator[Push]:
    """Yield the pushes on all bodies, one for each span of constant force [N]."""
    for body, name in FORCES.items():
        if f"plant.{name}" not in inputs:
            continue
        force = rows[:, inputs.columns(f"plant.{name}")]
        changes = np.flatnonzero(np.diff(force, axis=0).any(axis=1)) + 1
        for first, last in itertools.pairwise([0, *changes.tolist(), len(force)]):
            if force[first].any():
                start, duration = first * STEP_SIZE, (last - first) * STEP_SIZE
                yield Push(
                    start=round(start, _DIGITS),
                    duration=round(duration, _DIGITS),
                    force=tuple(force[first].tolist()),
                    on=body,
                )


def _time(scenario: Scenario, tick: int) -> str:
    return f"t = {tick * scenario.step:.3f} s"
