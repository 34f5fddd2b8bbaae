"""The signals that the plot of a run draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...fmus.errors import InputError
from ..judging.holds import Hold, find_holds
from .motion import SHAPES, FloatArray, Signals, take


@dataclass(frozen=True)
class Curves:
    """The drawn signals of a run, all at the same instants.

    Attributes:
        time: Instants (n,) [s].
        hand: Position of the hand (n, 3) [m].
        hand_cmd: Its command (n, 3) [m].
        qpos: Positions (n, 16) [rad, m].
        qvel: Joint velocities (n, 15) [rad/s].
        force: Forces of the servos (n, 8) [N.m, N].
        opening_cmd: Commanded opening between the fingertips (n,) [m].
        contact: Normal force of the fingers on the block (n,) [N].
        reference: Velocity of the joint reference (n, 7) [rad/s]; None: the law records none.
        holds: Spans in which the block is held.
        metadata: Of the recording.
        waypoints: Instants of the table's rows (k,) [s], if the recording has them.
        names: Names of these rows, if any.
    """

    time: FloatArray
    hand: FloatArray
    hand_cmd: FloatArray
    qpos: FloatArray
    qvel: FloatArray
    force: FloatArray
    opening_cmd: FloatArray
    contact: FloatArray
    reference: FloatArray | None
    holds: Sequence[Hold]
    metadata: Mapping[str, Any]
    waypoints: FloatArray
    names: tuple[str, ...] = ()

    @property
    def error(self) -> FloatArray:
        """Distance of the hand from its command (n,) [mm]."""
        return np.asarray(1000 * np.linalg.norm(self.hand - self.hand_cmd, axis=1))


def read_curves(recording: Signals) -> Curves:
    """Return the drawn signals of a recording.

    Raises:
        InputError: It has no rows or lacks a signal.
    """
    signals = take(recording, SHAPES)
    return Curves(
        time=recording.time,
        hand=signals["plant.hand_xpos"],
        hand_cmd=signals["controller.pos_cmd"],
        qpos=signals["plant.qpos"],
        qvel=signals["plant.qvel"],
        force=signals["plant.actuator_force"],
        opening_cmd=signals["controller.grip_cmd"],
        contact=signals["plant.contact_force"],
        reference=_reference(recording),
        holds=find_holds(recording),
        metadata=recording.metadata,
        waypoints=_waypoints(recording.metadata.get("row_times")),
        names=_names(recording.metadata.get("row_names")),
    )


def _reference(recording: Signals) -> FloatArray | None:
    """Return the velocity of the joint reference (n, 7) [rad/s]; None for a law without one."""
    try:
        return recording["controller.qvel_ref"]
    except (InputError, LookupError, ValueError):
        return None


def _names(names: object) -> tuple[str, ...]:
    """Return the names of the table's rows; none if the metadata is damaged."""
    return tuple(map(str, names)) if isinstance(names, list) else ()


def _waypoints(times: object) -> FloatArray:
    """Return the instants of the table's rows (k,) [s]; none if the metadata is damaged."""
    if not isinstance(times, list) or not all(isinstance(t, int | float) for t in times):
        return np.empty(0)
    return np.array(times, dtype=float)
