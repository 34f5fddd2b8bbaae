"""One run as plain values for the page: motion, signals, verdict and notes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from .. import rotations
from ..files import model_file
from ..pictures.motion import describe_run
from . import story
from .columns import Thinning, describe_time, encode
from .contacts import contact_forces, contact_rows

Array = NDArray[np.float64]

FORMAT: Final = 1
POSE_STEP: Final = 1e-6  # [rad], [m], [1] rounding step of qpos
CLEAR: Final = 20  # rounding steps of a reference from which a difference is no noise
PIECE: Final = 100_000  # rows computed at once
ROUNDING: Final = "Curves are rounded to 1/65536 of their range; what stays below 1e-12 is 0."


class RunData(Protocol):
    """Interface the page needs of a run; `scenarios.recording.Recording` has it."""

    @property
    def time(self) -> Array:
        """Instants of the rows (n,) [s], increasing."""

    @property
    def metadata(self) -> Mapping[str, Any]:
        """Metadata: scenario, scene, parameters and so on."""

    @property
    def columns(self) -> Sequence[str]:
        """Names of all columns, such as `plant.qpos[1]`."""

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column."""

    @property
    def descriptions(self) -> Mapping[str, str]:
        """Description of each column."""

    def __getitem__(self, name: str) -> Array:
        """A signal's values (n, ...), or a column's (n,)."""


@dataclass(frozen=True)
class Roles:
    """The signals' roles in the scene. What is missing is not drawn; only qpos is required.

    Attributes:
        qpos: MuJoCo positions (n, nq).
        qvel: MuJoCo velocities (n, nv), for contact forces.
        ctrl: MuJoCo controls (n, nu), for contact forces.
        actual: Position of the hand (n, 3) [m].
        actual_turn: Its orientation (n, 4) (w, x, y, z).
        commanded: Its commanded position (n, 3) [m].
        commanded_turn: Its commanded orientation (n, 4) (w, x, y, z).
    """

    qpos: str = "plant.qpos"
    qvel: str = "plant.qvel"
    ctrl: str = "controller.ctrl"
    actual: str = "plant.hand_xpos"
    actual_turn: str = "plant.hand_xquat"
    commanded: str = "controller.pos_cmd"
    commanded_turn: str = "controller.quat_cmd"


DRAWN: Final = ("qpos", "actual", "actual_turn", "commanded", "commanded_turn")  # roles
ROLES: Final = Roles()  # of the project's own FMUs


@dataclass(frozen=True)
class Shown:
    """A run to show.

    Attributes:
        name: Its name in links and on the page.
        source: Its signals.
        model: `mujoco.MjModel` for drawing; None: that of the recording.
        physics: `mujoco.MjModel` for contact forces; None: not drawn.
        summary: Content of `summary.json`, or empty.
        roles: Which signal has which role.
        notes: Further remarks on its data for the page.
    """

    name: str
    source: RunData
    model: Any
    physics: Any = None
    summary: Mapping[str, Any] = field(default_factory=dict)
    roles: Roles = ROLES
    notes: tuple[str, ...] = ()


def describe(run: Shown, model_key: str, against: RunData | None = None) -> dict[str, Any]:
    """Return a run as plain values."""
    source, metadata = run.source, run.source.metadata
    thinning = Thinning.of(_checked_time(run))
    columns = {role: _columns(source, getattr(run.roles, role)) for role in DRAWN}
    _check_positions(run, columns["qpos"])
    title, about = describe_run(source)
    signals = _derived(run, thinning, against) + _signals(source, thinning, set(columns["qpos"]))
    known = {name: "" for signal in signals for name in signal["columns"]}
    contacts = _contacts(run)
    notes = [thinning.words(), ROUNDING, contacts["words"] if contacts else "", *run.notes]
    return {
        "format": FORMAT,
        "name": run.name,
        "title": title,
        "purpose": str(metadata.get("purpose") or ""),
        "facts": about.split(" · "),
        "model": model_key,
        "verdict": story.verdict(run.summary, metadata),
        "criteria": story.criteria_of(run.summary),
        "limits": story.limits_of(run.summary),
        "notes": [note for note in notes if note],
        "time": describe_time(thinning.curve_time),
        "signals": signals,
        "poses": _poses(source, thinning, columns) if thinning.every > 1 else None,
        "roles": {role: names for role, names in columns.items() if names},
        "contacts": contacts,
        "moments": story.moments(source),
        "waypoints": story.waypoints(metadata),
        "bounds": {name: pair for name, pair in _bounds(source).items() if name in known},
        "curves": story.shown(story.CURVES, known),
    }


def _bounds(source: RunData) -> dict[str, list[float]]:
    """Return the robot's limits; none for another plant."""
    return story.bounds() if model_file(source) is None else {}


def _checked_time(run: Shown) -> Array:
    time = run.source.time
    if not len(time):
        raise InputError(f"{run.name}: the recording has no rows; there is nothing to show")
    return time


def _columns(source: RunData, signal: str) -> list[str]:
    """Return a signal's columns in order; none if the run has no such signal."""
    pattern = re.compile(rf"{re.escape(signal)}(\[\d+\])?")
    return [name for name in source.columns if pattern.fullmatch(name)]


def _check_positions(run: Shown, columns: Sequence[str]) -> None:
    if len(columns) != run.model.nq:
        raise InputError(
            f"{run.name}: {len(columns)} columns of {run.roles.qpos}; the model that it is drawn "
            f"with has {run.model.nq} positions"
        )


def _signals(source: RunData, thinning: Thinning, positions: set[str]) -> list[dict[str, Any]]:
    """Return all recorded signals, each with its columns in one block."""
    names = [name for name in source.columns if name != "time"]
    found = []
    for signal, group in groupby(names, key=lambda name: name.partition("[")[0]):
        columns = list(group)
        steps = [POSE_STEP if name in positions else None for name in columns]
        found.append(
            {
                "name": signal,
                "columns": columns,
                "units": [source.units.get(name, "") for name in columns],
                "words": source.descriptions.get(columns[0], ""),
                **encode([thinning.curve(source[name]) for name in columns], steps),
            }
        )
    return found


def _derived(run: Shown, thinning: Thinning, against: RunData | None) -> list[dict[str, Any]]:
    """Return curves computed from several signals, unless they would be rounding noise."""
    source, roles = run.source, run.roles
    found = []

    def add(name: str, unit: str, words: str, values: Array) -> None:
        block = encode([thinning.curve(values)], [None])
        found.append({"name": name, "columns": [name], "units": [unit], "words": words, **block})

    if _has(source, roles.actual, roles.commanded):
        error = np.linalg.norm(source[roles.actual] - source[roles.commanded], axis=1)
        if error.max(initial=0.0) >= CLEAR * max(_quanta(source, roles.actual)):
            add("tracking error", "mm", "Distance of the hand from its command", 1e3 * error)
    if _has(source, roles.actual_turn, roles.commanded_turn):
        angle = _angle(source[roles.commanded_turn], source[roles.actual_turn])
        coarse = np.degrees(2 * max(_quanta(source, roles.actual_turn)))
        if angle.max(initial=0.0) >= CLEAR * coarse:
            add("orientation error", "deg", "Angle of the hand from its command", angle)
    if against is not None and _has(source, roles.actual) and _has(against, roles.actual):
        gap = 1e3 * np.linalg.norm(_difference(source, against, roles.actual), axis=1)
        add("distance to the other run", "mm", "Between the hands of the two runs", gap)
    return found


def _has(source: RunData, *signals: str) -> bool:
    return all(_columns(source, signal) for signal in signals)


def _angle(commanded: Array, actual: Array) -> Array:
    """Return the angle between orientations (n, 4) (w, x, y, z), (n,) [deg]."""

    def part(rows: slice) -> Array:
        inverse = rotations.conjugate(actual[rows])
        turn = rotations.log(rotations.multiply(commanded[rows], inverse))
        return np.asarray(np.degrees(np.linalg.norm(turn, axis=1)))

    # In pieces, so that a long run needs little memory.
    return np.concatenate([part(slice(k, k + PIECE)) for k in range(0, len(actual), PIECE)])


def _difference(source: RunData, other: RunData, signal: str) -> Array:
    """Return the distance of a signal (n, 3) from another run's, NaN after that one's end.

    What the other run's rounding explains is 0.
    """
    mine, theirs = source[signal], other[signal]
    there = [np.interp(source.time, other.time, theirs[:, axis], right=np.nan) for axis in range(3)]
    away = np.asarray(mine - np.column_stack(there))
    half = np.array(_quanta(other, signal)) / 2
    away[np.abs(away) <= half * (1 + 1e-6)] = 0.0
    return away


def _quanta(source: RunData, signal: str) -> list[float]:
    """Return the rounding step of each column of a signal: a reference has them, a run has none."""
    quanta: Mapping[str, float] = getattr(source, "quanta", {})
    return [quanta.get(name, 0.0) for name in _columns(source, signal)]


def _poses(
    source: RunData, thinning: Thinning, columns: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """Return the columns the scene needs, at the instants of poses."""
    names = [name for group in columns.values() for name in group]
    values = [thinning.poses(source[name]) for name in names]
    block = encode(values, [POSE_STEP] * len(names))
    return {"time": describe_time(thinning.pose_time), "columns": names, **block}


def _contacts(run: Shown) -> dict[str, Any] | None:
    """Return the contact forces, or None if the run lacks signals for them."""
    source, roles, physics = run.source, run.roles, run.physics
    columns = [_columns(source, name) for name in (roles.qpos, roles.qvel, roles.ctrl)]
    if physics is None or [len(c) for c in columns] != [physics.nq, physics.nv, physics.nu]:
        return None
    interval, rows = contact_rows(source.time)
    # Column by column, so that a long run needs little memory.
    state = (np.column_stack([source[name][rows] for name in names]) for names in columns)
    start = float(source.time[0])
    return {"start": start, "interval": interval, **contact_forces(physics, *state)}


__all__ = ["ROLES", "Roles", "RunData", "Shown", "describe"]
