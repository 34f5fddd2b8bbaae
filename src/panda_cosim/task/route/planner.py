"""A route: the block is grasped where it stands, carried past everything, and set down.

Its motions come one after the other, as fast as the robot's limits allow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any, Final

import numpy as np

from ...assets import STEP_SIZE
from ...assets.fields import Array
from ...fmus.errors import InputError
from ...fmus.extras import needing
from ...plant.parameters import BLOCK_HALF_HEIGHT
from ..scenario import Scenario
from .motions import SPACING, Motion, rounded, timed
from .scene import HOME, PLANNED, SEED, Lines, Load, RouteScene, spacing

GRASP: Final = BLOCK_HALF_HEIGHT + 0.085  # [m] of the hand over the block, where the fingers close
LIFT, RETREAT = 0.13, 0.06  # [m] straight up with the block, and without it
LOWER: Final = GRASP - 0.012  # [m] a deeper grasp, with which the arm reaches a little further
# Random postures for each side of the block, and the hand over the block, in turn.
TRIES: Final = ((8, GRASP), (32, GRASP), (32, LOWER))
CHOICE: Final = 4  # of grasps, and of postures at the place
DROP: Final = 0.0007  # [m] above the place where the block is let go, as it creeps in the hand
OPEN, READY, CLOSED = 0.08, 0.07, 0.035  # [m] between the fingertips
CLOSING, OPENING = 0.3, 0.35  # [s]
CARRY: Final = 0.4  # of the share of the limits: faster, the block slips in the fingers
CLEARANCES: Final = (PLANNED, 0.5 * PLANNED, 0.25 * PLANNED)  # [m] less in narrow places
ITERATIONS: Final = (300, 3000)  # of the planner: to the best goal, then to any
SHORTCUTS: Final = 60  # of a path, that are tried
ROUNDINGS: Final = (1.0, 0.5, 0.25, 0.1)  # of corners, from the fastest to the closest
SETTLING: Final = 0.5  # [s] after the last row


class NoRouteError(InputError):
    """Nothing leads to the block; the message says why."""


def route(scenario: Scenario, scene: RouteScene, load: float) -> Scenario:
    """Return the scenario with a table that leads to its block, of mass `load` [kg], and on."""
    try:
        motions = _motions(scene, np.array(scenario.success.block_position))
    except NoRouteError as error:
        raise InputError(f"{scenario.name}: {error}") from None
    table = timed(scene, motions, load, scenario.timing_share)
    ticks = math.ceil((table.rows[-1].time + SETTLING) / STEP_SIZE)
    return replace(scenario, route="", table=table, timing="table", interpolation="spline",
                   duration=round(ticks * STEP_SIZE, 9))  # fmt: skip


def _motions(scene: RouteScene, place: Array) -> list[Motion]:
    """Return all motions, or raise the reason of the last attempt that had a grasp."""
    block, reason = scene.block, NoRouteError("no posture of the arm grasps and lifts the block")
    for starts, height in TRIES:
        scene.block, scene.opening = block, READY
        above, loads = block[:3] + np.array([0.0, 0.0, height]), (Load.GRASPED, Load.SET_DOWN)
        yaw = 2.0 * math.atan2(block[6], block[3])
        picks = [*islice(scene.lines(above, yaw, LIFT, loads, scene.grasp, starts), CHOICE)]
        if picks:
            reason = NoRouteError("no way leads to the block")
        for to_block, down, lift in _ways(scene, HOME, picks, Load.STANDS, OPEN):
            try:
                carried = _carried(scene, place, starts, height, down, lift)
            except NoRouteError as error:
                reason = error
                continue
            return [
                Motion("home", to_block, OPEN),
                Motion("approach", down, READY),
                Motion("grasp", _dwell(down[-1], CLOSING), CLOSED),
                Motion("lift", lift, CLOSED, CARRY),
                *carried,
            ]
    raise reason


def _carried(  # noqa: PLR0913 - all that the rest depends on
    scene: RouteScene, place: Array, starts: int, height: float, down: Array, lift: Array
) -> list[Motion]:
    """Return the motions from above the block to the end, with the block in the hand."""
    scene.grasp(down[-1])
    scene.opening = READY
    above, loads = place + np.array([0.0, 0.0, height + DROP]), (Load.SET_DOWN, Load.GRASPED)
    places = [*islice(scene.lines(above, 0.0, RETREAT, loads, scene.release, starts), CHOICE)]
    nothing = "no posture of the arm sets the block down at its place"
    reason = "no way leads to the place" if places else nothing
    for carry, lower, retreat in _ways(scene, lift[-1], places, Load.HELD, READY):
        scene.release(lower[-1])
        scene.opening = OPEN
        back = _way(scene, retreat[-1], [HOME], Load.STANDS)
        if back is not None:
            return [
                Motion("carry", carry, CLOSED, CARRY),
                Motion("lower", lower, CLOSED, CARRY),
                Motion("release", _dwell(lower[-1], OPENING), READY),
                Motion("retreat", retreat, READY),
                Motion("return", back, OPEN),
            ]
        reason = "no way leads back from the place"
    raise NoRouteError(reason)


def _ways(
    scene: RouteScene, start: Array, choice: list[Lines], load: Load, opening: float
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield a way to one of the lines down, with both lines there; then to one of the others."""
    block = scene.block
    while choice:
        scene.block, scene.opening = block, opening
        way = _way(scene, start, [down[0] for down, _ in choice], load)
        if way is None:
            return
        reached = np.argmin([np.abs(down[0] - way[-1]).max() for down, _ in choice])
        yield way, *choice.pop(int(reached))


def _way(scene: RouteScene, start: Array, goals: Sequence[Array], load: Load) -> Array | None:
    """Return knots (n, 7) [rad] of a free way to a goal, with rounded corners; None: none found."""
    for clearance in CLEARANCES:
        is_free = partial(scene.is_free, load=load, clearance=clearance)
        ends = [goal for goal in goals if is_free(goal)]
        if not (ends and is_free(start)):
            continue
        for nearest, iterations in zip((ends[:1], ends), ITERATIONS, strict=True):
            corners = _path(scene, is_free, start, nearest, clearance, iterations)
            if corners is None:
                continue
            for path, knots in (rounded(corners, rounding) for rounding in ROUNDINGS):
                if scene.are_free(path, load):
                    return knots
    return None


def _path(  # noqa: PLR0913 - all that it depends on
    scene: RouteScene, is_free: Callable[[Array], bool], start: Array, goals: Sequence[Array],
    clearance: float, iterations: int,
) -> Array | None:  # fmt: skip
    """Return corners (n, 7) [rad] of a path to one of the goals with a clearance [m]; None: none.

    The seed is fixed and the budget is counted in iterations: the same input gives the same path.
    """
    with needing("ompl", "route", "route"):
        from ompl import base, geometric, util  # noqa: PLC0415 - an extra
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(SEED)
    space, bounds = base.RealVectorStateSpace(7), base.RealVectorBounds(7)
    bounds.low, bounds.high = scene.low.tolist(), scene.high.tolist()
    space.setBounds(bounds)

    def state_of(q: Array) -> Any:
        state = space.allocState()
        for joint, angle in enumerate(q.tolist()):
            state[joint] = angle
        return state

    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: is_free(_joints(state)))
    information = setup.getSpaceInformation()
    step = spacing(clearance) / space.getMaximumExtent()
    information.setStateValidityCheckingResolution(step)
    setup.setStartState(state_of(start))
    ends = base.GoalStates(information)
    for goal in goals:
        ends.addState(state_of(goal))
    setup.setGoal(ends)
    setup.setPlanner(geometric.RRTConnect(information))
    left = iter(range(iterations))
    setup.solve(base.PlannerTerminationCondition(lambda: next(left, None) is None))
    if not setup.haveExactSolutionPath():
        return None
    path, simplifier = setup.getSolutionPath(), geometric.PathSimplifier(information)
    simplifier.reduceVertices(path)
    simplifier.partialShortcutPath(path, SHORTCUTS, SHORTCUTS)
    simplifier.reduceVertices(path)
    return np.array([_joints(state) for state in path.getStates()])


def _joints(state: Any) -> Array:
    return np.array([state[joint] for joint in range(7)])


def _dwell(q: Array, duration: float) -> Array:
    return np.tile(q, (round(duration / SPACING) + 1, 1))
