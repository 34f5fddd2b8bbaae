"""The Franka Hand: its commands, each of which goes on until the fingers are at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ...assets import STEP_SIZE
from ...assets.franka import (
    CTRL_OPEN,
    FINGER_SPEED_MAX,
    GRIP_FORCE_MAX,
    GRIP_STIFFNESS,
    OPENING_MAX,
)
from ..model import Vector
from .line import Request, Service
from .wire import GRIPPER_STATE, GripperStatus

MOST_SPEED: Final = 2.0 * FINGER_SPEED_MAX  # [m/s] of the opening
CLOSEST: Final = 2e-3  # [m] a move that ends farther off was not successful
STILL: Final = 2e-6  # [m] that the opening may change within a tick at rest
REST: Final = 50  # ticks of rest after which a command has ended
LEAST_FORCE: Final = 1.0  # [N] of a finger, which moves it at all
LONGEST: Final = 5000  # ticks after which it has in any case
TEMPERATURE: Final = 30  # [deg C]


@dataclass
class Job:
    """A command that goes on."""

    request: Request
    low: float  # [m] openings with which it is successful
    high: float
    goal: float  # [m]
    speed: float  # [m/s] of the opening
    force: float = math.inf  # [N] with which each finger presses at most
    ticks: int = 0
    rest: int = 0  # ticks


class Gripper:
    """Moves the fingers' target, and answers once they are at rest."""

    def __init__(self) -> None:
        self.service: Service
        self._job: Job | None = None
        self._target = self._width = OPENING_MAX
        self._is_grasped = False
        self._state = np.zeros(1, GRIPPER_STATE)[0]
        self._state["max_width"], self._state["temperature"] = OPENING_MAX, TEMPERATURE

    @property
    def is_busy(self) -> bool:
        """Whether a command goes on."""
        return self._job is not None

    @property
    def ctrl(self) -> float:
        """The servo's target, 0 (closed) to 255 (open)."""
        return CTRL_OPEN * min(max(self._target / OPENING_MAX, 0.0), 1.0)

    # What a client asks for.

    def connect(self, request: Request) -> None:
        """Agree on the version, and send states from now on."""
        self.service.agree(request)
        self.send_state()

    def homing(self, request: Request) -> None:
        """Open the fingers wide."""
        self._begin(Job(request, 0.0, math.inf, OPENING_MAX, MOST_SPEED))

    def move(self, request: Request) -> None:
        """Move the fingers to an opening."""
        width, speed = request.body.item()
        if _is_valid(request, width, speed):
            self._begin(Job(request, width - CLOSEST, width + CLOSEST, width, speed))

    def grasp(self, request: Request) -> None:
        """Close the fingers until something stops them, then press."""
        width, inner, outer, speed, force = request.body.item()
        if _is_valid(request, width, speed):
            pressing = min(max(0.5 * force, LEAST_FORCE), GRIP_FORCE_MAX)
            self._begin(Job(request, width - inner, width + outer, 0.0, speed, pressing))

    def stop(self, request: Request) -> None:
        """Stop where the fingers are."""
        self._abort()
        self._target = self._width
        request.answer(GripperStatus.SUCCESS)

    def leave(self) -> None:
        """Forget what a client that has gone had asked for."""
        self._job = None

    # What follows in each tick.

    def tick(self, fingers: Vector) -> None:
        """Move the target, and end a command if the fingers (2,) [m] are at rest."""
        width, before = float(fingers.sum()), self._width
        self._width = width
        if self._job is not None:
            self._advance(self._job, abs(width - before) < STILL)

    def _advance(self, job: Job, is_still: bool) -> None:
        goal = max(job.goal, self._width - 2.0 * job.force / GRIP_STIFFNESS)
        step = min(job.speed, MOST_SPEED) * STEP_SIZE
        self._target += min(max(goal - self._target, -step), step)
        job.ticks += 1
        job.rest = job.rest + 1 if is_still and abs(goal - self._target) < STILL else 0
        if job.rest == REST or job.ticks == LONGEST:
            self._end(job)

    def _end(self, job: Job) -> None:
        is_successful = job.low < self._width < job.high
        self._job, self._is_grasped = None, is_successful and job.force < math.inf
        self.send_state()
        job.request.answer(GripperStatus.SUCCESS if is_successful else GripperStatus.UNSUCCESSFUL)

    def _begin(self, job: Job) -> None:
        self._abort()
        self._job, self._is_grasped = job, False

    def _abort(self) -> None:
        if self._job is not None:
            self._job.request.answer(GripperStatus.ABORTED)
        self._job = None

    def send_state(self) -> None:
        """Tell the client, if there is one, how the fingers are."""
        state = self._state
        state["message_id"] += 1
        state["width"], state["is_grasped"] = self._width, self._is_grasped
        if self.service.client:
            self.service.client.send(state.tobytes())


def _is_valid(request: Request, width: float, speed: float) -> bool:
    """Whether an opening [m] and a speed [m/s] are possible; if not, that is the answer."""
    is_valid = 0.0 <= width <= OPENING_MAX and speed > 0.0
    if not is_valid:
        request.answer(GripperStatus.FAIL)
    return is_valid
