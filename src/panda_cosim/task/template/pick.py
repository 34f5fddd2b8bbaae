"""Picks the block up, with pylibfranka alone: `python pick.py [ADDRESS]`."""

import sys

import numpy as np
from pylibfranka import CartesianPose, ControllerMode, Gripper, RealtimeConfig, Robot

BLOCK = np.array([0.4, -0.2, 0.05])  # its centre [m]
ABOVE = np.array([0.0, 0.0, 0.16])  # from there to where the fingers are clear of it [m]
GRIP = np.array([0.0, 0.0, 0.02])  # and to where they take it [m]
TORQUES, FORCES = [40.0] * 7, [40.0] * 6  # at which a contact is a collision [N.m], [N]


def move(robot, place, seconds):
    """Move the fingertips straight to a place (3,) [m], at rest at both ends."""
    control = robot.start_cartesian_pose_control(ControllerMode.JointImpedance)
    state, _ = control.readOnce()
    pose, time = np.array(state.O_T_EE_d), 0.0  # 4 x 4, column by column
    start = pose[12:15].copy()
    while True:
        u = min(time / seconds, 1.0)
        pose[12:15] = start + (10 * u**3 - 15 * u**4 + 6 * u**5) * (place - start)
        command = CartesianPose(pose.tolist())
        command.motion_finished = u == 1.0
        control.writeOnce(command)
        if u == 1.0:
            return
        _, elapsed = control.readOnce()
        time += elapsed.to_sec()


def main(address="127.0.0.1"):
    """Open the hand, take the block, and lift it."""
    # The default, kEnforce, demands a real-time kernel.
    robot, gripper = Robot(address, RealtimeConfig.kIgnore), Gripper(address)
    robot.set_collision_behavior(TORQUES, TORQUES, FORCES, FORCES)
    gripper.move(0.08, 0.1)
    move(robot, BLOCK + ABOVE, 2.0)
    move(robot, BLOCK + GRIP, 1.5)
    if not gripper.grasp(0.06, 0.05, 30.0, epsilon_inner=0.01, epsilon_outer=0.01):
        sys.exit("the fingers hold nothing")
    move(robot, BLOCK + ABOVE, 1.5)
    print(f"lifted, {1000.0 * gripper.read_once().width:.1f} mm between the fingers")


main(*sys.argv[1:])
