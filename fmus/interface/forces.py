"""Forces that push bodies of the plant; light, since scenarios are read without MuJoCo."""

from __future__ import annotations

from typing import Final

FORCES: Final = {"hand": "push_force", "block": "block_force"}  # input by pushed body
FORCE_MAX: Final = 1000.0  # [N] far above any realistic push
