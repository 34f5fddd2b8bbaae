"""Paths of the joints between two postures, by OMPL's RRT-Connect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError
from .scene import HIGH, LOW, spacing

Array = NDArray[np.float64]

SEED: Final = 1
SHORTCUTS: Final = 60  # that are tried


def find_path(
    is_free: Callable[[Array], bool],
    start: Array,
    goals: Sequence[Array],
    clearance: float,
    iterations: int,
) -> Array | None:
    """Return corners (n, 7) [rad] of a path to one of the goals with a clearance [m]; None: none.

    The seed is fixed and the budget is counted in iterations: the same input gives the same path.
    """
    try:
        from ompl import base, geometric, util  # noqa: PLC0415 - an extra
    except ImportError:
        raise InputError(
            "route takes ompl, which is not installed; must be there: "
            "pip install 'panda-cosim[route]'"
        ) from None
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(SEED)
    space, bounds = base.RealVectorStateSpace(7), base.RealVectorBounds(7)
    for joint in range(7):
        bounds.setLow(joint, float(LOW[joint]))
        bounds.setHigh(joint, float(HIGH[joint]))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: is_free(_joints(state)))
    information = setup.getSpaceInformation()
    step = spacing(clearance) / space.getMaximumExtent()
    information.setStateValidityCheckingResolution(step)
    setup.setStartState(_state(space, start))
    ends = base.GoalStates(information)
    for goal in goals:
        ends.addState(_state(space, goal))
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


def _state(space: Any, q: Array) -> Any:
    state = space.allocState()
    for joint in range(7):
        state[joint] = float(q[joint])
    return state
