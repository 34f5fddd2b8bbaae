"""The plant's object: one MuJoCo simulation behind two preallocated buffers."""

from __future__ import annotations

import ctypes
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assets.calls import bind
from .scene import PlantParameters, load_scene, place_block

__all__ = ["INPUTS", "OUTPUTS", "DivergenceError", "Plant", "PlantParameters"]


# What the plant takes and gives; the fields' order is that of the flat buffers.
INPUTS = np.dtype([("ctrl", float, 8), ("push_force", float, 3)])
OUTPUTS = np.dtype(
    [
        ("qpos", float, 16),
        ("qvel", float, 15),
        ("hand_xpos", float, 3),
        ("hand_xquat", float, 4),
        ("target_xpos", float, 3),
        ("target_xmat", float, 9),
        ("jac", float, (6, 7)),
        ("qfrc_bias", float, 7),
        ("actuator_force", float, 8),
        ("contact_force", float),
    ]
)
N_INPUTS, N_OUTPUTS = INPUTS.itemsize // 8, OUTPUTS.itemsize // 8
N_FORCES = 9  # the last outputs: forces of the step that ends now
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
DIVERGED = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)


class DivergenceError(ValueError):
    """The physics has diverged: a state is not finite or unreasonably large."""


class Plant:
    """Franka Emika Panda, table and block, in MuJoCo at 1 ms.

    Inputs (`inputs`, read by `step`):
        ctrl (8,): servo targets of the arm's joints [rad], and of the gripper, 0 to 255.
        push_force (3,): force on the hand's centre of mass, world frame [N].

    Outputs (`outputs`): all of one instant, that of qpos.
        qpos (16,), qvel (15,): 7 arm joints [rad], 2 fingers [m], then the block:
            centre [m] and quaternion (w, x, y, z); linear velocity in the world frame,
            angular velocity in the block's own frame.
        hand_xpos (3,), hand_xquat (4,): pose of the hand body, world frame, (w, x, y, z).
        target_xpos (3,), target_xmat (9,): centre of the block's top face and its rotation
            matrix, row by row, world frame.
        jac (6, 7): from arm joint velocities to the velocity of the hand body's origin,
            world axes; rows 1-3 linear, 4-6 angular.
        qfrc_bias (7,): gravity, Coriolis and centrifugal forces of the arm's joints [N.m].
        actuator_force (8,), contact_force (): what the actuators applied and with what
            normal force the fingers pressed on the block over the step that ends now
            (0 at the start) [N.m, gripper N; N].

    Args:
        parameters: Scene and block.
        input_values: Buffer (11,) to read inputs from; None: a new one.
        output_values: Buffer (108,) to leave outputs in; None: a new one.

    Raises:
        ValueError: A parameter is out of range, or the block starts inside something.
    """

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        input_values: NDArray[np.float64] | None = None,
        output_values: NDArray[np.float64] | None = None,
    ) -> None:
        self.parameters = parameters or PlantParameters()
        self.model: Any = load_scene(self.parameters)
        self.data: Any = mujoco.MjData(self.model)
        self.input_values = np.zeros(N_INPUTS) if input_values is None else input_values
        self.output_values = np.zeros(N_OUTPUTS) if output_values is None else output_values
        self.inputs = self.input_values.view(INPUTS)[0]
        self.outputs = self.output_values.view(OUTPUTS)[0]
        self._bind()
        self.reset()

    def _bind(self) -> None:
        """Take views of everything that a step touches, once."""
        model, data = self.model, self.data
        hand, target = model.body("hand").id, model.site("target").id
        jac = np.zeros((6, model.nv))
        self._see_jacobian = bind("mj_jacBody", model, data, jac[:3], jac[3:], hand)
        # Copies are made between memory views, which takes a third of the time of numpy's.
        # The outputs' parts in their order; one call joins them, see `_refresh`.
        self._parts = [
            part.data
            for part in (
                data.qpos,
                data.qvel,
                data.xpos[hand],
                data.xquat[hand],
                data.site_xpos[target],
                data.site_xmat[target],
                *jac[:, :7],
                data.qfrc_bias[:7],
                data.actuator_force,
            )
        ]
        self._joined = self.output_values[:-1].data.cast("B")
        self._contact_force = self.output_values[-1:].data
        self._ctrl = self.inputs["ctrl"].data
        self._push = self.inputs["push_force"].data
        self._data_ctrl = data.ctrl.data
        self._data_push = data.xfrc_applied[hand, :3].data
        # A contact sensor gives (normal, tangent, tangent) for each contact found.
        normals = np.zeros(model.nsensordata)
        for side in ("left", "right"):
            sensor = model.sensor(f"{side}_finger_contact")
            normals[sensor.adr[0] : sensor.adr[0] + sensor.dim[0] : 3] = 1.0
        self._press = bind(
            "mju_dot", normals, data.sensordata, normals.size, result=ctypes.c_double
        )
        self._warnings = data.warning.number.data
        self._no_warnings = np.zeros_like(data.warning.number).data

    def reset(self) -> None:
        """Go back to the start: keyframe `home`, the block where the parameters say.

        Raises:
            ValueError: The block would start inside something.
        """
        home = self.model.key("home")
        mujoco.mj_resetDataKeyframe(self.model, self.data, home.id)
        self.input_values[:] = 0.0
        self.inputs["ctrl"] = home.ctrl
        place_block(self.model, self.data, self.parameters)
        self.data.qacc_warmstart[:] = 0.0
        self._refresh()
        self.outputs["actuator_force"] = 0.0
        self.outputs["contact_force"] = 0.0

    def step(self, ticks: int = 1) -> None:
        """Advance by a number of 1 ms ticks with the inputs held; leave fresh outputs.

        Args:
            ticks: Number of internal steps.

        Raises:
            DivergenceError: The physics has diverged; says when and what.
        """
        model, data = self.model, self.data
        self._data_ctrl[:] = self._ctrl
        self._data_push[:] = self._push
        for _ in range(ticks):
            # mj_step2 ends the step that mj_step1 has begun; the next mj_step1 then makes
            # all that derives from the new positions, at the price of one mj_step. It leaves
            # alone what belongs to the step that ended: actuator and contact forces.
            mujoco.mj_step2(model, data)
            self._refresh()

    def _refresh(self) -> None:
        """Bring the outputs up to the instant of qpos."""
        mujoco.mj_step1(self.model, self.data)
        self._see_jacobian()
        self._joined[:] = b"".join(self._parts)
        self._contact_force[0] = self._press()
        if self._warnings != self._no_warnings:
            self._refuse_divergence()

    def _refuse_divergence(self) -> None:
        """Raise what MuJoCo has counted as a warning, if it means divergence."""
        for kind in DIVERGED:
            if self._warnings[kind]:
                index = self.data.warning[int(kind)].lastinfo
                raise DivergenceError(
                    f"the physics diverged at t = {self.data.time:.3f} s: {kind.name[7:]} "
                    f"at index {index} (not finite or above 1e10)"
                )

    @property
    def time(self) -> float:
        """Simulated time since the start [s]."""
        return float(self.data.time)

    def get_state(self) -> NDArray[np.float64]:
        """Copy all that the next step depends on, and the forces of the last one.

        Returns:
            State (n,), to be given to `set_state` of a plant with the same parameters.
        """
        physics = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, self.data, physics, STATE)
        state: NDArray[np.float64] = np.concatenate(
            (physics, self.input_values, self.output_values[-N_FORCES:])
        )
        return state

    def set_state(self, state: NDArray[np.float64]) -> None:
        """Restore a state so that a replay gives the same bits.

        Args:
            state: What `get_state` returned (n,).

        Raises:
            ValueError: The state has another size.
        """
        size = mujoco.mj_stateSize(self.model, STATE)
        if state.shape != (size + N_INPUTS + N_FORCES,):
            raise ValueError(f"state: shape {state.shape} is not ({size + N_INPUTS + N_FORCES},)")
        mujoco.mj_setState(self.model, self.data, state[:size], STATE)
        self.input_values[:] = state[size : size + N_INPUTS]
        self.data.warning.number[:] = 0
        self._refresh()
        self.output_values[-N_FORCES:] = state[size + N_INPUTS :]
