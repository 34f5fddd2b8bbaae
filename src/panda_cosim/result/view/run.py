"""One run as plain values for the page: motion, signals, verdict, limits, moments and notes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from typing import Final

import numpy as np

from ...assets.fields import Array
from ...fmus.errors import InputError
from ...fmus.master.order import shown
from ...result.judging.summary import Summary
from ...result.recording import Recording, by_rows
from ...task import rotations
from ...task.files import model_file
from ...task.limits import robot_of
from ...task.tolerances import signal_of
from ..pictures.motion import describe_run
from ..thinning import Thinning
from .columns import Json, describe_time, encode
from .facts import (
    CURVES,
    PARTS,
    column_bounds,
    criteria_of,
    limits_of,
    moments,
    refusals_of,
    shown_curves,
    waypoints,
)

POSE_STEP: Final = 1e-6  # [rad], [m], [1] rounding step of qpos
CLEAR: Final = 20  # rounding steps of a reference from which a difference is no noise
ROUNDING: Final = "Curves are rounded to 1/65536 of their range; what stays below 1e-12 is 0."
FORCES: Final = (
    "Arrows: the forces on each free body besides its weight, m (a - g), from its recorded motion; "
    "means over at least 33 ms."
)

# Signals by their role in the scene; what is missing is not drawn, but positions must be there.
ROLES: Final = {
    "qpos": "plant.qpos",  # MuJoCo's positions (n, nq)
    "actual": "plant.hand_xpos",  # of the hand (n, 3) [m]
    "actual_turn": "plant.hand_xquat",  # (n, 4) (w, x, y, z)
    "commanded": "controller.pos_cmd",
    "commanded_turn": "controller.quat_cmd",
}


@dataclass(frozen=True)
class Shown:
    """A run to show, with the model that it is drawn with.

    `shown_run` makes it from a folder, `show_source` from a recording or a reference. It reads
    nothing by itself until it is described for a page.
    """

    name: str  # in links and on the page
    source: Recording
    model: Json | None  # as `model.describe` returns it; None: curves alone are shown
    # Of the model's bodies [kg]; None: the run may have had others, and no forces are drawn.
    masses: Sequence[float] | None = None
    summary: Summary = field(default_factory=Summary)
    notes: tuple[str, ...] = ()  # further remarks on its data
    only: frozenset[str] = frozenset()  # signals and columns that are in the page; none: all


def describe(run: Shown, model_key: str, against: Recording | None = None) -> Json:
    """Return a run as plain values."""
    source, metadata = run.source, run.source.metadata
    columns = by_role(source.columns)
    _check(run, len(columns["qpos"]))
    thinning = Thinning.of(source.time)
    title, about = describe_run(source)
    with ThreadPoolExecutor(1) as second:  # zlib compresses without Python's lock
        recorded = _signals(run, thinning, columns["qpos"], second)
        signals = [*_derived(source, thinning, against), *recorded]
    known = {n: unit for s in signals for n, unit in zip(s["columns"], s["units"], strict=True)}
    bounds = {} if model_file(source) else column_bounds(robot_of(metadata))
    return {
        "name": run.name,
        "title": title,
        "purpose": str(metadata.get("purpose") or ""),
        "facts": [*about.split(" · "), *_ran(run)],
        "model": model_key if run.model else "",
        "verdict": {"state": run.summary.verdict.level, "words": run.summary.brief},
        "criteria": criteria_of(run.summary),
        "limits": limits_of(run.summary),
        "notes": list(filter(None, _notes(run, thinning))),
        "time": describe_time(thinning.curve_time),
        "signals": signals,
        "poses": _poses(source, thinning, columns) if thinning.every > 1 else None,
        "roles": {role: names for role, names in columns.items() if names},
        "masses": run.masses,
        "moments": moments(source),
        "waypoints": waypoints(metadata),
        "bounds": {name: pair for name, pair in bounds.items() if name in known},
        "curves": shown_curves(CURVES, known),
    }


def by_role(columns: Sequence[str]) -> dict[str, list[str]]:
    """Return the columns of each of `ROLES` in order; none of one that is missing."""
    return {role: [c for c in columns if signal_of(c) == signal] for role, signal in ROLES.items()}


def _check(run: Shown, positions: int) -> None:
    """Refuse a run that cannot be shown with its model."""
    if not len(run.source.time):
        raise InputError(f"{run.name}: the recording has no rows; there is nothing to show")
    if run.model and positions != run.model["nq"]:
        raise InputError(
            f"{run.name}: {positions} columns of {ROLES['qpos']}; the model that it is drawn with "
            f"has {run.model['nq']} positions"
        )


def _ran(run: Shown) -> list[str]:
    """Say what ran the last FMUs, and what stepped them."""
    ran = {**run.source.metadata.get("code", {}), "stepped by": run.summary.stepped_by}
    return [f"{part}: {by}" for part, by in ran.items() if by][-PARTS:]


def _notes(run: Shown, thinning: Thinning) -> Iterator[str]:
    """Yield remarks on the run and on how it is shown; empty ones are none."""
    metadata = run.source.metadata
    yield from (*refusals_of(run.summary), thinning.words(), ROUNDING, FORCES * bool(run.masses))
    if len(metadata.get("order", ())) > 1:
        yield shown(metadata["order"], metadata["late"])
    yield from (*run.summary.costs(), *run.notes)


def _columns(source: Recording, signal: str) -> list[str]:
    """Return a signal's columns in order; none if the run has no such signal."""
    return [name for name in source.columns if signal_of(name) == signal]


def _signals(
    run: Shown, thinning: Thinning, positions: Sequence[str], second: Executor
) -> Iterator[Json]:
    """Yield all recorded signals, each with its columns in one block; these are begun at once."""
    source, only = run.source, run.only
    names = [name for name in source.columns if name != "time"]
    if only:
        names = [name for name in names if not only.isdisjoint((name, signal_of(name)))]
    groups = [list(group) for _, group in groupby(names, key=signal_of)]
    curves = ([thinning.curve(source[n]) for n in columns] for columns in groups)
    steps = ([POSE_STEP if n in positions else None for n in columns] for columns in groups)
    return map(partial(_signal, source), groups, second.map(encode, curves, steps))


def _signal(source: Recording, columns: list[str], block: Json) -> Json:
    units = [source.units.get(name, "") for name in columns]
    return _described(columns, units, source.descriptions.get(columns[0], ""), block)


def _described(columns: list[str], units: list[str], words: str, block: Json) -> Json:
    name = signal_of(columns[0])
    return {"name": name, "columns": columns, "units": units, "words": words, **block}


def _derived(source: Recording, thinning: Thinning, against: Recording | None) -> list[Json]:
    """Return curves computed from several signals, unless they would be rounding noise."""
    hand, turn, command = ROLES["actual"], ROLES["actual_turn"], ROLES["commanded"]
    curves = []

    def add(name: str, unit: str, words: str, values: Array) -> None:
        curves.append(_described([name], [unit], words, encode([thinning.curve(values)], [None])))

    if _has(source, hand, command):
        error = by_rows(source, lambda a, b: np.linalg.norm(a - b, axis=1), hand, command)
        if error.max(initial=0.0) >= CLEAR * max(_quanta(source, hand)):
            add("tracking error", "mm", "Distance of the hand from its command", 1e3 * error)
    if _has(source, turn, ROLES["commanded_turn"]):
        angle = by_rows(source, rotations.angle_deg, ROLES["commanded_turn"], turn)
        if angle.max(initial=0.0) >= CLEAR * np.degrees(2 * max(_quanta(source, turn))):
            add("orientation error", "deg", "Angle of the hand from its command", angle)
    if against is not None and _has(source, hand) and _has(against, hand):
        gap = 1e3 * np.linalg.norm(_difference(source, against, hand), axis=1)
        add("distance to the other run", "mm", "Between the hands of the two runs", gap)
    return curves


def _has(source: Recording, *signals: str) -> bool:
    return all(_columns(source, signal) for signal in signals)


def _difference(source: Recording, other: Recording, signal: str) -> Array:
    """Return the distance of a signal (n, 3) from another run's, NaN after that one's end.

    What the other run's rounding explains is 0.
    """
    mine, theirs = source[signal], other[signal]
    there = [np.interp(source.time, other.time, theirs[:, axis], right=np.nan) for axis in range(3)]
    away = np.asarray(mine - np.column_stack(there))
    half = np.array(_quanta(other, signal)) / 2
    away[np.abs(away) <= half * (1 + 1e-6)] = 0.0
    return away


def _quanta(source: Recording, signal: str) -> list[float]:
    """Return the rounding step of each column of a signal: a reference has them, a run has none."""
    quanta: Mapping[str, float] = getattr(source, "quanta", {})
    return [quanta.get(name, 0.0) for name in _columns(source, signal)]


def _poses(source: Recording, thinning: Thinning, columns: Mapping[str, Sequence[str]]) -> Json:
    """Return the columns the scene needs, at the instants of poses."""
    names = [name for group in columns.values() for name in group]
    block = encode([thinning.poses(source[name]) for name in names], [POSE_STEP] * len(names))
    return {"time": describe_time(thinning.poses(source.time)), "columns": names, **block}
