"""The law of the published tutorial: PIDs on the joint error that the pseudo-inverse gives."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ..assets.fields import Layout
from .gains import Gains
from .ik import pose_error
from .linalg import cholesky_solve, damped_factor, mat_t_vec
from .pid import PID_STATE, Pid
from .signals import KEPT, Late, Law
from .singularity import manipulability


class TutorialLaw(Law):
    """No joint reference and no limits: ctrl = base_ctrl + PID(pinv(J) e), e the pose error."""

    STATE: ClassVar[Layout] = np.dtype([("pid", PID_STATE), ("poses", float, (KEPT, 7))])

    def set_gains(self, gains: Gains) -> None:
        """Change the gains; allowed between any two updates."""
        super().set_gains(gains)
        self._pid = Pid(gains, self._period, self._state.pid)
        self._poses = Late(self._state.poses, gains.reading_delay, self._period)

    def start(self) -> None:
        """Start with empty PIDs; outputs that this law does not compute are 0."""
        y = self._outputs
        y.qvel_ref[:], y.singular[...], y.limit[:] = 0.0, 0.0, 0.0
        self._pid.reset()
        self._poses.reset(np.concatenate((self._inputs.pos_cmd, self._inputs.quat_cmd)))

    def update(self) -> None:
        """Compute the outputs of one period."""
        x, y = self._inputs, self._outputs
        pose = self._poses.recall(np.concatenate((x.pos_cmd, x.quat_cmd)))
        error = pose_error(pose[:3], pose[3:], x.hand_xpos, x.hand_xquat)
        factor = damped_factor(x.jac, 0.0)
        dq = mat_t_vec(x.jac, cholesky_solve(factor, error))  # pinv(J) e
        y.manipulability[...] = manipulability(factor)
        y.dq[:], y.qpos_ref[:] = dq, x.qpos + dq
        y.ctrl[:7] = self._gains.base_ctrl + self._pid.update(dq)
