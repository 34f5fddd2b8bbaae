"""A route: the block is grasped where it stands, carried past everything, and set down."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.franka import HOME_Q
from ...fmus.errors import InputError
from ...plant.scene import BLOCK_HALF_HEIGHT, block_start_height
from ..scenario.scenario import Scenario
from .grasp import Lines, lines
from .planner import find_path
from .scene import PLANNED, Load, RouteScene
from .times import SPACING, Motion, rounded, timed

Array = NDArray[np.float64]

GRASP: Final = BLOCK_HALF_HEIGHT + 0.085  # [m] of the hand over the block, where the fingers close
LIFT, RETREAT = 0.13, 0.06  # [m] straight up with the block, and without it
LOWER: Final = GRASP - 0.012  # [m] a deeper grasp, with which the arm reaches a little further
# Random postures for each side of the block, the hand over the block and the lift, in turn.
TRIES: Final = ((8, GRASP, LIFT), (32, GRASP, LIFT), (32, LOWER, LIFT), (32, GRASP, LIFT / 2),
                (32, LOWER, LIFT / 2))  # fmt: skip
CHOICE: Final = 4  # of grasps, and of postures at the place
DROP: Final = 0.0005  # [m] above the place where the block is let go
OPEN, READY, CLOSED = 0.08, 0.07, 0.035  # [m] between the fingertips
CLOSING, OPENING = 0.3, 0.35  # [s]
CARRY: Final = 0.5  # of the share of the limits: faster, the block slips in the fingers
CLEARANCES: Final = (PLANNED, 0.5 * PLANNED, 0.25 * PLANNED)  # [m] less in narrow places
ITERATIONS: Final = (300, 3000)  # of the planner: to the best goal, then to any
ROUNDINGS: Final = (1.0, 0.5, 0.25, 0.1)  # of corners, from the fastest to the closest
RINGS: Final = 0.05 * np.arange(1, 9)  # [m] distances at which other places are tried
ANGLES: Final = np.arange(0.0, 2.0 * math.pi, math.pi / 6.0)
SETTLING: Final = 0.5  # [s] after the last row
_HOME: Final = np.array(HOME_Q)


class NoRouteError(Exception):
    """Nothing leads to the block; the message says why."""


class NoPlaceError(NoRouteError):
    """Nothing leads from the block to its place."""


def route(scenario: Scenario, scene: RouteScene, load: float) -> Scenario:
    """Return the scenario with a table that leads to its block, of mass `load` [kg], and on."""
    place = np.array(scenario.success.block_position)
    try:
        motions = _motions(scene, place)
    except NoRouteError as error:
        raise InputError(f"{scenario.name}: {error}{_nearest(scene, place, error)}") from None
    table = timed(scene, motions, load, scenario.timing_share)
    ticks = math.ceil((table.rows[-1].time + SETTLING) / STEP_SIZE)
    return replace(
        scenario,
        route="",
        table=table,
        timing="table",
        interpolation="spline",
        duration=round(ticks * STEP_SIZE, 9),
    )


def _motions(
    scene: RouteScene, place: Array, tries: Sequence[tuple[int, float, float]] = TRIES
) -> list[Motion]:
    """Return all motions, or raise the reason of the last attempt that had a grasp."""
    block, reason = scene.block, NoRouteError("no posture of the arm grasps and lifts the block")
    for starts, height, rise in tries:
        scene.block, scene.opening = block, READY
        picks = list(islice(_picks(scene, starts, height, rise), CHOICE))
        while picks:
            scene.block, scene.opening = block, OPEN
            to_block = _way(scene, _HOME, [down[0] for down, _ in picks], Load.STANDS)
            if to_block is None:
                reason = NoRouteError("no way leads to the block")
                break
            down, lift = picks.pop(_reached(to_block, picks))
            try:
                carried = _carried(scene, place, starts, height, down, lift)
            except NoPlaceError as error:
                reason = error
                continue
            finally:
                scene.block = block
            return [
                Motion("home", to_block, OPEN),
                Motion("approach", down, READY),
                Motion("grasp", _dwell(down[-1], CLOSING), CLOSED),
                Motion("lift", lift, CLOSED, CARRY),
                *carried,
            ]
    raise reason


def _picks(scene: RouteScene, starts: int, height: float, rise: float) -> Iterator[Lines]:
    yaw = 2.0 * math.atan2(scene.block[6], scene.block[3])
    above, loads = scene.block[:3] + np.array([0.0, 0.0, height]), (Load.GRASPED, Load.SET_DOWN)
    return lines(scene, above, yaw, rise, loads, scene.grasp, starts)


def _carried(  # noqa: PLR0913 - all that the rest depends on
    scene: RouteScene, place: Array, starts: int, height: float, down: Array, lift: Array
) -> list[Motion]:
    """Return the motions from above the block to the end, with the block in the hand."""
    scene.grasp(down[-1])
    scene.opening = READY

    def release(q: Array) -> None:
        scene.block = scene.held_block(q)

    above, loads = place + np.array([0.0, 0.0, height + DROP]), (Load.SET_DOWN, Load.GRASPED)
    places = list(islice(lines(scene, above, 0.0, RETREAT, loads, release, starts), CHOICE))
    reason = "no posture of the arm sets the block down at its place"
    while places:
        scene.opening = READY
        carry = _way(scene, lift[-1], [lower[0] for lower, _ in places], Load.HELD)
        if carry is None:
            raise NoPlaceError("no way leads to the place")
        lower, retreat = places.pop(_reached(carry, places))
        release(lower[-1])
        scene.opening = OPEN
        back = _way(scene, retreat[-1], [_HOME], Load.STANDS)
        if back is not None:
            return [
                Motion("carry", carry, CLOSED, CARRY),
                Motion("lower", lower, CLOSED, CARRY),
                Motion("release", _dwell(lower[-1], OPENING), READY),
                Motion("retreat", retreat, READY),
                Motion("return", back, OPEN),
            ]
        reason = "no way leads back from the place"
    raise NoPlaceError(reason)


def _reached(way: Array, choice: Sequence[Lines]) -> int:
    """Return which lines a way leads to."""
    return int(np.argmin([np.abs(down[0] - way[-1]).max() for down, _ in choice]))


def _way(scene: RouteScene, start: Array, goals: Sequence[Array], load: Load) -> Array | None:
    """Return knots (n, 7) [rad] of a free way to a goal, with rounded corners; None: none found."""
    for clearance in CLEARANCES:
        is_free = partial(scene.is_free, load=load, clearance=clearance)
        ends = [goal for goal in goals if is_free(goal)]
        if not (ends and is_free(start)):
            continue
        for nearest, iterations in zip((ends[:1], ends), ITERATIONS, strict=True):
            corners = find_path(is_free, start, nearest, clearance, iterations)
            ways = [] if corners is None else [rounded(corners, part) for part in ROUNDINGS]
            for way in ways:
                if scene.are_free(_between(way), load):
                    return way
    return None


def _between(knots: Array) -> Array:
    """Return the spline through knots, ten points for each."""
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - slow, and rarely needed

    at_rest = [(order, np.zeros(7)) for order in (1, 2)]
    at = np.arange(float(len(knots)))
    spline = make_interp_spline(at, knots, k=5, bc_type=(at_rest, at_rest))
    between: Array = spline(np.linspace(0.0, at[-1], 10 * len(knots)))
    return between


def _dwell(q: Array, duration: float) -> Array:
    return np.tile(q, (round(duration / SPACING) + 1, 1))


def _nearest(scene: RouteScene, place: Array, error: NoRouteError) -> str:
    """Name the nearest place for the block, at the start or at the end, to which a route leads."""
    standing, moves_place = scene.block, isinstance(error, NoPlaceError)
    x, y = (place if moves_place else standing)[:2]
    for distance, angle in ((d, a) for d in RINGS for a in ANGLES):
        at = x + distance * math.cos(angle), y + distance * math.sin(angle)
        other = np.array([*at, block_start_height(*at)]).round(3)
        block = np.concatenate((other, standing[3:]))
        if not scene.can_stand(block):
            continue
        scene.block = standing if moves_place else block
        try:
            _motions(scene, other if moves_place else place, TRIES[:1])
        except NoRouteError:
            continue
        key, numbers = ("success.block_position", 3) if moves_place else ("plant.block_pos", 2)
        value = ",".join(f"{number:g}" for number in other[:numbers])
        return f"; the nearest that was found to work is {key}={value}"
    return ""
