"""What the tests of FMUs of any MuJoCo model do, in a process of their own, and a model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from panda_cosim.fmus.errors import CosimError
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.master.fmu import FmuSlave
from panda_cosim.fmus.master.system import open_slave
from panda_cosim.fmus.sources.model_fmu import ModelOptions, load, model_fmu
from panda_cosim.fmus.sources.targets import Target, build_fmu

STOP = 1000.0  # [s]
BOX = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="box" pos="0 0 1">
      <freejoint name="free"/>
      <geom name="cube" type="box" size="0.1 0.1 0.1" mass="2"/>
      <site name="tip" pos="0.1 0 0"/>
    </body>
    <body name="post" pos="1 0 0">
      <joint name="turn" axis="0 0 1"/>
      <geom type="capsule" fromto="0 0 0.5 0.4 0 0.5" size="0.02"/>
    </body>
  </worldbody>
  <actuator><motor name="turn" joint="turn" ctrlrange="-1 1"/></actuator>
  <sensor><jointpos name="angle" joint="turn"/><accelerometer name="felt" site="tip"/></sensor>
  <keyframe><key name="turned" qpos="0 0 1 1 0 0 0 0.5" ctrl="0.25"/></keyframe>
</mujoco>
"""


def write(model: Path, out: Path, options: ModelOptions, fmi: int = 2) -> Path:
    """Make an FMU, named after its file."""
    return build_fmu(model_fmu(model, options, out.stem), out, Target(fmi=fmi))


def make(model: str, out: str, fmi: int, **options: Any) -> str:
    """Make an FMU; returns its path, or what was refused."""
    try:
        return str(write(Path(model), Path(out), ModelOptions(**options), fmi))
    except CosimError as error:
        return f"{type(error).__name__}: {error}"


def elements(slave: FmuSlave, *arrays: str) -> list[str]:
    """Scalars of some variables."""
    return [name for array in arrays for name in slave.fmu.variables if _array(name) == array]


def _array(name: str) -> str:
    return name.partition("[")[0]


def steps_alike(path: str, model_path: str, count: int, seed: int) -> list[float]:
    """Step an FMU and MuJoCo with the same random controls.

    Returns:
        Steps until they differ in a bit of qpos or qvel (`count`: never), and how far the model
        has moved.
    """
    model = load(Path(model_path))
    data, source = mujoco.MjData(model), np.random.default_rng(seed)
    slave = open_slave("it", Fmu(Path(path)))
    slave.initialize({}, 0.0, STOP)
    low, high = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange.T, [[-0.3], [0.3]])
    ctrl, state = np.zeros((1, model.nu)), np.zeros((1, model.nq + model.nv))
    put = slave.bind_set(elements(slave, "ctrl"), ctrl)
    get = slave.bind_get(elements(slave, "qpos", "qvel"), state)
    same = 0
    for tick in range(count):
        data.ctrl[:] = ctrl[0] = low + (high - low) * source.random(model.nu)
        put(0)
        slave.step(tick * model.opt.timestep, model.opt.timestep)
        mujoco.mj_step(model, data)
        get(0)
        if state.tobytes() != np.concatenate((data.qpos, data.qvel)).tobytes():
            break
        same += 1
    slave.close()
    return [same, float(np.abs(data.qpos - model.qpos0).max())]


def outputs(path: str, start: dict[str, Any], names: list[str], steps: int) -> list[float]:
    """Start, step, and read some scalars."""
    slave = open_slave("it", Fmu(Path(path)))
    slave.initialize(start, 0.0, STOP)
    for tick in range(steps):
        slave.step(tick * 0.002, 0.002)
    values: list[float] = slave.get_real(names).tolist()
    slave.close()
    return values
