"""Picks the block up, with franky: `python pick.py [ADDRESS]`."""

import sys

from franky import Affine, CartesianMotion, Gripper, RealtimeConfig, Robot

BLOCK = (0.40, -0.20, 0.05)  # its centre [m]
DOWN = [1.0, 0.0, 0.0, 0.0]  # orientation of the hand (x, y, z, w)
SLOW = {"relative_dynamics_factor": 0.3}


def above(height):
    """Return the pose of the fingertips so far above the block's centre [m]."""
    x, y, z = BLOCK
    return Affine([x, y, z + height], DOWN)


def main(address="127.0.0.1"):
    """Open the hand, take the block, and lift it."""
    robot, gripper = Robot(address, realtime_config=RealtimeConfig.Ignore), Gripper(address)
    robot.relative_dynamics_factor = 0.3
    robot.set_collision_behavior(100.0, 100.0)  # N.m, N
    gripper.open(0.1)
    robot.move(CartesianMotion(above(0.16)))
    robot.move(CartesianMotion(above(0.02), **SLOW))
    held = gripper.grasp(0.06, 0.05, 30.0, epsilon_inner=0.01, epsilon_outer=0.01)
    print(f"grasp: {held}, {1000.0 * gripper.width:.1f} mm between the fingers")
    robot.move(CartesianMotion(above(0.17), **SLOW))


main(*sys.argv[1:])
