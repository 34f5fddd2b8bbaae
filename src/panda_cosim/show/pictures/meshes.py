"""The model for pictures: a scene, on request with Menagerie's meshes.

Only looks differ: bodies, joints and their order are the scene's, so a recording's qpos matches.
The simulation never sees this model.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal, get_args

from ...assets import ASSETS, SCENES, scene_file
from ...fmus.errors import InputError
from ...task.fields import check_choice

Meshes = Literal["never", "auto", "always"]
"""Whether to draw the meshes: not at all, where they are at hand, or else fail."""

ROBOT = "franka_emika_panda"
PREFIX = "menagerie_"  # prefix that keeps added names apart from the scene's
LOOK = ("rgba", "specular", "shininess")  # of a material, that is taken over
SHOWN = 2  # geom group of visual geoms, in this arm and in Menagerie's
HIDDEN = 5  # geom group that is not drawn


def load_model(scene: str, meshes: Meshes = "never") -> Any:
    """Compile the model of a scene to draw: one of `assets.SCENES`, or the path of an .mjb file."""
    import mujoco  # noqa: PLC0415 - slow to import

    if scene.endswith(".mjb"):
        from ...fmus.sources.model_fmu import load  # noqa: PLC0415 - only for such a scene

        return load(Path(scene))
    check_choice("scene", scene, SCENES)
    check_choice("meshes", meshes, get_args(Meshes))
    spec = mujoco.MjSpec.from_file(str(ASSETS / scene_file(scene)))
    folder = None if meshes == "never" else find_menagerie()
    if folder is not None:
        apply_meshes(spec, folder)
    elif meshes == "always":
        raise InputError(
            f"meshes: value 'always'; no folder {ROBOT} of MuJoCo Menagerie was found; set "
            "MENAGERIE_ROOT to the folder that holds it"
        )
    return spec.compile()


def find_menagerie() -> Path | None:
    """Return the folder of Menagerie's Panda in MENAGERIE_ROOT, or None."""
    root = os.environ.get("MENAGERIE_ROOT")
    folder = Path(root) / ROBOT if root else None
    return folder if folder is not None and (folder / "panda.xml").is_file() else None


def apply_meshes(spec: Any, folder: Path) -> None:
    """Hide the arm's own visual geoms in a `mujoco.MjSpec`, and put Menagerie's in their place."""
    import mujoco  # noqa: PLC0415 - slow to import

    source = mujoco.MjSpec.from_file(str(folder / "panda.xml"))
    for material in source.materials:
        look = {name: getattr(material, name) for name in LOOK}
        spec.add_material(name=PREFIX + material.name, **look)
    shapes = [(body.name, g) for body in source.bodies for g in body.geoms if g.group == SHOWN]
    meshes = {geom.meshname for _, geom in shapes}
    for mesh in source.meshes:
        name = mesh.name or Path(mesh.file).stem
        if name in meshes:
            file = folder / source.meshdir / mesh.file
            spec.add_mesh(name=PREFIX + name, file=str(file.resolve()), scale=mesh.scale)
    for name in {name for name, _ in shapes}:
        for geom in spec.body(name).geoms:
            geom.group = HIDDEN
    for name, geom in shapes:
        spec.body(name).add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=PREFIX + geom.meshname,
            material=PREFIX + geom.material,
            pos=geom.pos,
            quat=geom.quat,
            group=SHOWN,
            contype=0,
            conaffinity=0,
            mass=0,
        )
