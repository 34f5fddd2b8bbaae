"""The plant: one MuJoCo simulation behind two preallocated buffers.

A new output takes a line in `OUTPUTS` and one in `Plant._values`, and a row in the FMU's table,
`fmus/interface/plant.py`.

Contacts are of kinds: unwanted ones, and those that support the block. Each shape has a
rank, and the higher rank of the two decides: the arm and its palm should touch nothing; fingers
nothing that cannot move, such as table, floor and walls; and the block, apart from these, should be
touched from above or below.
"""

from __future__ import annotations

import math
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from .parameters import ARM_AND_PALM, BLOCK, FINGERS, MOVING_LINKS, TABLE, PlantParameters
from .scene import load_scene, place_block

UPRIGHT: Final = math.sqrt(0.5)  # vertical part of a normal that is 45 deg from vertical

# Kinds of contacts, as bits.
UNWANTED: Final = 1
SUPPORT: Final = 2  # of the block
ON_TABLE: Final = 4  # of a finger
_OF_BLOCK: Final = 8  # UNWANTED or SUPPORT, by the normal

_FIXED, _BLOCK, _FINGER, _ARM = 1, 2, 3, 4  # ranks; 0: anything else that moves

Kinds = list[list[int]]


def kinds_of(model: Any) -> Kinds:
    """Return the kind of contact that two geoms make, [first][second]."""
    # In lists, as numpy would take longer to look up the few contacts of a step.
    rank = np.where(model.body_weldid[model.geom_bodyid] == 0, _FIXED, 0)
    for names, value in (((BLOCK,), _BLOCK), (FINGERS, _FINGER), (ARM_AND_PALM, _ARM)):
        rank[_belongs(model, names)] = value
    high, low = np.maximum.outer(rank, rank), np.minimum.outer(rank, rank)
    unwanted = (high == _ARM) | ((high == _FINGER) & (low == _FIXED))
    on_table = (high == _FINGER) & np.logical_or.outer(*[_belongs(model, (TABLE,))] * 2)
    kinds = UNWANTED * unwanted + ON_TABLE * on_table + _OF_BLOCK * (high == _BLOCK)
    lists: Kinds = kinds.tolist()
    return lists


def _belongs(model: Any, names: tuple[str, ...]) -> Any:
    """Whether each geom belongs to one of the bodies (ngeom,)."""
    bodies = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in names]
    return np.isin(model.geom_bodyid, bodies)


def contacts_of(kinds: Kinds, data: Any) -> list[int]:
    """Return the kind of each present contact: bits, or 0."""
    contact = data.contact
    present = [kinds[first][second] for first, second in contact.geom.tolist()]
    if _OF_BLOCK in present:
        for index, up in enumerate(contact.frame[:, 2].tolist()):
            if present[index] == _OF_BLOCK:
                present[index] = SUPPORT if abs(up) >= UPRIGHT else UNWANTED
    return present


__all__ = ["INPUTS", "OUTPUTS", "DivergenceError", "Plant", "PlantParameters"]


# What the plant takes and gives; the fields' order is that of the flat buffers.
INPUTS = np.dtype(
    [
        ("ctrl", float, 8),
        ("push_force", float, 3),
        ("block_force", float, 3),
        ("torque", float, 7),
        *((f"{link}_force", float, 3) for link in MOVING_LINKS),
    ]
)
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
        ("unwanted_contact_force", float),
        ("support_force", float),
        ("table_force", float),
        ("mass_matrix", float, (7, 7)),
    ]
)
N_INPUTS, N_OUTPUTS = INPUTS.itemsize // 8, OUTPUTS.itemsize // 8
N_FORCES = 12  # actuator_force to table_force, before mass_matrix; they belong to the last step
FORCES = slice(N_OUTPUTS - 49 - N_FORCES, N_OUTPUTS - 49)
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
DIVERGED = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)


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

    The caller may bring the flat buffers of inputs (42,) and outputs (160,). A ValueError refuses
    a block that would start inside something.
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
        self._hand = self.model.body("hand").id
        self._block = self.model.body(BLOCK).id
        self._target = self.model.site("target").id
        self._jac = np.zeros((6, self.model.nv))
        self._jac_parts = self._jac[:3], self._jac[3:]  # linear, angular
        self._inertia = np.zeros((self.model.nv, self.model.nv))
        self._contact_force = np.zeros(6)
        self._contact_kinds = kinds_of(self.model)
        self._warnings = self.data.warning.number  # (n,) counts, by kind
        self._sensors = self.data.sensordata
        self._normals = np.zeros(self.model.nsensordata)  # 1 for (normal, tangent, tangent)'s first
        for side in ("left", "right"):
            sensor = self.model.sensor(f"{side}_finger_contact")
            self._normals[sensor.adr[0] : sensor.adr[0] + sensor.dim[0] : 3] = 1.0
        record = self.output_values.view(OUTPUTS)  # (1,)
        self._grip_sum = record["contact_force"]
        self._unwanted_sum, self._support_sum, self._table_sum = (
            record[name] for name in ("unwanted_contact_force", "support_force", "table_force")
        )
        forces = self.data.xfrc_applied[:, :3]
        first_link = self.model.body(MOVING_LINKS[0]).id  # the others follow it
        links = slice(first_link, first_link + len(MOVING_LINKS))
        self._passed_on = [
            (self.data.ctrl, self.inputs["ctrl"]),
            (forces[self._hand], self.inputs["push_force"]),
            (forces[self._block], self.inputs["block_force"]),
            (forces[links], self.input_values[-3 * len(MOVING_LINKS) :].reshape(-1, 3)),
        ]
        if self.model.actuator_biastype[0] == mujoco.mjtBias.mjBIAS_NONE:  # motors
            self._passed_on.append((self.data.ctrl[:7], self.inputs["torque"]))
        self.reset()

    def _values(self) -> dict[str, NDArray[np.float64]]:
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
        self.data.qacc_warmstart[:] = 0.0
        self._refresh()
        self.output_values[FORCES] = 0.0

    def step(self, ticks: int = 1) -> None:
        """Advance by 1 ms ticks with the inputs held; a `DivergenceError` says when and where."""
        for place, value in self._passed_on:
            place[...] = value
        for _ in range(ticks):
            # mj_step2 completes the step that mj_step1 began. The mj_step1 in `_refresh` then
            # computes everything that follows from the new positions, so that a tick costs no
            # more than mj_step. Actuator and contact forces remain those of the completed step.
            mujoco.mj_step2(self.model, self.data)
            self._refresh_contacts()
            self._refresh()

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
        self._unwanted_sum[0], self._support_sum[0] = unwanted, support
        self._table_sum[0] = on_table

    def _refresh(self) -> None:
        """Update the outputs to the instant of qpos."""
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        mujoco.mj_jacBody(model, data, *self._jac_parts, self._hand)
        mujoco.mj_fullM(model, data, self._inertia)
        for name, value in self._values().items():
            self.outputs[name] = value
        self._grip_sum[0] = mujoco.mju_dot(self._normals, self._sensors)
        for kind in DIVERGED if np.count_nonzero(self._warnings) else ():
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
        """Copy everything that the next step depends on, and the forces of the last step (n,)."""
        physics = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, self.data, physics, STATE)
        state: NDArray[np.float64] = np.concatenate(
            (physics, self.input_values, self.output_values[FORCES])
        )
        return state

    def set_state(self, state: NDArray[np.float64]) -> None:
        """Restore what `get_state` returned, so that a replay gives the same bits."""
        size = mujoco.mj_stateSize(self.model, STATE)
        mujoco.mj_setState(self.model, self.data, state[:size], STATE)
        self.input_values[:] = state[size : size + N_INPUTS]
        self.data.warning.number[:] = 0
        self._refresh()
        self.output_values[FORCES] = state[size + N_INPUTS :]
