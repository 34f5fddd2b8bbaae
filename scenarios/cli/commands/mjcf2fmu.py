"""`panda-cosim mjcf2fmu`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ....fmus.atomic import check_replaceable
from ....fmus.errors import InputError
from ....fmus.sources.model_fmu import ModelOptions, describe, model_fmu
from ....fmus.sources.targets import Target, build_fmu
from ..console import show, warn
from ..options import FmiVersion, Overwrite, Platforms
from .build import platforms


def command(  # noqa: PLR0913 - one for each option
    model: Annotated[Path, typer.Argument(metavar="MODEL.xml", help="MJCF, MJB or URDF file.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="NAME.fmu", help="File to write. Default: MODEL.fmu."),
    ] = None,
    fmi: FmiVersion = "2",
    platform: Platforms = "",
    key: Annotated[
        str, typer.Option("--key", metavar="NAME", help="Keyframe to start from. Default: qpos0.")
    ] = "",
    inputs: Annotated[
        list[str] | None,
        typer.Option(
            "--input",
            metavar="SOURCE",
            help='Further input, such as "body hand force"; may be repeated.',
        ),
    ] = None,
    outputs: Annotated[
        list[str] | None,
        typer.Option(
            "--output",
            metavar="SOURCE",
            help='Further output, such as "body hand xpos" or "site tip jacobian"; may be '
            "repeated.",
        ),
    ] = None,
    parameters: Annotated[
        list[str] | None,
        typer.Option(
            "--parameter",
            metavar="SOURCE",
            help='Further parameter, such as "body hand mass", "qpos" or "geom box friction"; may '
            "be repeated.",
        ),
    ] = None,
    interface: Annotated[
        Path | None,
        typer.Option(
            "--interface",
            metavar="FILE.toml",
            help="Interface file, as written by --print-interface.",
        ),
    ] = None,
    print_interface: Annotated[
        bool, typer.Option("--print-interface", help="Print the interface as TOML and stop.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Make an FMU from any MuJoCo model, without run-time dependencies.

    Inputs are the controls; outputs are the positions, velocities, forces and sensors. Meshes and
    textures are included. Add variables with --input, --output and --parameter, or choose and name
    all of them in the TOML file that --print-interface writes. A SOURCE is one of:

    - input: body NAME force | torque | mocap_pos | mocap_quat; actuator NAME ctrl; qfrc_applied
    - output: body NAME xpos | xquat | xmat | subtree_com | jacobian [JOINT ...]; geom or site NAME
      xpos | xmat | jacobian; joint NAME qpos | qvel; actuator NAME force; sensor NAME;
      mass_matrix [JOINT ...]; contact_bodies BODY BODY ...; any field of mjData, such as qacc
    - parameter: body NAME mass | added_mass | free_xy | free_yaw; geom NAME friction; joint NAME
      qpos | qvel | damping | armature | frictionloss; qpos; qvel; gravity; wind

    ```
    panda-cosim mjcf2fmu humanoid.xml --output "body torso xpos" --parameter "body torso mass"
    panda-cosim mjcf2fmu humanoid.xml --print-interface > humanoid.toml
    panda-cosim mjcf2fmu humanoid.xml --interface humanoid.toml --fmi 3 --out Humanoid.fmu
    ```
    """
    options = ModelOptions(
        key, tuple(inputs or ()), tuple(outputs or ()), tuple(parameters or ()), interface
    )
    if print_interface:
        typer.echo(describe(model, options, warn), nl=False)
        return
    target = out if out is not None else Path(f"{model.stem}.fmu")
    if target.suffix != ".fmu":
        raise InputError(f"--out {target}: must end in .fmu")
    check_replaceable(target, overwrite=overwrite)
    fmu = model_fmu(model, options, target.stem, warn)
    path = build_fmu(fmu, target, Target(fmi=int(fmi), platforms=platforms(platform)))
    show(f"{path}  {path.stat().st_size / 1e6:.2f} MB")
