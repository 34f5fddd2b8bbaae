"""Slows a time law down where the joint path has kinks, as near singularities.

Where the controller's damping sets in, the joints' acceleration jumps from one tick to the next. A
longer window does not help there, as it does elsewhere: only a lower speed at that place does.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from .violations import WAY_TOLERANCE

Array = NDArray[np.float64]

SPIKE: Final = 9  # [ticks] up to half as many are a spike
SPIKY: Final = 2.0  # times as high as without spikes
NEAR: Final = 40  # [ticks] around a spike; the law is averaged over about as many
SLACK: Final = 0.95  # of the speed that is allowed, so that few rounds suffice
CRAWL: Final = 2e-4  # [m/s] no slower
LAG_ORDER: Final = 0.7  # the hand's lag falls more slowly than its speed


def without_spikes(rates: Array) -> Array:
    """Return the largest rate at each tick (n,), without what lasts a few ticks only.

    Args:
        rates: Shares of the limits of jerk and torque rate (n, joints) [1].
    """
    from scipy.ndimage import median_filter  # noqa: PLC0415 - slow, and rarely needed

    smooth: Array = median_filter(np.abs(rates), size=(SPIKE, 1)).max(axis=1)
    return smooth


def is_spiky(rates: Array) -> bool:
    """Tell whether rates (n, joints) have spikes."""
    return bool(np.abs(rates).max() > SPIKY * without_spikes(rates).max())


def lowered(ceiling: Array, law: Array, rates: Array, miss: Array, aim: float) -> Array:
    """Lower the ceiling of a path's speed where a law asks too much.

    Args:
        ceiling: Largest speeds at evenly spaced places of the path (g,) [m/s].
        law: Place at each tick (n,) [m].
        rates: Shares of the limits of jerk and torque rate at each tick (n, joints) [1].
        miss: Distance of hand and command at each tick (n,) [m].
        aim: Share that may be used [1].
    """
    from scipy.ndimage import minimum_filter1d  # noqa: PLC0415 - slow, and rarely needed

    speed = np.gradient(law) / STEP_SIZE
    kink = np.sqrt(np.abs(rates).max(axis=1) / aim)
    lag = (miss / WAY_TOLERANCE) ** (1.0 / LAG_ORDER)
    excess = np.maximum(kink, lag)
    allowed = np.where(excess > 1.0, SLACK * speed / np.maximum(excess, 1.0), np.inf)
    allowed = minimum_filter1d(allowed, 2 * NEAR + 1)
    places = np.linspace(0.0, law[-1], len(ceiling))
    ticks = np.interp(places, law, np.arange(len(law))).round().astype(int)
    lower: Array = np.minimum(ceiling, np.maximum(allowed[ticks], CRAWL))
    return lower
