"""MJCF models: the arm (`arm.xml`, with servos `panda.xml`) and the scenes that include it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

ASSETS: Path = Path(__file__).resolve().parent
"""Folder that holds the MJCF files; their <include>s are relative to it."""

SCENES: tuple[str, ...] = ("tabletop", "tutorial", "motors", "elastic")
"""Names of the complete scenes, in the files of `scene_file`. The first is the default."""

ELASTIC: str = "elastic"
"""The scene with elastic joints: the file of `tabletop`, to which `plant.scene` adds rotors."""

TORQUE_DRIVEN: str = "motors"
"""The scene whose arm is driven by motors."""

STEP_SIZE: float = 0.001  # [s]
"""Time step of the scenes, which is also the tick of controller, master and recording."""


def scene_file(scene: str) -> str:
    """Return the name of a scene's MJCF file."""
    return f"{SCENES[0] if scene == ELASTIC else scene}.xml"


@cache
def asset_files() -> dict[str, bytes]:
    """Return the contents of all MJCF files by name, as MuJoCo takes them from memory."""
    # They are read once: when a second instance of an FMU is made, its host may have removed the
    # folder that the first one's modules came from.
    return {path.name: path.read_bytes() for path in sorted(ASSETS.glob("*.xml"))}
