"""The robot as a program sees it: requests, motions and reflexes, in step with the plant.

A tick begins with what is measured. In a motion the program gets that as a state, and the tick
waits for the command that answers it. Without a motion, time stands still until there is something
to do.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np

from ...assets import STEP_SIZE
from ...assets.checks import refusals, torque_rate_measure
from ..model import Vector
from ..signals import Buffer
from .description import LIMITS, urdf
from .gripper import Gripper
from .line import SLICE, Line, LineError, Request, Service
from .measured import Measured, elbow_of
from .motions import MOTIONS, Kinematics, Motion
from .signals import INPUTS, OUTPUTS, Settings
from .torques import CartesianImpedance, JointImpedance, within_limits
from .wire import (
    COMMAND,
    ERRORS,
    GRIPPER,
    ROBOT,
    STATE,
    Control,
    Generator,
    Mode,
    MoveStatus,
    Status,
    Views,
    columns,
    matrix,
    views,
)

REST: Final = 5e-3  # [rad/s] below which a joint is at rest
MOST_BRAKING: Final = 1000  # ticks in which the arm comes to rest
LOOK: Final = 0.0002  # [s] between two looks at whether a program has read a state
PAUSE: Final = 0.001  # [s] between two states without a motion
GRIPPER_EVERY: Final = 10  # ticks between two states of the gripper
COUNTED: Final = 100  # commands of which the success rate is told
BITS: Final = 2.0 ** np.arange(len(ERRORS))  # of the output `errors`
COMMUNICATION: Final = "communication_constraints_violation"


class Delivery:
    """Commands on their way: late, and some of them lost."""

    def __init__(self, settings: Settings) -> None:
        self._delay, self._dropout = round(settings.delay / STEP_SIZE), settings.dropout
        self._random = np.random.default_rng(round(settings.seed))
        self._counted: deque[bool] = deque(maxlen=COUNTED)
        self.start()

    def start(self) -> None:
        """Begin with nothing on its way."""
        self._on_way: deque[Views] = deque()
        self.lost_in_a_row = 0
        self._counted.clear()

    def pass_on(self, command: Views) -> Views | None:
        """Send a command; return the one that arrives, if one does."""
        self._on_way.append(command)
        if len(self._on_way) <= self._delay:  # the first one has not arrived
            return None
        arrived = self._on_way.popleft()
        is_lost = self._dropout > 0.0 and self._random.random() < self._dropout
        self._counted.append(not is_lost)
        self.lost_in_a_row = self.lost_in_a_row + 1 if is_lost else 0
        return None if is_lost else arrived

    @property
    def success_rate(self) -> float:
        """Share of the last commands that have arrived."""
        return sum(self._counted) / len(self._counted) if self._counted else 0.0


class Robot:
    """Answers requests, follows motions, and ends them by reflexes; one `tick` per millisecond."""

    def __init__(
        self, settings: Settings, inputs: Vector, outputs: Vector, warn: Callable[[str], None]
    ) -> None:
        self._settings, self._warn = settings, warn
        self._inputs, self._outputs = Buffer(INPUTS, inputs).views, Buffer(OUTPUTS, outputs).views
        self._message = np.zeros(1, STATE)
        self._state, self._ticks, self._number = views(self._message), 0, 0
        self._arm, self._gripper = Kinematics(), Gripper()
        self._measured = Measured(self._inputs, self._arm)
        self._joint_impedance = JointImpedance()
        self._cartesian_impedance = CartesianImpedance(self._inputs, self._arm)
        self._delivery = Delivery(settings)
        self._mode, self._control = Mode.IDLE, Control.OTHER
        self._move: Request | None = None  # of the motion that is under way
        self._motion: Motion | None = None  # None before the first tick
        self._torque = np.zeros(7)  # commanded, without gravity
        self._is_told = self._is_opening = False
        self._due = 0  # number of the state whose command comes next
        self._braking = 0  # ticks that the arm may still take to come to rest
        self._answers: list[tuple[Request, int]] = []  # given once it is at rest
        self._line: Line
        self._service: Service

    def listen(self) -> None:
        """Wait for programs; raises LineError if that is not possible."""
        address = self._settings.address
        ports = round(self._settings.port), round(self._settings.gripper_port)
        self._service = Service(ROBOT, self, address, ports[0])
        try:
            self._gripper.service = Service(GRIPPER, self._gripper, address, ports[1])
        except LineError:
            self._service.close()
            raise
        services = (self._service, self._gripper.service)
        self._line = Line(services, self._settings.connection_timeout)

    def close(self) -> None:
        """Close all connections."""
        self._line.close()

    # What a program asks for.

    def connect(self, request: Request) -> None:
        """Agree on the version, and send states from now on."""
        self._service.agree(request)
        self._send_state()

    def move(self, request: Request) -> None:
        """Start a motion."""
        control, number = int(request.body["controller"]), int(request.body["generator"]) + 1
        if self._move or self._braking or self._mode == Mode.REFLEX:
            request.answer(MoveStatus.NOT_POSSIBLE)
            return
        if not _is_valid(control, number) or request.body["is_asynchronous"]:
            request.answer(MoveStatus.INVALID)
            return
        self._move, self._mode, self._control = request, Mode.MOVE, Control(control)
        self._motion = MOTIONS[Generator(number)](self._arm, self._held(), self._measured.q)
        self._torque = np.zeros(7)
        self._cartesian_impedance.start(self._motion)
        self._delivery.start()
        self._state.reflex_reason[:] = 0
        self._is_told, self._is_opening = False, True
        request.answer(MoveStatus.STARTED)

    def stop_move(self, request: Request) -> None:
        """End the motion, if there is one, and answer once the arm is at rest."""
        if self._move:
            self._end(MoveStatus.PREEMPTED)
            self._answers.append((request, Status.SUCCESS))
        else:
            request.answer(Status.SUCCESS)

    def automatic_error_recovery(self, request: Request) -> None:
        """Forget errors."""
        if self._is_free(request):
            self._mode = Mode.IDLE
            self._state.errors[:] = 0
            self._send_state()
            request.answer(Status.SUCCESS)

    def get_robot_model(self, request: Request) -> None:
        """Tell the arm's model."""
        request.answer(Status.SUCCESS, urdf())

    def set_collision_behavior(self, request: Request) -> None:
        """Change thresholds, of which only those of constant velocity are in use here."""
        if self._is_free(request):
            torques, forces = request.body["torques"], request.body["forces"]
            self._measured.lower, self._measured.upper = zip(torques, forces, strict=True)
            request.answer(Status.SUCCESS)

    def set_joint_impedance(self, request: Request) -> None:
        """Change the joints' springs."""
        self._set(request, "stiffness", self._joint_impedance.set_stiffness)

    def set_cartesian_impedance(self, request: Request) -> None:
        """Change the hand's springs."""
        self._set(request, "stiffness", self._cartesian_impedance.set_stiffness)

    def set_guiding_mode(self, request: Request) -> None:
        """Agree: nobody guides this arm by hand."""
        request.answer(Status.SUCCESS)

    def set_ee_to_k(self, request: Request) -> None:
        """Change the frame about which forces are told."""
        if self._is_free(request):
            self._measured.set_stiffness_frame(matrix(request.body["frame"]))
            request.answer(Status.SUCCESS)

    def set_ne_to_ee(self, request: Request) -> None:
        """Change the end effector's frame."""
        if self._is_free(request):
            self._measured.set_end_effector(matrix(request.body["frame"]))
            request.answer(Status.SUCCESS)

    def set_load(self, request: Request) -> None:
        """Change the load that the robot carries."""
        if self._is_free(request):
            self._measured.set_load(*(request.body[n] for n in ("mass", "centre", "inertia")))
            request.answer(Status.SUCCESS)

    def leave(self) -> None:
        """Notice that the program has gone: in a motion, it has died."""
        if self._move:
            raise LineError("the client has closed its connection in a motion")

    def _set(self, request: Request, field: str, change: Callable[[Vector], None]) -> None:
        values = request.body[field].copy()
        if not (np.isfinite(values) & (values > 0.0)).all():
            request.answer(Status.INVALID)
        elif self._is_free(request):
            change(values)
            request.answer(Status.SUCCESS)

    def _is_free(self, request: Request) -> bool:
        """Whether there is no motion; if there is one, that is the answer."""
        if self._move:
            request.answer(Status.NOT_POSSIBLE)
        return self._move is None

    # What follows in each tick.

    def tick(self) -> None:
        """Take one internal step."""
        with self._line.tick():
            self._measured.update()
            self._gripper.tick(self._inputs.qpos[7:])
            self._ticks += 1
            self._is_told = False
            if self._ticks % GRIPPER_EVERY == 0:
                self._tell()
            if self._motion is None:
                self._motion = Motion(self._arm, self._measured.q, self._measured.q)
            self._brake()
            self._line.serve(0.0)
            if self._move and not self._is_opening:
                self._meet(self._measured.errors())
            command = self._wait()
            if command is not None:
                self._follow(command)
            self._write()

    def _wait(self) -> Views | None:
        """Wait for a motion's command, or until there is something else to do."""
        while True:
            if self._move:
                command = self._exchange()
                if command is not None:
                    return command
            elif self._braking or self._gripper.is_busy:
                return None
            else:
                self._tell()
                self._line.serve(PAUSE if self._service.client else SLICE)

    def _exchange(self) -> Views | None:
        """Tell the program the state, and look for the command that answers it."""
        if not self._is_told:
            self._is_told = True
            self._send_state()
            self._due = self._number
            if self._is_opening:
                self._open()
        command = self._received()
        if command is None and self._move:
            self._line.serve(SLICE)
            command = self._received()
        self._is_opening = self._is_opening and command is None
        return command

    def _open(self) -> None:
        """Have the program read a first state, before that which it answers."""
        client = self._service.client
        while self._move and client and client.has_unread():
            self._line.serve(LOOK)
        self._send_state()

    def _received(self) -> Views | None:
        """Return the command that is due, if it has come."""
        client = self._service.client
        for packet in client.packets(COMMAND.itemsize + 1) if client and self._move else ():
            if len(packet) == COMMAND.itemsize:
                command = views(np.frombuffer(packet, COMMAND))
                if command.message_id >= self._due:
                    return command
            self._line.count(1)
        return None

    def _follow(self, command: Views) -> None:
        """Follow a command, as far as it arrives and its limits allow."""
        arrived = self._delivery.pass_on(command)
        assert self._motion is not None
        errors = self._motion.errors(arrived)
        if self._delivery.lost_in_a_row >= LIMITS.lost_packets:
            errors.append(COMMUNICATION)
        is_finished = False
        if arrived is not None:
            errors += self._take_torque(arrived.tau_J_d)
            is_finished = bool(arrived.is_finished or arrived.is_torque_finished)
            self._show(arrived)
        if is_finished and not errors:
            errors += self._motion.end_errors()
        self._meet(errors)
        if is_finished and self._move:
            self._end(MoveStatus.SUCCESS)

    def _take_torque(self, torque: Vector) -> list[str]:
        """Take over a commanded torque (7,) [N.m]; return what is refused."""
        if self._control != Control.EXTERNAL:
            return []
        rate = (torque - self._torque) / STEP_SIZE
        self._torque = torque
        return refusals([torque_rate_measure(rate[None], LIMITS)])

    def _meet(self, errors: list[str]) -> None:
        """End the motion by a reflex, if there are errors."""
        if errors:
            self._warn(f"reflex: {', '.join(errors)}")
            for flags in (self._state.errors, self._state.reflex_reason):
                flags[[ERRORS.index(error) for error in errors]] = 1
            self._end(MoveStatus.REFLEX, Mode.REFLEX)

    def _end(self, status: MoveStatus, mode: Mode = Mode.IDLE) -> None:
        """End the motion; the answer follows once the arm is at rest."""
        assert self._move is not None
        assert self._motion is not None
        stays = status == MoveStatus.SUCCESS and self._control == Control.JOINT_IMPEDANCE
        q = self._motion.q if stays else self._measured.q
        self._motion = Motion(self._arm, q, self._measured.q)
        self._answers.append((self._move, status))
        self._move, self._mode, self._control = None, mode, Control.OTHER
        self._braking = MOST_BRAKING
        self._send_state()

    def _brake(self) -> None:
        """Answer the requests that have ended a motion, once the arm is at rest."""
        if self._braking:
            self._braking -= 1
            if np.abs(self._measured.dq).max() < REST:
                self._braking = 0
            if not self._braking:
                self._send_state()
                for request, status in self._answers:
                    request.answer(status)
                self._answers.clear()

    def _held(self) -> Vector:
        """Joints (7,) that the arm is held at, unless it has been moved away."""
        assert self._motion is not None
        away = np.abs(self._motion.q - self._measured.q)
        is_near = bool((away < LIMITS.velocity * STEP_SIZE).all())
        return self._motion.q if is_near else self._measured.q

    # What it tells.

    def _tell(self) -> None:
        """Send states to who has read the last ones."""
        client = self._service.client
        if client and not self._move and not client.has_unread():
            self._send_state()
        hand = self._gripper.service.client
        if hand and not hand.has_unread():
            self._gripper.send_state()

    def _send_state(self) -> None:
        """Send the present state, if a program takes it."""
        client = self._service.client
        if client and client.is_connected:
            self._fill()
            client.send(self._message.tobytes())

    def _fill(self) -> None:
        state, motion = self._state, self._motion
        self._number += 1
        state.message_id[...] = self._number
        self._measured.fill(state)
        if motion is not None:
            state.q_d[:], state.dq_d[:], state.ddq_d[:] = motion.q, motion.dq, motion.ddq
            state.O_T_EE_d[:] = state.O_T_EE_c[:] = columns(motion.pose)
            state.O_dP_EE_d[:] = state.O_dP_EE_c[:] = motion.twist
            state.O_ddP_EE_c[:] = motion.turn
            state.elbow_d[:] = elbow_of(motion.q)
            for field, rate in zip(("elbow_c", "delbow_c", "ddelbow_c"), motion.elbow, strict=True):
                getattr(state, field)[0] = rate
            state.elbow_c[1] = state.elbow_d[1]
        state.tau_J_d[:] = self._torque
        state.motion_generator_mode[...] = self._generator
        state.controller_mode[...], state.robot_mode[...] = self._control, self._mode
        state.success_rate[...] = self._delivery.success_rate if self._move else 0.0

    @property
    def _generator(self) -> Generator:
        if self._move is None or self._motion is None:
            return Generator.IDLE
        return self._motion.generator

    def _show(self, command: Views) -> None:
        """Show a command among the outputs."""
        for name in ("q_c", "dq_c", "O_T_EE_c", "tau_J_d"):
            getattr(self._outputs, name)[:] = getattr(command, name)

    def _write(self) -> None:
        """Write the outputs."""
        y = self._outputs
        y.ctrl[:7], y.ctrl[7] = within_limits(self._torques()), self._gripper.ctrl
        y.robot_mode[...], y.controller_mode[...] = self._mode, self._control
        y.motion_generator[...] = self._generator
        y.errors[...] = self._state.errors @ BITS
        y.success_rate[...] = self._delivery.success_rate

    def _torques(self) -> Vector:
        """Return the torques (7,) [N.m] of the motion, or of rest."""
        measured, motion = self._measured, self._motion
        assert motion is not None
        if self._control == Control.EXTERNAL:
            return self._torque + self._arm.hand(measured.q).bias + measured.carrying()
        if self._control == Control.CARTESIAN_IMPEDANCE:
            torque = self._cartesian_impedance.torque(motion) + measured.carrying()
        else:
            torque = self._joint_impedance.torque(measured.q, measured.dq, motion) + measured.bias
        self._torque = torque - measured.bias
        return torque


def _is_valid(control: int, generator: int) -> bool:
    """Whether a controller can follow a motion generator; torques alone need no other."""
    if generator == Generator.NONE:
        return control == Control.EXTERNAL
    return generator in MOTIONS and control < Control.OTHER
