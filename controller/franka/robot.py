"""The robot as a program sees it: requests, motions and reflexes, in step with the plant.

A tick begins with what is measured. In a motion the program gets that as a state, and the tick
waits for the command that answers it. Without a motion, time stands still until there is something
to do.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np

from ...assets import STEP_SIZE
from ...assets.checks import refusals, torque_rate_measure
from ...assets.fields import Buffer, Vector
from ...assets.franka import CTRL_OPEN, OPENING_MAX
from ..limits import clamp
from .description import LIMITS, urdf
from .gripper import Gripper
from .line import Line, Request, Service
from .measured import Measured
from .motions import MOTIONS, Motion
from .signals import INPUTS, OUTPUTS, Settings
from .torques import CartesianImpedance, JointImpedance
from .wire import (
    COMMAND,
    ERRORS,
    GRIPPER,
    ROBOT,
    STATE,
    Control,
    Generator,
    Message,
    Mode,
    MoveStatus,
    ProgramError,
    Status,
)

REST: Final = 5e-3  # [rad/s] below which a joint is at rest
MOST_BRAKING: Final = 1000  # ticks in which the arm comes to rest
READING: Final = 0.01  # [s] that a program on another machine has for a state
LOOK: Final = 0.0002  # [s] between two looks at whether a program has read a state
PAUSE: Final = 0.001  # [s] between two states without a motion
SLICE: Final = 0.1  # [s] of waiting for a command
GRIPPER_EVERY: Final = 10  # ticks between two states of the gripper
COUNTED: Final = 100  # commands of which the success rate is told
BITS: Final = 2.0 ** np.arange(len(ERRORS))  # of the output `errors`
SHOWN: Final = ("q_c", "dq_c", "O_T_EE_c", "tau_J_d")  # fields of commands, among the outputs
COMMUNICATION: Final = "communication_constraints_violation"


class Delivery:
    """Commands on their way: late, and some of them lost."""

    def __init__(self, settings: Settings) -> None:
        self._delay, self._dropout = round(settings.delay / STEP_SIZE), settings.dropout
        self._random = np.random.default_rng(round(settings.seed))
        self.start()

    def start(self) -> None:
        """Begin with nothing on its way."""
        self._on_way: deque[Message] = deque()
        self._came: deque[bool] = deque(maxlen=COUNTED)
        self.lost = 0  # in a row

    def pass_on(self, command: Message) -> Message | None:
        """Send a command; return the one that arrives, if one does."""
        self._on_way.append(command)
        if len(self._on_way) <= self._delay:  # the first one has not arrived
            return None
        arrived = self._on_way.popleft()
        self._came.append(self._dropout == 0.0 or self._random.random() >= self._dropout)
        self.lost = 0 if self._came[-1] else self.lost + 1
        return None if self.lost else arrived

    @property
    def success_rate(self) -> float:
        """Share of the last commands that have arrived."""
        return sum(self._came) / max(len(self._came), 1)


class Robot:
    """Answers requests, follows motions, and ends them by reflexes; one `tick` per millisecond."""

    _line: Line
    _service: Service

    def __init__(
        self, settings: Settings, inputs: Vector, outputs: Vector, warn: Callable[[str], None]
    ) -> None:
        self._settings, self._warn = settings, warn
        self._outputs, self._gripper = Buffer(OUTPUTS, outputs).views, Gripper()
        self._measured = Measured(Buffer(INPUTS, inputs).views)
        self._arm = self._measured.arm
        self._joint_impedance = JointImpedance()
        self._cartesian_impedance = CartesianImpedance(self._measured)
        self._delivery = Delivery(settings)
        self._state: Any = np.zeros(1, STATE)[0]
        self._mode, self._control = Mode.IDLE, Control.OTHER
        self._move: Request | None = None  # of the motion that is under way
        self._motion = Motion(self._arm, self._measured.q, self._measured.q)
        self._torque = np.zeros(7)  # commanded, without what carries the arm
        self._is_opening = False  # before the first command of a motion
        self._ticks = self._braking = 0  # the arm may still take so many to come to rest
        self._answers: list[Callable[[], None]] = []  # given once it is at rest
        self._measured.fill_frames(self._state)
        changes: dict[str, Callable[..., None]] = {
            "automatic_error_recovery": self._recover,
            "set_collision_behavior": self._measured.set_thresholds,
            "set_joint_impedance": self._joint_impedance.set_stiffness,
            "set_cartesian_impedance": self._cartesian_impedance.set_stiffness,
            "set_guiding_mode": lambda *_: None,  # nobody guides this arm by hand
            "set_ee_to_k": self._measured.set_stiffness_frame,
            "set_ne_to_ee": self._measured.set_end_effector,
            "set_load": self._measured.set_load,
        }
        for name, change in changes.items():  # requests, as the methods are
            setattr(self, name, partial(self._set, change))
        self._write()

    def listen(self) -> None:
        """Wait for programs; raises ProgramError if that is not possible."""
        settings, hand = self._settings, self._gripper
        self._service = Service(ROBOT, self, settings.address, round(settings.port))
        hand.service = Service(GRIPPER, hand, settings.address, round(settings.gripper_port))
        self._line = Line((self._service, hand.service), settings.connection_timeout)

    def close(self) -> None:
        """Close all connections; may be called again."""
        if hasattr(self, "_line"):
            self._line.close()

    # What a program asks for.

    def move(self, request: Request) -> None:
        """Start a motion."""
        body = request.body
        kind, control = MOTIONS.get(body["generator"] + 1), body["controller"]
        if self._move or self._braking or self._mode == Mode.REFLEX:
            request.answer(MoveStatus.NOT_POSSIBLE)
        elif kind is None or control >= Control.OTHER or body["is_asynchronous"] or (
            kind is Motion and control != Control.EXTERNAL
        ):  # fmt: skip
            request.answer(MoveStatus.INVALID)
        else:
            generator = Generator(body["generator"] + 1)
            self._motion = kind(self._arm, self._motion.q, self._measured.q, generator)
            self._move, self._mode, self._control = request, Mode.MOVE, Control(control)
            self._torque, self._is_opening = np.zeros(7), True
            self._cartesian_impedance.start(self._motion)
            self._delivery.start()
            self._state["reflex_reason"] = 0
            request.answer(MoveStatus.STARTED)

    def stop_move(self, request: Request) -> None:
        """End the motion, if there is one, and answer once the arm is at rest."""
        if self._move:
            self._end(MoveStatus.PREEMPTED)
            self._answers.append(partial(request.answer, Status.SUCCESS))
        else:
            request.answer(Status.SUCCESS)

    def get_robot_model(self, request: Request) -> None:
        """Tell the arm's model."""
        request.answer(Status.SUCCESS, urdf())

    def _set(self, change: Callable[..., None], request: Request) -> None:
        """Change something to the fields of a request, unless there is a motion."""
        if self._move:
            request.answer(Status.NOT_POSSIBLE)
            return
        change(*(request.body or ()))
        self._measured.fill_frames(self._state)
        self.send_state()  # before the answer, after which the program may look at it
        request.answer(Status.SUCCESS)

    def _recover(self) -> None:
        """Forget errors."""
        self._mode, self._state["errors"] = Mode.IDLE, 0

    def leave(self) -> None:
        """Notice that the program has gone: in a motion, it has died."""
        if self._move:
            raise ProgramError("the program has closed its connection in a motion")

    # What follows in each tick.

    def tick(self) -> None:
        """Take one internal step."""
        with self._line.tick():
            self._measured.update()
            if self._ticks == 0:
                self._motion = Motion(self._arm, self._measured.q, self._measured.q)
                self._gripper.start(self._measured.fingers)
            self._gripper.tick(self._measured.fingers)
            if self._ticks % GRIPPER_EVERY == 0:
                self._tell()
            self._ticks += 1
            self._brake()
            if self._move is None:
                self._line.serve(0.0)
            elif not self._is_opening:
                self._meet(self._measured.errors())
            command = self._wait()
            if command is not None:
                self._follow(command)
            self._write()

    def _wait(self) -> Message | None:
        """Wait for a motion's command, or until there is something else to do."""
        while not (self._move or self._braking or self._gripper.job):
            self._tell()
            self._line.serve(PAUSE)
        if self._move:
            self.send_state()
            due = int(self._state["message_id"])
            if self._is_opening:
                self._open()
        while self._move:
            self._line.serve(SLICE, self._service.udp)
            command = self._received(due)
            if command is not None:
                self._is_opening = False
                return command
        return None

    def _open(self) -> None:
        """Let the program read a first state, before that which it answers."""
        time.sleep(READING)
        while self._move and not self._service.is_read:
            self._line.serve(LOOK)
        self.send_state()

    def _received(self, due: int) -> Message | None:
        """Return the command that answers a state, if it has come."""
        for packet in self._service.packets():
            if len(packet) == COMMAND.itemsize:
                command = np.frombuffer(packet, COMMAND)[0]
                if command["message_id"] >= due:
                    return command
            self._line.count(1)
        return None

    def _follow(self, command: Message) -> None:
        """Follow a command, as far as it arrives and its limits allow."""
        arrived, is_finished = self._delivery.pass_on(command), False
        errors = self._motion.errors(arrived)
        if self._delivery.lost >= LIMITS.lost_packets:
            errors.append(COMMUNICATION)
        if arrived is not None:
            is_finished = bool(arrived["is_finished"] or arrived["is_torque_finished"])
            errors += self._take(arrived)
        if is_finished and not errors:
            errors += self._motion.end_errors()
        self._meet(errors)
        if is_finished and self._move:
            self._end(MoveStatus.SUCCESS)

    def _take(self, command: Message) -> list[str]:
        """Show a command, and take over its torque; return what is refused of that."""
        for name in SHOWN:
            getattr(self._outputs, name)[:] = command[name]
        if self._control != Control.EXTERNAL:
            return []
        rate = (command["tau_J_d"] - self._torque) / STEP_SIZE
        self._torque = command["tau_J_d"]
        return refusals([torque_rate_measure(rate[None], LIMITS)])

    def _meet(self, errors: list[str]) -> None:
        """End the motion by a reflex, if there are errors."""
        if errors:
            self._warn(f"reflex: {', '.join(errors)}")
            for flags in ("errors", "reflex_reason"):
                self._state[flags][[ERRORS.index(error) for error in errors]] = 1
            self._end(MoveStatus.REFLEX, Mode.REFLEX)

    def _end(self, status: MoveStatus, mode: Mode = Mode.IDLE) -> None:
        """End the motion; the answer follows once the arm is at rest."""
        stays = status == MoveStatus.SUCCESS and self._control == Control.JOINT_IMPEDANCE
        q = self._motion.q if stays else self._measured.q
        self._motion = Motion(self._arm, q, self._measured.q)
        assert self._move is not None
        self._answers.append(partial(self._move.answer, status))
        self._move, self._mode, self._control = None, mode, Control.OTHER
        self._braking = MOST_BRAKING
        self.send_state()

    def _brake(self) -> None:
        """Answer the requests that have ended a motion, once the arm is at rest."""
        is_moving = (np.abs(self._measured.dq) >= REST).any()
        self._braking = self._braking - 1 if self._braking and is_moving else 0
        if self._answers and not self._braking:
            self.send_state()
            while self._answers:
                self._answers.pop(0)()

    # What it tells.

    def _tell(self) -> None:
        """Send states to a program that has read the last ones."""
        if not self._move and self._service.is_read:
            self.send_state()
        if self._gripper.service.is_read:
            self._gripper.send_state()

    def send_state(self) -> None:
        """Send the present state, if a program takes it."""
        state, is_moving = self._state, self._move is not None
        state["message_id"] += 1
        self._measured.fill(state)
        self._motion.fill(state)
        state["tau_J_d"], state["controller_mode"] = self._torque, self._control
        state["motion_generator_mode"] = self._motion.generator if is_moving else Generator.IDLE
        state["robot_mode"], state["success_rate"] = self._mode, self._delivery.success_rate
        self._service.send(state)

    def _write(self) -> None:
        """Write the outputs."""
        y, measured, grip = self._outputs, self._measured, self._gripper.target
        bias, load = measured.bias, np.zeros(7)
        if self._control == Control.EXTERNAL:
            bias, load = self._arm.hand(measured.q).bias, measured.carrying()
        elif self._control == Control.CARTESIAN_IMPEDANCE:  # its torques are told by states, too
            self._torque = self._cartesian_impedance.torque(self._motion)
        else:
            self._torque = self._joint_impedance.torque(measured, self._motion)
        y.ctrl[:7] = clamp(self._torque + bias + load, -LIMITS.torque, LIMITS.torque)
        y.ctrl[7], y.grip_cmd[...] = CTRL_OPEN * min(grip / OPENING_MAX, 1.0), grip
        y.robot_mode[...], y.controller_mode[...] = self._mode, self._control
        y.motion_generator[...] = self._state["motion_generator_mode"]
        y.errors[...] = self._state["errors"] @ BITS
        y.success_rate[...] = self._delivery.success_rate
