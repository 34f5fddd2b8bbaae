"""`panda-cosim mjcf2fmu`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import typer

from ....fmus.atomic import check_replaceable
from ....fmus.build.engines import check_engine
from ....fmus.errors import InputError
from ....fmus.sources.model_fmu import ModelOptions, describe, model_fmu
from ....fmus.sources.targets import build_fmu
from ..console import show_file, warn
from ..options import (
    FMI,
    MUJOCO,
    NAMES,
    OVERWRITE,
    PLATFORM,
    SCALARS,
    FmiVersion,
    Names,
    argument,
    option,
    target_of,
)
from .build import put_reference


def command(  # noqa: PLR0913 - one for each option
    models: list[Path] = argument("MODEL.xml...", "MJCF, MJB or URDF files."),
    out: Path | None = option(
        "--out -o PATH",
        "File NAME.fmu to write, or a folder. Default: MODEL.fmu in this folder.",
    ),
    fmi: FmiVersion = FMI,
    platform: str = PLATFORM,
    scalars: bool = SCALARS,
    names: Names = NAMES,
    mujoco: str = MUJOCO,
    step: float = option("--step SECONDS", "Internal step. Default: the model's own.", 0.0),
    key: str = option("--key NAME", "Keyframe to start from. Default: qpos0.", ""),
    inputs: list[str] | None = option(
        "--input SOURCE", 'Further input, such as "body hand force"; may be repeated.'
    ),
    outputs: list[str] | None = option(
        "--output SOURCE",
        'Further output, such as "body hand xpos" or "site tip jacobian"; may be repeated.',
    ),
    parameters: list[str] | None = option(
        "--parameter SOURCE",
        'Further parameter, such as "body hand mass", "qpos" or "geom box friction"; may be '
        "repeated.",
    ),
    interface: Path | None = option(
        "--interface FILE.toml", "Interface file, as written by --print-interface."
    ),
    print_interface: bool = option(
        "--print-interface", "Print the interface as TOML and stop.", False
    ),
    overwrite: bool = OVERWRITE,
) -> None:
    """Build an FMU from any MuJoCo model, without run-time dependencies.

    Inputs are the controls; outputs are the positions, velocities, forces and sensors. Meshes and
    textures are included. Add variables with --input, --output and --parameter, or choose and name
    all of them in the TOML file that --print-interface writes. A SOURCE is one of:

    - input: body NAME force | torque | mocap_pos | mocap_quat; actuator NAME ctrl; qfrc_applied
    - output: body NAME xpos | xquat | xmat | subtree_com | jacobian [JOINT ...]; geom or site NAME
      xpos | xmat | jacobian; joint NAME qpos | qvel; actuator NAME force; sensor NAME;
      mass_matrix [JOINT ...]; contact_bodies BODY BODY ...; any field of mjData, such as qacc
    - parameter: body NAME mass | added_mass | free_xy | free_yaw; geom NAME friction; joint NAME
      qpos | qvel | damping | armature | frictionloss; actuator NAME gain | bias; equality NAME
      solref | solimp | data; qpos; qvel; gravity; wind; keyframe

    ```
    panda-cosim mjcf2fmu humanoid.xml --output "body torso xpos" --parameter "body torso mass"
    panda-cosim mjcf2fmu humanoid.xml --print-interface > humanoid.toml
    panda-cosim mjcf2fmu humanoid.xml --interface humanoid.toml --fmi 3 --out Humanoid.fmu
    panda-cosim mjcf2fmu humanoid.xml ant.xml --step 0.001 --names flat
    panda-cosim mjcf2fmu humanoid.xml --mujoco 3.11.0
    ```
    """
    given = (tuple(inputs or ()), tuple(outputs or ()), tuple(parameters or ()))
    options = ModelOptions(key, *given, interface, step)
    if print_interface:
        for model in models:
            typer.echo(describe(model, options, warn), nl=False)
        return
    target = target_of("native", fmi, platform, scalars=scalars, names=names)
    target = replace(target, mujoco=check_engine(mujoco))
    paths = _paths(models, out)
    check_replaceable(*paths.values(), overwrite=overwrite)
    fmus = {path: model_fmu(model, options, path.stem, warn) for model, path in paths.items()}
    for path, fmu in fmus.items():
        build_fmu(fmu, path, target)
        put_reference(path)
        show_file(path)


def _paths(models: Sequence[Path], out: Path | None) -> dict[Path, Path]:
    """Where the FMU of each model is written."""
    folder = out or Path()
    if folder.suffix == ".fmu" and len(models) == 1:
        return {models[0]: folder}
    paths = {model: folder / f"{model.stem}.fmu" for model in models}
    if len(set(paths.values())) < len(models) or folder.suffix == ".fmu":
        raise InputError(
            f"{len(models)} models: --out must be a folder, and their file names must differ"
        )
    return paths
