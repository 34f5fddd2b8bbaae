"""The Franka Hand: its commands, each of which goes on until the fingers are at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ...assets import STEP_SIZE
from ...assets.fields import Vector
from ...assets.franka import (
    FINGER_SPEED_MAX,
    GRIP_FORCE_MAX,
    GRIP_STIFFNESS,
    OPENING_MAX,
)
from .line import Request, Service
from .wire import GRIPPER_STATE, GripperStatus

MOST_SPEED: Final = 2.0 * FINGER_SPEED_MAX  # [m/s] of the opening
LEAST_FORCE: Final = 1.0  # [N] of a finger, which moves it at all
CLOSEST: Final = 2e-3  # [m] a move that ends farther off was not successful
STILL: Final = 2e-6  # [m] that the opening may change within a tick at rest
REST: Final = 50  # ticks of rest after which a command has ended
LONGEST: Final = 5000  # ticks after which it has in any case
TEMPERATURE: Final = 30  # [deg C]


@dataclass
class Job:
    """A command that goes on."""

    request: Request
    low: float  # [m] openings between which it is successful
    high: float
    goal: float  # [m]
    speed: float = MOST_SPEED  # [m/s] of the opening
    force: float = math.inf  # [N] with which each finger presses at most
    ticks: int = 0
    rest: int = 0  # ticks


class Gripper:
    """Moves the fingers' target, and answers once they are at rest."""

    service: Service

    def __init__(self) -> None:
        self.job: Job | None = None  # that goes on
        self.target = self._width = OPENING_MAX  # [m]
        self._state = np.zeros(1, GRIPPER_STATE)[0]
        self._state["max_width"], self._state["temperature"] = OPENING_MAX, TEMPERATURE

    def start(self, fingers: Vector) -> None:
        """Begin where the fingers (2,) [m] are."""
        self.target = self._width = float(fingers.sum())

    # What a program asks for.

    def homing(self, request: Request) -> None:
        """Open the fingers wide."""
        self._begin(Job(request, 0.0, math.inf, OPENING_MAX))

    def move(self, request: Request) -> None:
        """Move the fingers to an opening."""
        width, speed = request.body.item()
        self._begin(Job(request, width - CLOSEST, width + CLOSEST, width, speed))

    def grasp(self, request: Request) -> None:
        """Close the fingers until something stops them, and press."""
        width, inner, outer, speed, force = request.body.item()
        pressing = min(max(0.5 * force, LEAST_FORCE), GRIP_FORCE_MAX)
        self._begin(Job(request, width - inner, width + outer, 0.0, speed, pressing))

    def stop(self, request: Request) -> None:
        """Stop where the fingers are."""
        self.leave()
        self.target = self._width
        request.answer(GripperStatus.SUCCESS)

    def leave(self) -> None:
        """End the command that goes on."""
        if self.job is not None:
            self.job.request.answer(GripperStatus.ABORTED)
        self.job = None

    def _begin(self, job: Job) -> None:
        if not (0.0 <= job.goal <= OPENING_MAX and job.speed > 0.0):
            job.request.answer(GripperStatus.FAIL)
            return
        self.leave()
        self.job, self._state["is_grasped"] = job, 0

    # What follows in each tick.

    def tick(self, fingers: Vector) -> None:
        """Move the target, and end a command if the fingers (2,) [m] are at rest."""
        width, before, job = float(fingers.sum()), self._width, self.job
        self._width = width
        if job is None:
            return
        goal = max(job.goal, width - 2.0 * job.force / GRIP_STIFFNESS)
        if job.force < math.inf:  # a grasp only closes
            goal = min(goal, self.target)
        step = min(job.speed, MOST_SPEED) * STEP_SIZE
        self.target += min(max(goal - self.target, -step), step)
        is_still = abs(width - before) < STILL and abs(goal - self.target) < STILL
        job.ticks, job.rest = job.ticks + 1, job.rest + 1 if is_still else 0
        if job.rest == REST or job.ticks == LONGEST:
            self._end(job)

    def _end(self, job: Job) -> None:
        is_successful = job.low < self._width < job.high
        self.job, self._state["is_grasped"] = None, is_successful and job.force < math.inf
        self.send_state()
        job.request.answer(GripperStatus.SUCCESS if is_successful else GripperStatus.UNSUCCESSFUL)

    def send_state(self) -> None:
        """Tell the program, if there is one, how the fingers are."""
        self._state["message_id"] += 1
        self._state["width"] = self._width
        self.service.send(self._state)
