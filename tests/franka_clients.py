"""Programs of a real Franka, run as `python franka_clients.py NAME ADDRESS`; each prints JSON.

They are on pylibfranka or on franky; a process can import only one of these.
"""

import json
import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

TICKS = 500  # of a motion
WAVE = 0.5 * (1.0 - np.cos(2.0 * np.pi * np.arange(TICKS) / (TICKS - 1)))  # there and back
SHARES = np.linspace(0.0, 1.0, 800)
RAMP = SHARES**3 * (10.0 - 15.0 * SHARES + 6.0 * SHARES**2)  # there, with no acceleration at an end
JOINTS = 0.05 * np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0])  # [rad] that a motion goes
UPWARDS = 0.04  # [m]
MOVING = 0.02  # [rad] in a tick, far above all limits
THRESHOLD = 100.0  # [N, N.m] above what a motion needs


def connected(address: str) -> tuple[Any, Any]:
    """Return pylibfranka, and a robot."""
    import pylibfranka  # noqa: PLC0415 - see above

    robot = pylibfranka.Robot(address, pylibfranka.RealtimeConfig.kIgnore)
    robot.set_collision_behavior(*([THRESHOLD] * n for n in (7, 7, 6, 6)))
    return pylibfranka, robot


def gone(franka: Any, joints: Any, way: Any) -> Any:
    """Return the command of positions that are so far from others."""
    return franka.JointPositions((np.array(joints) + way).tolist())


def follow(
    control: Any, command: Callable[[Any, int], Any], ticks: int = TICKS, pause: float = 0.0
) -> Any:
    """Send what a function makes of the first state and the tick; return what states told."""
    states, durations, first = [], set(), None
    for tick in range(ticks):
        state, duration = control.readOnce()
        first = first or state
        durations.add(round(1e3 * duration.to_sec()))
        states.append([state.q, state.q_d, state.tau_J_d])
        time.sleep(pause if tick == ticks // 2 else 0.0)
        sent = command(first, tick)
        sent.motion_finished = tick == ticks - 1
        control.writeOnce(sent)
    q, q_d, torque = np.array(states).transpose(1, 0, 2)
    return {
        "durations": sorted(durations),
        "lag": np.abs(q - q_d).max(),
        "way": (q.max(axis=0) - q.min(axis=0)).tolist(),
        "torque": np.abs(torque).max(),
    }


def joint(address: str, controller: str = "JointImpedance", pause: str = "0.0") -> Any:
    """Move joints by positions, and stop for a while in the middle, as under a debugger."""
    franka, robot = connected(address)

    control = robot.start_joint_position_control(getattr(franka.ControllerMode, controller))
    way = WAVE[:, None] * JOINTS
    return follow(control, lambda first, k: gone(franka, first.q_d, way[k]), pause=float(pause))


def soft(address: str) -> Any:
    """Move joints on springs that are soft."""
    franka, robot = connected(address)
    robot.set_joint_impedance([300.0] * 7)
    control = robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
    return follow(control, lambda first, tick: gone(franka, first.q, WAVE[tick] * JOINTS))


def joint_velocity(address: str) -> Any:
    """Move joints by velocities."""
    franka, robot = connected(address)
    speed = np.gradient(WAVE) / 1e-3
    control = robot.start_joint_velocity_control(franka.ControllerMode.JointImpedance)
    speed[[0, -1]] = 0.0
    return follow(control, lambda _, k: franka.JointVelocities((speed[k] * JOINTS).tolist()))


def pose(address: str) -> Any:
    """Lift the end effector by poses, then lower it by twists; tell where it has been."""
    franka, robot = connected(address)
    places = [robot.read_once().O_T_EE[14]]

    def lift(first: Any, tick: int) -> Any:
        columns = list(first.O_T_EE_c)
        columns[14] += UPWARDS * RAMP[tick]
        return franka.CartesianPose(columns)

    def lower(_first: Any, tick: int) -> Any:
        speed = np.diff(RAMP, append=1.0)[tick] / 1e-3
        return franka.CartesianVelocities([0.0, 0.0, -UPWARDS * speed, 0.0, 0.0, 0.0])

    mode = franka.ControllerMode.CartesianImpedance
    follow(robot.start_cartesian_pose_control(mode), lift, len(RAMP))
    places.append(robot.read_once().O_T_EE[14])
    control = robot.start_cartesian_velocity_control(franka.ControllerMode.JointImpedance)
    follow(control, lower, len(RAMP))
    return [*places, robot.read_once().O_T_EE[14]]


def torque(address: str) -> Any:
    """Hold the arm by torques of the client's own law, with its model."""
    franka, robot = connected(address)
    model, goal = robot.load_model(), np.array(robot.read_once().q)
    state = robot.read_once()
    control = robot.start_torque_control()
    for tick in range(TICKS):
        state, _ = control.readOnce()
        spring = 400.0 * (goal + 0.5 * WAVE[tick] * JOINTS - state.q) - 30.0 * np.array(state.dq)
        sent = franka.Torques((spring + np.array(model.coriolis(state))).tolist())
        sent.motion_finished = tick == TICKS - 1
        control.writeOnce(sent)
    return {"away": np.abs(np.array(state.q) - goal).max(), "q": list(state.q),
            "gravity": list(model.gravity(state)), "mass": list(model.mass(state)),
            "end_effector": list(state.O_T_EE)}  # fmt: skip


# What is wrong in a motion's commands: how they are sent, of which joint or axis, by how much in
# each tick, and how many there are.
REFUSED: dict[str, tuple[str, int, Callable[[int], float], int]] = {
    "jump": ("JointPositions", 0, lambda tick: MOVING * (tick == 30), 3000),
    "kink": ("JointPositions", 0, lambda tick: 1e-4 * (tick == 30), 3000),
    "start": ("JointPositions", 0, lambda tick: 0.01, 3000),
    "speed": ("JointVelocities", 0, lambda tick: 4.0 * tick * 1e-3, 3000),
    "end of range": ("JointVelocities", 3, lambda tick: -4.0 * min(tick, 500) * 1e-3, 3000),
    "end": ("JointVelocities", 0, lambda tick: 4.0 * tick * 1e-3, 50),
    "torque": ("Torques", 0, lambda tick: 5.0 * (tick == 30), 3000),
    "spin": ("Torques", 6, lambda tick: min(0.5 * tick, 5.0), 3000),
    "more than a motor has": ("Torques", 6, lambda tick: 0.9 * tick, 3000),
    "jump of a pose": ("CartesianPose", 14, lambda tick: 1e-3 * (tick == 30), 3000),
    "start of poses": ("CartesianPose", 14, lambda tick: 0.01, 3000),
    "turn": ("CartesianVelocities", 5, lambda tick: 8.0 * tick * 1e-3, 3000),
    "end of a turn": ("CartesianVelocities", 5, lambda tick: 8.0 * tick * 1e-3, 50),
}


def refused(address: str, what: str) -> Any:
    """Ask for what the robot refuses, recover, and move again."""
    franka, robot = connected(address)
    kind, axis, wrong, ticks = REFUSED[what]
    start = {
        "JointPositions": robot.start_joint_position_control,
        "JointVelocities": robot.start_joint_velocity_control,
        "CartesianPose": robot.start_cartesian_pose_control,
        "CartesianVelocities": robot.start_cartesian_velocity_control,
        "Torques": lambda _: robot.start_torque_control(),
    }[kind]

    def command(first: Any, tick: int) -> Any:
        rest = {"JointPositions": first.q, "CartesianPose": first.O_T_EE,
                "CartesianVelocities": [0.0] * 6}.get(kind, [0.0] * 7)  # fmt: skip
        sent = list(rest)
        sent[axis] += wrong(tick)
        return getattr(franka, kind)(sent)

    mode = franka.ControllerMode.JointImpedance
    return after_refusal(franka, robot, lambda: follow(start(mode), command, ticks))


def after_refusal(franka: Any, robot: Any, act: Callable[[], Any]) -> Any:
    """Return the exception's text, that of a motion before recovery, and that it moves after."""
    told = []
    for attempt in (act, robot.start_torque_control):
        try:
            attempt()
        except (franka.ControlException, franka.CommandException) as error:
            told.append(str(error))
    modes = [str(robot.read_once().robot_mode)]
    robot.automatic_error_recovery()
    state = robot.read_once()
    modes.append(str(state.robot_mode))
    short = 0.25 * WAVE[::2, None] * JOINTS
    again = follow(
        robot.start_joint_position_control(franka.ControllerMode.JointImpedance),
        lambda first, tick: gone(franka, first.q_d, short[tick]),
        len(short),
    )
    return {"told": told, "modes": modes, "errors": str(state.current_errors),
            "again": again["way"]}  # fmt: skip


def touched(address: str, threshold: str) -> Any:
    """Stay, while somebody pushes the hand."""
    franka, robot = connected(address)
    robot.set_collision_behavior(*([float(threshold)] * n for n in (7, 7, 6, 6)))

    def act() -> None:
        control = robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
        follow(control, lambda first, _: franka.JointPositions(first.q))

    return after_refusal(franka, robot, act)


def lossy(address: str) -> Any:
    """Move gently over a line that loses commands."""
    franka, robot = connected(address)

    control = robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
    try:
        return follow(control, lambda first, k: gone(franka, first.q_d, 0.2 * WAVE[k] * JOINTS))
    except franka.ControlException as error:
        return str(error)


def stopped(address: str) -> Any:
    """Stop a motion from another thread."""
    franka, robot = connected(address)
    control = robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
    first, _ = control.readOnce()
    thread = threading.Thread(target=robot.stop)
    try:
        for tick in range(100_000):
            control.writeOnce(franka.JointPositions(first.q_d))
            if tick == 50:
                thread.start()
            control.readOnce()
    except franka.ControlException as error:
        thread.join(timeout=10.0)
        return [str(error), str(robot.read_once().robot_mode)]
    return None


def gripper(address: str) -> Any:
    """Move the fingers, grasp air, and what is 40 mm wide with 60 mm asked for."""
    import pylibfranka  # noqa: PLC0415 - see above

    hand = pylibfranka.Gripper(address)
    told = [hand.homing(), hand.move(0.05, 0.1), hand.read_once().width]
    told += [hand.grasp(0.03, 0.1, 20.0, 0.005, 0.005), hand.read_once().is_grasped]
    told += [hand.move(0.04, 0.1), hand.grasp(0.0, 0.1, 20.0, 0.005, 0.005)]
    return [*told, hand.read_once().is_grasped, hand.read_once().width, hand.stop()]


def settings(address: str) -> Any:
    """Set what can be set, and tell what the state says of it."""
    _, robot = connected(address)
    before = robot.read_once()
    turn = [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1, 1.0]
    robot.set_EE(turn)
    robot.set_K(turn)
    robot.set_load(0.5, [0.0, 0.0, 0.1], [1e-3, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1e-3])
    robot.set_cartesian_impedance([1000.0] * 3 + [100.0] * 3)
    after = robot.read_once()
    names = ("O_T_EE", "F_T_EE", "F_T_NE", "NE_T_EE", "EE_T_K", "m_load", "m_ee", "F_x_Cee")
    return [{name: np.ravel(getattr(state, name)).tolist() for name in names}
            for state in (before, after)]  # fmt: skip


def twice(address: str) -> Any:
    """Connect, leave, and connect again."""
    first = connected(address)[1].read_once().q
    return [first, connected(address)[1].read_once().q]


def dies(address: str) -> Any:
    """Die in the middle of a motion."""
    franka, robot = connected(address)
    control = robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
    for _ in range(50):
        first, _ = control.readOnce()
        control.writeOnce(franka.JointPositions(first.q_d))
    print("null", flush=True)
    os._exit(0)


def talk(address: str, data: bytes, answer: int = 0) -> bytes:
    """Send bytes to the robot's port, and read so many."""
    with socket.create_connection((address, 1337)) as line:
        line.sendall(data)
        return line.recv(answer, socket.MSG_WAITALL) if answer else line.recv(1)


def wrong_size(address: str) -> Any:
    """Connect with too few bytes."""
    return len(talk(address, struct.pack("<IIIH", 0, 0, 14, 10)))


def nonsense(address: str) -> Any:
    """Send bytes that are no request."""
    return len(talk(address, b"\xff" * 100_000))


def older(address: str) -> Any:
    """Speak another version; return status and version of the answer."""
    return struct.unpack("<BH", talk(address, struct.pack("<IIIHH", 0, 0, 16, 9, 5000), 15)[12:])


def floods(address: str) -> Any:
    """Ask without end, and read no answer."""
    request = struct.pack("<III", 2, 0, 12) * 1000
    with socket.create_connection((address, 1337)) as line, suppress(ConnectionError):
        while True:
            line.sendall(request)
            with suppress(BlockingIOError):
                line.recv(1_000_000, socket.MSG_DONTWAIT)
    return None


def idle(address: str) -> Any:
    """Stay, without a motion, until the robot closes the connection."""
    return len(talk(address, struct.pack("<IIIHH", 0, 0, 16, 10, 5000), 15))


def with_franky(address: str) -> Any:
    """Move in all of franky's ways."""
    import franky  # noqa: PLC0415 - see above

    robot = franky.Robot(address, realtime_config=franky.RealtimeConfig.Ignore)
    robot.relative_dynamics_factor = 0.1
    robot.set_collision_behavior(THRESHOLD, THRESHOLD)
    robot.move(franky.JointMotion([0.1, 0.1, 0.0, -1.6, 0.0, 1.7, -0.7]))
    told = [list(robot.state.q), robot.state.O_T_EE.translation.tolist()]
    robot.move(
        franky.CartesianMotion(franky.Affine([0.0, 0.05, -0.05]), franky.ReferenceType.Relative)
    )
    told.append(robot.state.O_T_EE.translation.tolist())
    hold = franky.Duration(100)
    turn = franky.JointVelocityWaypoint([0.1] + [0.0] * 6, hold_target_duration=hold)
    robot.move(franky.JointVelocityWaypointMotion([turn, franky.JointVelocityWaypoint([0.0] * 7)]))
    told.append(list(robot.state.q))
    waypoint, twist = franky.CartesianVelocityWaypoint, franky.Twist
    push = waypoint(twist([0.05, 0.0, 0.0]), hold_target_duration=hold)
    robot.move(franky.CartesianVelocityWaypointMotion([push, waypoint(twist([0.0, 0.0, 0.0]))]))
    hand = franky.Gripper(address)
    return [*told, hand.move(0.03, 0.1), hand.width]


if __name__ == "__main__":
    print(json.dumps(globals()[sys.argv[1]](*sys.argv[2:])), flush=True)
