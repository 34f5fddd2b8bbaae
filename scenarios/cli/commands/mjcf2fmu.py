"""`panda-cosim mjcf2fmu`."""

from __future__ import annotations

from pathlib import Path

import typer

from ....fmus.atomic import check_replaceable
from ....fmus.errors import InputError
from ....fmus.sources.model_fmu import ModelOptions, describe, model_fmu
from ....fmus.sources.targets import build_fmu
from ..console import show_file, warn
from ..options import FMI, OVERWRITE, PLATFORM, FmiVersion, argument, option, target_of


def command(  # noqa: PLR0913 - one for each option
    model: Path = argument("MODEL.xml", "MJCF, MJB or URDF file."),
    out: Path | None = option("--out -o NAME.fmu", "File to write. Default: MODEL.fmu."),
    fmi: FmiVersion = FMI,
    platform: str = PLATFORM,
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
    path = out if out is not None else Path(f"{model.stem}.fmu")
    if path.suffix != ".fmu":
        raise InputError(f"--out {path}: must end in .fmu")
    check_replaceable(path, overwrite=overwrite)
    fmu = model_fmu(model, options, path.stem, warn)
    show_file(build_fmu(fmu, path, target_of("native", fmi, platform)))
