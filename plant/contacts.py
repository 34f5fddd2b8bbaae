"""Kinds of contacts: unwanted ones, those that support the block, and those of fingers and table.

Each shape has a rank, and the higher rank of the two decides: the arm and its palm should touch
nothing; fingers nothing that cannot move, such as table, floor and walls; and the block, apart from
these, should be touched from above or below.
"""

from __future__ import annotations

import math
from typing import Any, Final

import mujoco
import numpy as np

from .parameters import ARM_AND_PALM, BLOCK, FINGERS, TABLE

UPRIGHT: Final = math.sqrt(0.5)  # vertical part of a normal that is 45 deg from vertical

# Kinds of contacts, as bits.
UNWANTED: Final = 1
SUPPORT: Final = 2  # of the block
ON_TABLE: Final = 4  # of a finger
_OF_BLOCK: Final = 8  # UNWANTED or SUPPORT, by the normal

_FIXED, _BLOCK, _FINGER, _ARM = 1, 2, 3, 4  # ranks; 0: anything else that moves

Kinds = list[list[int]]


def kinds_of(model: Any) -> Kinds:
    """Return the kind of contact that two geoms make, [first][second]."""
    # In lists, as numpy would take longer to look up the few contacts of a step.
    rank = np.where(model.body_weldid[model.geom_bodyid] == 0, _FIXED, 0)
    for names, value in (((BLOCK,), _BLOCK), (FINGERS, _FINGER), (ARM_AND_PALM, _ARM)):
        rank[_belongs(model, names)] = value
    high, low = np.maximum.outer(rank, rank), np.minimum.outer(rank, rank)
    unwanted = (high == _ARM) | ((high == _FINGER) & (low == _FIXED))
    on_table = (high == _FINGER) & np.logical_or.outer(*[_belongs(model, (TABLE,))] * 2)
    kinds = UNWANTED * unwanted + ON_TABLE * on_table + _OF_BLOCK * (high == _BLOCK)
    return list(kinds.tolist())


def _belongs(model: Any, names: tuple[str, ...]) -> Any:
    """Whether each geom belongs to one of the bodies (ngeom,)."""
    bodies = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in names]
    return np.isin(model.geom_bodyid, bodies)


def contacts_of(kinds: Kinds, data: Any) -> list[int]:
    """Return the kind of each present contact: bits, or 0."""
    contact = data.contact
    present = [kinds[first][second] for first, second in contact.geom.tolist()]
    if _OF_BLOCK in present:
        for index, up in enumerate(contact.frame[:, 2].tolist()):
            if present[index] == _OF_BLOCK:
                present[index] = SUPPORT if abs(up) >= UPRIGHT else UNWANTED
    return present
