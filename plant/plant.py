"""The plant: one MuJoCo simulation behind two preallocated buffers.

A new output takes a line in `signals.toml` and one in `Plant._values`, and a row in the FMU's
table, `fmus/interface/plant.toml`.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ..assets.fields import Buffer, Vector
from .contacts import ON_TABLE, SUPPORT, UNWANTED, contacts_of, kinds_of
from .parameters import BLOCK, MOVING_LINKS, PlantParameters
from .scene import load_scene, place_block
from .signals import INPUTS, OUTPUTS

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
DIVERGED = "BAD"  # begins the names of the warnings that end a simulation


class DivergenceError(ValueError):
    """The physics has diverged: a state is not finite or is far too large."""


class Plant:
    """Franka Emika Panda, table and block, in MuJoCo at 1 ms.

    Inputs (`inputs`, read by `step`):
        ctrl (8,): servo targets of the arm's joints [rad], and of the gripper, 0 to 255.
        push_force (3,): force on the hand's centre of mass, world frame [N].
        block_force (3,): force on the block's centre, world frame [N].
        torque (7,): torques of the arm's motors, in the scene `motors`; there, ctrl moves
            the gripper alone [N.m].
        link1_force (3,) to link7_force (3,): force on a link's centre of mass, world frame [N].

    Outputs (`outputs`), all at the instant of qpos:
        qpos (16,), qvel (15,): 7 arm joints [rad], 2 fingers [m], then the block:
            centre [m] and quaternion (w, x, y, z); linear velocity in the world frame,
            angular velocity in the block's own frame.
        hand_xpos (3,), hand_xquat (4,): pose of the hand body, world frame, (w, x, y, z).
        target_xpos (3,), target_xmat (9,): centre of the block's top face and its rotation
            matrix, row by row, world frame.
        jac (6, 7): from arm joint velocities to the velocity of the hand body's origin,
            world axes; rows 1-3 linear, 4-6 angular.
        qfrc_bias (7,): gravity, Coriolis and centrifugal forces of the arm's joints [N.m].
        actuator_force (8,): forces that the actuators applied during the last step; 0 at the
            start [N.m, gripper N].
        contact_force (): normal force of the fingers on the block during the last step [N].
        unwanted_contact_force (): normal force, during the last step, of arm and palm on
            anything, of the fingers on anything that cannot move, and on the block's sides (normal
            more than 45 deg from vertical) of anything but the fingers [N].
        support_force (): normal force of the block's other contacts, fingers left out, during the
            last step: what carries it [N].
        table_force (): normal force of the fingers on the table during the last step [N].
        mass_matrix (7, 7): joint-space inertia of the arm with its rotors [kg.m2].

    `PlantSlave` makes one in the FMU's memory. A model of your own becomes an FMU by `mjcf2fmu`.

    The caller may bring the flat buffers of inputs (42,) and outputs (160,). A ValueError refuses
    a block that would start inside something.
    """

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        input_values: Vector | None = None,
        output_values: Vector | None = None,
    ) -> None:
        self.parameters = parameters or PlantParameters()
        self.model: Any = load_scene(self.parameters)
        self.data: Any = mujoco.MjData(self.model)
        inputs, outputs = Buffer(INPUTS, input_values), Buffer(OUTPUTS, output_values)
        self.input_values, self.inputs = inputs.values, inputs.record
        self.output_values, self.outputs = outputs.values, outputs.record
        self._hand = self.model.body("hand").id
        self._block = self.model.body(BLOCK).id
        self._target = self.model.site("target").id
        self._jac = np.zeros((6, self.model.nv))
        self._jac_parts = self._jac[:3], self._jac[3:]  # linear, angular
        self._inertia = np.zeros((self.model.nv, self.model.nv))
        self._contact_force = np.zeros(6)
        self._contact_kinds = kinds_of(self.model)
        self.warnings = self.data.warning.number  # (n,) of the engine, by kind, since the start
        self._sensors = self.data.sensordata
        self._normals = np.zeros(self.model.nsensordata)  # 1 for (normal, tangent, tangent)'s first
        for side in ("left", "right"):
            sensor = self.model.sensor(f"{side}_finger_contact")
            self._normals[sensor.adr[0] : sensor.adr[0] + sensor.dim[0] : 3] = 1.0
        first_link = self.model.body(MOVING_LINKS[0]).id  # the others follow it
        self._links = slice(first_link, first_link + len(MOVING_LINKS))
        self._has_motors = self.model.actuator_biastype[0] == mujoco.mjtBias.mjBIAS_NONE
        self.reset()

    def _values(self) -> dict[str, Vector]:
        """Return the outputs at the instant of qpos, but for sums of contact forces."""
        data = self.data
        return {
            "qpos": data.qpos[:16],  # without the rotors of elastic joints
            "qvel": data.qvel[:15],
            "hand_xpos": data.xpos[self._hand],
            "hand_xquat": data.xquat[self._hand],
            "target_xpos": data.site_xpos[self._target],
            "target_xmat": data.site_xmat[self._target],
            "jac": self._jac[:, :7],
            "qfrc_bias": data.qfrc_bias[:7],
            "actuator_force": data.actuator_force,
            "mass_matrix": self._inertia[:7, :7],
        }

    def reset(self) -> None:
        """Go back to the start: keyframe `home`, with the block where the parameters put it."""
        home = self.model.key("home")
        mujoco.mj_resetDataKeyframe(self.model, self.data, home.id)
        self.input_values[:] = 0.0
        self.inputs["ctrl"] = home.ctrl
        place_block(self.model, self.data, self.parameters)
        self.output_values[:] = 0.0  # as are MuJoCo's forces until a first step
        self._refresh()

    def step(self, ticks: int = 1) -> None:
        """Advance by 1 ms ticks with the inputs held; a `DivergenceError` says when and where."""
        self._apply_inputs()
        for _ in range(ticks):
            # mj_step2 completes the step that mj_step1 began. The mj_step1 in `_refresh` then
            # computes everything that follows from the new positions, so that a tick costs no
            # more than mj_step. Actuator and contact forces remain those of the completed step.
            mujoco.mj_step2(self.model, self.data)
            self._refresh_contacts()
            self._refresh()

    def _apply_inputs(self) -> None:
        """Pass the inputs on to MuJoCo."""
        ctrl, forces = self.data.ctrl, self.data.xfrc_applied[:, :3]
        ctrl[:] = self.inputs["ctrl"]
        if self._has_motors:
            ctrl[:7] = self.inputs["torque"]
        forces[self._hand] = self.inputs["push_force"]
        forces[self._block] = self.inputs["block_force"]
        forces[self._links] = [self.inputs[f"{link}_force"] for link in MOVING_LINKS]

    def _refresh_contacts(self) -> None:
        """Sum contact forces of the last step, before mj_step1 finds new contacts."""
        unwanted = support = on_table = 0.0
        for index, kind in enumerate(contacts_of(self._contact_kinds, self.data)):
            if kind:
                mujoco.mj_contactForce(self.model, self.data, index, self._contact_force)
                force = float(self._contact_force[0])
                unwanted += force if kind & UNWANTED else 0.0
                support += force if kind & SUPPORT else 0.0
                on_table += force if kind & ON_TABLE else 0.0
        self.outputs["unwanted_contact_force"] = unwanted
        self.outputs["support_force"], self.outputs["table_force"] = support, on_table

    def _refresh(self) -> None:
        """Update the outputs to the instant of qpos."""
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        mujoco.mj_jacBody(model, data, *self._jac_parts, self._hand)
        mujoco.mj_fullM(model, data, self._inertia)
        for name, value in self._values().items():
            self.outputs[name] = value
        self.outputs["contact_force"] = mujoco.mju_dot(self._normals, self._sensors)
        for kind in self.warnings.nonzero()[0].tolist():
            name = mujoco.mjtWarning(kind).name[7:]
            if name.startswith(DIVERGED):
                raise DivergenceError(
                    f"the physics diverged at t = {data.time:.3f} s: {name} at index "
                    f"{data.warning[kind].lastinfo} (not finite or above 1e10)"
                )

    def get_state(self) -> Vector:
        """Copy everything that the next step depends on, and the outputs (n,)."""
        physics = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, self.data, physics, STATE)
        return np.concatenate((physics, self.input_values, self.output_values))

    def set_state(self, state: Vector) -> None:
        """Restore what `get_state` returned, so that a replay gives the same bits."""
        size = mujoco.mj_stateSize(self.model, STATE)
        physics, inputs, outputs = np.split(state, (size, size + self.input_values.size))
        mujoco.mj_setState(self.model, self.data, physics, STATE)
        self.input_values[:] = inputs
        self.data.warning.number[:] = 0
        self._refresh()
        self.output_values[:] = outputs  # among them forces of the last step
