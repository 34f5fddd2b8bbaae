"""`panda-cosim build` and `panda-cosim mjcf2fmu`."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import typer

from ...fmus.atomic import check_replaceable, replacing
from ...fmus.build.container import CONTAINER_FILE, write_container
from ...fmus.build.engines import check_engine, known_faults
from ...fmus.build.native import NativeFmu
from ...fmus.build.ssp import write_ssp
from ...fmus.errors import CosimError, InputError
from ...fmus.sources.model_fmu import ModelOptions, describe, model_fmu
from ...fmus.sources.python_fmu import slave_fmu
from ...fmus.sources.targets import Kind, Target
from ...fmus.twins import FMUS
from ...run.written import written_system
from ...study.check.embedding import add_experiment, experiments_of
from ...study.check.experiments import Experiment
from ...task.scenario import Scenario
from ..common import (
    DEFAULT_SCENARIO,
    FMI,
    KIND,
    MUJOCO,
    NAMES,
    OVERWRITE,
    PLATFORM,
    SCALARS,
    FmiVersion,
    Names,
    announce_build,
    announce_python,
    find_scenario,
    target_of,
    values_of,
)
from ..console import show_file, warn
from ..forms import argument, flag, option

SYSTEM_FILE: Final = "Panda.ssp"


def command(  # noqa: PLR0913 - one for each option
    out: Path = option("--out -o DIR", Path()),
    scenario: str = option("--scenario SCENARIO", DEFAULT_SCENARIO),
    container: bool = flag("--container"),
    kind: Kind = KIND,
    fmi: FmiVersion = FMI,
    platform: str = PLATFORM,
    scalars: bool = SCALARS,
    names: Names = NAMES,
    mujoco: str = MUJOCO,
    slave: str = option("--slave FILE.py[:CLASS]", ""),
    overwrite: bool = OVERWRITE,
) -> None:
    """Build the FMUs of a scenario, and Panda.ssp that connects them.

    PandaTrajectory.fmu plays the commands of the scenario. Panda.ssp contains all FMUs, their
    connections and the scenario's parameters; with --fmi 3 it is an SSP 2.0. The scenario may have
    FMUs of its own. Each FMU holds a reference experiment (FMI-LS-REF), driven as in the scenario,
    which `check` runs. `run` needs no `build`: it builds its FMUs itself and keeps them in a cache.
    With --slave, a class written for PythonFMU becomes CLASS.fmu; a machine that runs it needs the
    packages that the class imports.

    ```
    panda-cosim build --out fmus-for-my-tool
    panda-cosim build --scenario calibrated --out with-sensors
    panda-cosim build --fmi 3 --platform linux64,win64 --out fmus-for-all
    panda-cosim run fmus-for-my-tool/Panda.ssp
    panda-cosim build --scenario ./mine --container
    panda-cosim build --slave my_sensor.py:Sensor --fmi 3
    ```

    Args:
        out: Folder to write the files to.
        scenario: Scenario to build: its FMUs, and Panda.ssp with its connections and parameters.
        container: Build only Panda.fmu, which contains the whole system. Needs the extra
            `container`.
        slave: Build only this slave of your own, written for PythonFMU.
    """
    target = target_of(kind, fmi, platform, scalars=scalars, names=names)
    if slave:
        fmu = _slave(slave)
        build = Build({out / f"{fmu.model}.fmu": _made(fmu, target)})
    else:
        chosen = find_scenario(scenario).changed(values_of((), mujoco=mujoco or None))
        if not chosen.is_system:
            announce_build(target)
            announce_python(kind, [name for name in FMUS if name not in chosen.fmus])
        build = (_container_of if container else build_of)(chosen, out, target)
    build.write(overwrite=overwrite)


Make = Callable[[Path], object]  # writes a file


@dataclass(frozen=True)
class Build:
    """Files to write, FMUs with an experiment each, and how the scenario's drive them."""

    files: Mapping[Path, Make]
    experiments: Callable[[], Mapping[Path, Experiment]] = dict  # a scenario is run for them

    def write(self, *, overwrite: bool = False) -> None:
        """Write the files; they replace older ones when all are whole."""
        check_replaceable(*self.files, overwrite=overwrite)
        experiments = self.experiments()
        with ExitStack() as stack:
            for path, make in self.files.items():
                make(new := stack.enter_context(replacing(path)))
                if path.suffix == ".fmu":
                    _complete(new, path, experiments.get(path))
        for path in self.files:
            show_file(path)


def _complete(new: Path, path: Path, experiment: Experiment | None) -> None:
    """Add a reference experiment to a new FMU, which will be at the path, if it can be run."""
    try:
        add_experiment(new, experiment)
    except CosimError as error:
        reason = str(error).replace(str(new), str(path))
        warn(f"{path}: holds no reference experiment, as it cannot be run here: {reason}")


def _made(fmu: NativeFmu, target: Target) -> Make:
    return lambda path: path.write_bytes(target.make(fmu))


def _slave(slave: str) -> NativeFmu:
    """Describe the FMU of a class for PythonFMU, FILE.py or FILE.py:CLASS."""
    file, suffix, name = slave.rpartition(".py")  # a folder may be .pyenv
    if not suffix or (name and not name.startswith(":")):
        raise InputError(f"--slave {slave!r}: must be FILE.py or FILE.py:CLASS")
    return slave_fmu(Path(f"{file}.py"), name[1:])


def build_of(scenario: Scenario, out: Path, target: Target) -> Build:
    """Build a scenario as FMUs, one of which plays its inputs, and Panda.ssp."""
    system = written_system(scenario, target)
    paths = {name: out / each.file_name for name, each in system.components.items()}
    files: dict[Path, Make] = {
        path: partial(shutil.copyfile, system.components[name].file) for name, path in paths.items()
    }
    files[out / SYSTEM_FILE] = partial(write_ssp, system=system)
    return Build(files, lambda: {paths[n]: each for n, each in experiments_of(scenario).items()})


def _container_of(scenario: Scenario, out: Path, target: Target) -> Build:
    """Build a scenario as one FMU."""
    system = written_system(scenario, replace(target, fmi=2))
    return Build({out / CONTAINER_FILE: partial(write_container, system=system, fmi=target.fmi)})


def mjcf2fmu(  # noqa: PLR0913 - one for each option
    models: list[Path] = argument("MODEL.xml..."),
    out: Path | None = option("--out -o PATH"),
    fmi: FmiVersion = FMI,
    platform: str = PLATFORM,
    scalars: bool = SCALARS,
    names: Names = NAMES,
    mujoco: str = MUJOCO,
    step: float = option("--step SECONDS", 0.0),
    key: str = option("--key NAME", ""),
    inputs: list[str] | None = option("--input SOURCE"),
    outputs: list[str] | None = option("--output SOURCE"),
    parameters: list[str] | None = option("--parameter SOURCE"),
    interface: Path | None = option("--interface FILE.toml"),
    print_interface: bool = flag("--print-interface"),
    overwrite: bool = OVERWRITE,
) -> None:
    """Build an FMU from any MuJoCo model, without run-time dependencies.

    Inputs are the controls; outputs are the positions, velocities, forces and sensors. Meshes and
    textures are included. Add variables with --input, --output and --parameter, or choose and name
    all of them in the TOML file that --print-interface writes. A SOURCE is one of:

    - input: body NAME force | torque | mocap_pos | mocap_quat; actuator NAME ctrl; equality NAME
      active; qfrc_applied
    - output: body NAME xpos | xquat | xmat | subtree_com | cvel | jacobian [JOINT ...]; geom or
      site NAME xpos | xmat | jacobian; joint NAME qpos | qvel | qacc; tendon NAME length |
      velocity; actuator NAME force | length | velocity; sensor NAME; mass_matrix [JOINT ...];
      contact_bodies BODY BODY ...; any field of mjData, such as qacc
    - parameter: body NAME mass | added_mass | free_xy | free_yaw; geom NAME friction; joint NAME
      qpos | qvel | damping | armature | frictionloss; actuator NAME gain | bias; equality NAME
      solref | solimp | data; qpos; qvel; gravity; wind; keyframe

    An object without a name has its number: "sensor #2" is the second sensor.

    ```
    panda-cosim mjcf2fmu humanoid.xml --output "body torso xpos" --parameter "body torso mass"
    panda-cosim mjcf2fmu humanoid.xml --print-interface > humanoid.toml
    panda-cosim mjcf2fmu humanoid.xml --interface humanoid.toml --fmi 3 --out Humanoid.fmu
    panda-cosim mjcf2fmu humanoid.xml ant.xml --step 0.001 --names flat
    panda-cosim mjcf2fmu humanoid.xml --mujoco 3.11.0
    ```

    Args:
        models: MJCF, MJB or URDF files.
        out: File NAME.fmu to write, or a folder. Default: MODEL.fmu in this folder.
        step: Internal step. Default: the model's own.
        key: Keyframe to start from. Default: qpos0.
        inputs: Further input, such as "body hand force"; may be repeated.
        outputs: Further output, such as "body hand xpos" or "site tip jacobian"; may be repeated.
        parameters: Further parameter, such as "body hand mass" or "geom box friction"; may be
            repeated.
        interface: Interface file, as written by --print-interface.
        print_interface: Print the interface as TOML and stop.
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
    fmus = {path: model_fmu(model, options, path.stem, warn) for model, path in paths.items()}
    Build({path: _made(fmu, target) for path, fmu in fmus.items()}).write(overwrite=overwrite)
    for path in paths.values():
        for fault in known_faults(path):
            warn(f"{path}: {fault}")


def _paths(models: Sequence[Path], out: Path | None) -> dict[Path, Path]:
    """Where the FMU of each model is written."""
    place = out or Path()
    is_file = place.suffix == ".fmu"
    paths = {model: place if is_file else place / f"{model.stem}.fmu" for model in models}
    if len({*paths.values()}) < len(models):
        raise InputError(
            f"{len(models)} models: --out must be a folder, and their file names must differ"
        )
    return paths
