"""The control law in C behind ctypes, and what it is compared with."""

import ctypes
import subprocess
from dataclasses import fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from fmu_instance import mujoco_library
from panda_cosim.assets.franka import ROBOTS
from panda_cosim.controller.controller import STATE, Controller
from panda_cosim.controller.gains import RANGES, REACTIONS, Gains
from panda_cosim.controller.model import load_arm
from panda_cosim.controller.signals import INPUTS, OUTPUTS
from panda_cosim.fmus.build.libraries import BACKENDS, FLAGS, SOURCES
from panda_cosim.task.rotations import Array

CHOICES = {"reaction": REACTIONS, "robot": (*ROBOTS,)}

# controller_functions of controller_law.h
FUNCTIONS = (
    "mju_subQuat", "mju_rotVecQuat", "mju_norm3", "mju_normalize", "mju_mulMatVec",
    "mju_mulMatTVec", "mju_mulMatMatT", "mju_mulMatTMat", "mju_cholFactor", "mju_cholSolve",
    "mju_boxQP", "mj_kinematics", "mj_comPos", "mj_makeM", "mj_mulM",
    "mj_comVel", "mj_rne", "mj_factorM", "mj_solveM",
)  # fmt: skip

# The struct `controller` of controller_law.h: doubles only.
GAINS = np.dtype(
    [(f.name, float, np.shape(f.default) if f.name in RANGES else ()) for f in fields(Gains)]
)
NAMES = ("inputs", "outputs", "gains", "period", "state")
LAYOUT = np.dtype(list(zip(NAMES, (INPUTS, OUTPUTS, GAINS, float, STATE), strict=True)))


LAW = [name for name in BACKENDS["controller"] if name.startswith("controller")]


def compile_law(folder: Path) -> Path:
    """Compile the law, without any FMI layer; returns the library."""
    library = folder / "law.so"
    includes = Path(mujoco.__file__).parent / "include"
    options = (*FLAGS, "-shared", "-fPIC", "-fvisibility=default", f"-isystem{includes}")
    command = ["cc", *options, *LAW, "-lm", "-o", str(library)]
    subprocess.run(command, cwd=SOURCES, check=True, timeout=300)
    return library


class LawInC:
    """The law in C with the members of `Controller` that the tests need.

    Args:
        library: The compiled law.
        gains: Gains.
        period: Time between two updates [s].
    """

    def __init__(self, library: Path, gains: Gains, period: float = 0.001) -> None:
        self._law = ctypes.CDLL(str(library))
        self._arm: Any = load_arm(robot=gains.robot)
        self._data: Any = mujoco.MjData(self._arm)
        engine = ctypes.CDLL(str(mujoco_library()))
        self._mujoco = (ctypes.c_void_p * (len(FUNCTIONS) + 2))(
            *(ctypes.cast(engine[name], ctypes.c_void_p) for name in FUNCTIONS),
            self._arm._address,
            self._data._address,
        )
        self.values = np.zeros(LAYOUT.itemsize // 8)
        record = self.values.view(LAYOUT)
        self._controller = self.values.ctypes.data_as(ctypes.c_void_p)
        self._gains = record["gains"]
        self.input_values, self.output_values, self.state_values = (
            record[name].view(float).reshape(-1) for name in ("inputs", "outputs", "state")
        )
        self.inputs, self.outputs = record[0]["inputs"], record[0]["outputs"]
        record["period"] = period
        self.gains = gains
        self._law.controller_reset(self._controller)

    @property
    def gains(self) -> Gains:
        """Gains and switches."""
        return self._set_gains

    @gains.setter
    def gains(self, gains: Gains) -> None:
        """Gains and switches."""
        self._set_gains = gains
        for name in GAINS.names or ():
            value = getattr(gains, name)
            self._gains[name] = 1 + CHOICES[name].index(value) if name in CHOICES else value

    def update(self) -> None:
        """Compute the outputs of one period from the inputs."""
        self._law.controller_update(self._controller, self._mujoco)


def replay(law: Controller | LawInC, rows: Array) -> Array:
    """Return the outputs for each row of inputs."""
    outputs = np.empty((len(rows), law.output_values.size))
    for row, out in zip(rows, outputs, strict=True):
        law.input_values[:] = row
        law.update()
        out[:] = law.output_values
    return outputs
