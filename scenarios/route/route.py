"""A route: the block is grasped where it stands, carried past everything, and set down."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets import SCENES, STEP_SIZE
from ...assets.franka import HOME_Q
from ...fmus.errors import InputError
from ...plant.parameters import PlantParameters
from ...plant.scene import BLOCK_HALF_HEIGHT, block_start_height, load_scene
from .. import rotations
from ..run.start import StartValues, carried_mass, start_pose, start_values
from ..scenario.scenario import Scenario
from .grasp import candidates, free_line, poses
from .planner import find_path
from .scene import PLANNED, Load, RouteScene
from .times import SPACING, Motion, rounded, timed

Array = NDArray[np.float64]

# Heights of the hand's origin [m]: over the block's centre where the fingers close, over that where
# they come from, where they lift it to, and where they go after they have let go.
GRASP, ABOVE, LIFT, RETREAT = BLOCK_HALF_HEIGHT + 0.085, 0.06, 0.13, 0.06
DROP: Final = 0.0002  # [m] above the place where the block is let go
OPEN, READY, CLOSED = 0.08, 0.07, 0.035  # [m] between the fingertips
CLOSING, OPENING = 0.3, 0.35  # [s]
CARRY: Final = 0.5  # of the share of the limits: faster, the block slips in the fingers
GRASPS: Final = 4  # that are tried, each with as many postures at the place
CLEARANCES: Final = (PLANNED, 0.5 * PLANNED, 0.25 * PLANNED)  # [m] less in narrow places
ROUNDINGS: Final = (1.0, 0.5, 0.25, 0.1)  # of corners, from the fastest to the closest
TRIED: Final = 0.05  # [m] between places that are tried where a block cannot be grasped
SETTLING: Final = 0.5  # [s] after the last row
_HOME: Final = np.array(HOME_Q)


class NoRouteError(Exception):
    """There is no route; the message says why."""


def route(scenario: Scenario) -> Scenario:
    """Return the scenario with a table that leads to its block and to its place."""
    place = _place(scenario)
    values = start_values(scenario)
    scene = _scene(scenario, values)
    try:
        motions = _motions(scene, place)
    except NoRouteError as error:
        raise InputError(f"{scenario.name}: {error}{_nearest(scene)}") from None
    load, share = carried_mass(scenario, values), scenario.timing_share
    table = timed(scene, motions, load, share, CARRY)
    end = table.rows[-1].time + SETTLING
    return replace(
        scenario,
        table=table,
        timing="table",
        interpolation="spline",
        duration=round(math.ceil(end / STEP_SIZE) * STEP_SIZE, 9),
    )


def _place(scenario: Scenario) -> Array:
    place = scenario.success.block_position
    if scenario.has_own_parts or place is None:
        raise InputError(
            f"{scenario.name}: has no place for the block, or parts of its own; must have "
            "[success] block_position, and our plant and controller"
        )
    return np.array(place)


def _scene(scenario: Scenario, values: StartValues) -> RouteScene:
    """The scene with the block where the camera sees it."""
    start = start_pose(values["plant"], values.get("sensors"))
    centre = np.array(start.target_position) - np.array([0.0, 0.0, BLOCK_HALF_HEIGHT])
    model = load_scene(PlantParameters(scene=SCENES[0]))
    return RouteScene(model, np.concatenate((centre, rotations.about_z(start.block_yaw))))


def _motions(scene: RouteScene, place: Array) -> list[Motion]:
    """Return all motions, or raise the reason of the attempt that came furthest."""
    reasons = ["no posture of the arm grasps and lifts the block"]
    for down, lift in _grasps(scene):
        scene.grasp(down[-1])
        scene.opening = OPEN
        pick = _way(scene, _HOME, down[0], Load.STANDS)
        if pick is None:
            reasons.append("no way leads to the block")
            continue
        try:
            return [Motion(pick, OPEN, name="home"), *_carried(scene, place, down, lift)]
        except NoRouteError as error:
            reasons.append(str(error))
    raise NoRouteError(reasons[-1])


def _carried(scene: RouteScene, place: Array, down: Array, lift: Array) -> list[Motion]:
    """Return the motions from above the block to the end, with the block in the hand."""
    standing, reason = scene.block, "no posture of the arm sets the block down at its place"
    height = np.array([0.0, 0.0, GRASP + DROP])
    tried = 0
    for above in candidates(scene, poses(place + height, 0.0), ABOVE):
        scene.opening = READY
        lower = free_line(scene, above, -ABOVE, Load.SET_DOWN)
        if lower is None or tried == GRASPS:
            continue
        tried += 1
        carry = _way(scene, lift[-1], above, Load.HELD)
        if carry is None:
            reason = "no way leads to the place"
            continue
        scene.block = scene.held_block(lower[-1])
        retreat = free_line(scene, lower[-1], RETREAT, Load.GRASPED)
        scene.opening = OPEN
        back = None if retreat is None else _way(scene, retreat[-1], _HOME, Load.STANDS)
        scene.block = standing
        if retreat is None or back is None:
            reason = "no way leads back from the place"
            continue
        return [
            Motion(down, READY, name="approach"),
            Motion(_dwell(down[-1], CLOSING), CLOSED, name="grasp"),
            Motion(lift, CLOSED, name="lift"),
            Motion(carry, CLOSED, name="carry"),
            Motion(lower, CLOSED, name="lower"),
            Motion(_dwell(lower[-1], OPENING), READY, name="release"),
            Motion(retreat, READY, name="retreat"),
            Motion(back, OPEN, name="return"),
        ]
    raise NoRouteError(reason)


def _grasps(scene: RouteScene) -> list[tuple[Array, Array]]:
    """Return lines (n, 7) [rad] down to the block and up with it, the best first."""
    yaw = 2.0 * math.atan2(scene.block[6], scene.block[3])
    centre = scene.block[:3] + np.array([0.0, 0.0, GRASP])
    lines: list[tuple[Array, Array]] = []
    scene.opening = READY
    for above in candidates(scene, poses(centre, yaw), ABOVE):
        down = free_line(scene, above, -ABOVE, Load.GRASPED)
        if down is None:
            continue
        scene.grasp(down[-1])
        lift = free_line(scene, down[-1], LIFT, Load.SET_DOWN)
        if lift is not None:
            lines.append((down, lift))
        if len(lines) == GRASPS:
            break
    return lines


def _way(scene: RouteScene, start: Array, goal: Array, load: Load) -> Array | None:
    """Return knots (n, 7) [rad] of a free way with rounded corners; None: none was found."""
    for clearance in CLEARANCES:
        is_free = partial(scene.is_free, load=load, clearance=clearance)
        if not (is_free(start) and is_free(goal)):
            continue
        corners = find_path(is_free, start, goal, clearance)
        ways = [] if corners is None else [rounded(corners, rounding) for rounding in ROUNDINGS]
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


def _nearest(scene: RouteScene) -> str:
    """Name the nearest place where the block can stand and be grasped."""
    (x, y), turn = scene.block[:2], scene.block[3:]
    for distance in TRIED * np.arange(1, 13):
        for angle in np.arange(0.0, 2.0 * math.pi, math.pi / 6.0):
            place = x + distance * math.cos(angle), y + distance * math.sin(angle)
            scene.block = np.array([*place, block_start_height(*place), *turn])
            if scene.stands() and _grasps(scene):
                return (
                    "; the nearest place found where it can be grasped is plant.block_pos="
                    f"{place[0]:.3f},{place[1]:.3f}"
                )
    return ""
