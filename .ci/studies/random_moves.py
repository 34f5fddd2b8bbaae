"""Random straight moves of the hand from `home`, without FMUs.

`python .ci/studies/random_moves.py` tries 500 moves with the law in C, which has the bits of the
law in Python, and prints how many end at their goal. A goal is the pose of a random joint
configuration, so the arm reaches it; the straight way there may still lead past a singularity or a
joint's end. `--retimed` gives each move the time that it needs, so that it
keeps the torque rate, too. `--starts` lets each begin at a random joint configuration instead;
`--touch` counts the moves in which the controller reports a collision, and those in which it is a
false alarm: nothing touched the arm in the `RECENT` time before, and no joint was on its stop.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from panda_cosim.assets import STEP_SIZE
from panda_cosim.assets.franka import HOME_Q, HOME_XPOS, HOME_XQUAT, Q_MAX, Q_MIN, TORQUE_RATE_MAX
from panda_cosim.controller.controller import Controller
from panda_cosim.controller.gains import Gains
from panda_cosim.controller.model import load_arm
from panda_cosim.controller.touch import COLLISION
from panda_cosim.fmus.errors import InputError
from panda_cosim.plant.plant import Plant
from panda_cosim.task import rotations
from panda_cosim.task.limits import shares
from panda_cosim.task.timing.stretched import stretched
from panda_cosim.task.trajectory import Trajectory

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from law_support import LawInC, compile_law
from random_tasks import connect

Array = NDArray[np.float64]

SEED = 17
LARGEST_TURN = np.radians(120.0)  # [rad]
SPEED, TURN_RATE = 0.5, 1.0  # [m/s], [rad/s] at most
PEAK = 1.875  # of a quintic's speed, over its mean
LOWEST = 0.35  # [m] of the hand, so that no finger touches the table
NEAREST = 0.3  # [m] of the hand from joint 1's axis
RECENT = 0.02  # [s] before a collision, ten time constants of the observer
CAUSES = ("contact", "joint on its stop", "false alarm")
SETTLING = 0.5  # [s] after the move, before its end is measured
AT_GOAL = (0.001, 0.5)  # [m], [deg]


@dataclass(frozen=True)
class Move:
    """How a move went."""

    number: int  # from 1
    end_error: float  # distance from the goal at the end [m]
    end_turn: float  # angle from the goal at the end [deg]
    rms: float  # distance between hand and command over all ticks, root mean square [m]
    singular: bool  # whether the arm was near a singularity at the end
    limit: tuple[float, ...]  # kinds that bound the reference during the last tick (7,)
    share: float  # largest one of position, velocity, acceleration, jerk and torque limits [1]
    torque_rate: float = 0.0  # largest share of its limit, which the law does not enforce [1]
    update_us: float = 0.0  # processor time of an update [us]
    slower: float = 1.0  # its duration over that of the table [1]
    refused: str = ""  # why it got no other times
    off_path: float = 0.0  # largest distance of the hand from its straight path [m]
    collision: str = ""  # why the controller's observer reports one, if it does: one of `CAUSES`

    @property
    def ok(self) -> bool:
        """The hand is at its goal, and no limit that the law enforces was exceeded."""
        at_goal = self.end_error <= AT_GOAL[0] and self.end_turn <= AT_GOAL[1]
        return at_goal and self.share <= 1.0

    @property
    def keeps_all(self) -> bool:
        """It is ok, and the torque rate stayed below its limit, too."""
        return self.ok and self.torque_rate <= 1.0 and not self.refused


@dataclass(frozen=True)
class Start:
    """Where a move begins: joint positions [rad], and the hand's pose there, world."""

    q: Array
    position: Array
    orientation: Array


HOME = Start(np.array(HOME_Q), np.array(HOME_XPOS), np.array(HOME_XQUAT))


def random_starts(count: int, seed: int = SEED) -> Iterator[tuple[Start, tuple[Array, Array]]]:
    """Draw starts and goals in front of the robot; the first are always the same."""
    draw, model = np.random.default_rng(seed), load_arm()
    data: Any = mujoco.MjData(model)
    hand, last = model.body("hand").id, None
    while count:
        data.qpos[:7] = draw.uniform(Q_MIN, Q_MAX)
        mujoco.mj_kinematics(model, data)
        pose = Start(data.qpos[:7].copy(), data.xpos[hand].copy(), data.xquat[hand].copy())
        if pose.position[0] < NEAREST or pose.position[2] < LOWEST:
            continue
        if last is None:
            last = pose
            continue
        if np.linalg.norm(_turn(last.orientation, pose.orientation)) <= LARGEST_TURN:
            count -= 1
            yield last, (pose.position, pose.orientation)
        last = None


def random_goals(count: int, seed: int = SEED) -> Iterator[tuple[Array, Array]]:
    """Draw poses of the hand in front of the robot, world; the first are always the same."""
    draw, model = np.random.default_rng(seed), load_arm()
    data: Any = mujoco.MjData(model)
    hand = model.body("hand").id
    while count:
        data.qpos[:7] = draw.uniform(Q_MIN, Q_MAX)
        mujoco.mj_kinematics(model, data)
        position, orientation = data.xpos[hand].copy(), data.xquat[hand].copy()
        turned = np.linalg.norm(_turn(np.array(HOME_XQUAT), orientation)) <= LARGEST_TURN
        if turned and position[0] >= NEAREST and position[2] >= LOWEST:
            count -= 1
            yield position, orientation


def _turn(start: Array, end: Array) -> Array:
    """Rotation vector (3,) [rad] from one orientation to another, world frame."""
    return rotations.log(rotations.multiply(end, rotations.conjugate(start)))


def straight_move(position: Array, orientation: Array, start: Start = HOME) -> Trajectory:
    """Return the straight move from the start, as fast as `SPEED` and `TURN_RATE` allow."""
    way = np.linalg.norm(position - start.position) / SPEED
    turn = np.linalg.norm(_turn(start.orientation, orientation)) / TURN_RATE
    return Trajectory(
        times=np.array([0.0, max(PEAK * way, PEAK * turn, 0.5)]),
        positions=np.stack((start.position, position)),
        orientations=np.stack((start.orientation, orientation)),
        grips=np.full(2, 0.08),
    )


def our_controller(gains: Gains) -> Controller:
    """Make the project's controller."""
    return Controller(gains, STEP_SIZE)


def run_move(
    number: int,
    start: Start,
    goal: tuple[Array, Array],
    gains: Gains,
    make: Callable[[Gains], Any] = our_controller,
    timing_share: float | None = None,
) -> Move:
    """Move the hand along one line, with plant and controller in a plain loop.

    With a `timing_share` of the limits, the move gets the time that it needs within it.
    """
    position, orientation = goal
    trajectory = straight_move(position, orientation, start)
    slower, refused = 1.0, ""
    if timing_share:
        try:
            timing = stretched(trajectory, gains, 0.0, timing_share)
            slower = timing.cycle / trajectory.times[-1]
            trajectory = timing.trajectory
        except InputError as error:
            refused = str(error)
    ticks = round((trajectory.times[-1] + SETTLING) / STEP_SIZE)
    commands = trajectory.sample(STEP_SIZE * np.arange(ticks + 1))
    plant, controller = Plant(), make(gains)
    x, y = plant.outputs, controller.outputs
    begin_at(plant, start)
    busy = 0.0  # [s]
    off_path, errors = 0.0, np.empty(len(commands))
    collision, touched = "", np.full(2, -np.inf)  # touched: last ticks of a contact, on a stop
    motion = np.empty((4, len(commands), 7))
    for tick, command in enumerate(commands):
        if tick:
            plant.step()
        controller.input_values[: len(command)] = command
        connect(plant, controller)
        begun = time.thread_time()
        controller.update()
        busy += time.thread_time() - begun
        plant.inputs["ctrl"] = y["ctrl"]
        q = x["qpos"][:7]
        on_stop = ((q <= Q_MIN) | (q >= Q_MAX)).any()
        touched[[x["unwanted_contact_force"] > 0.0, on_stop]] = tick
        if not collision and (y["joint_contact"] == COLLISION).any():
            recent = (tick - touched) * STEP_SIZE <= RECENT
            collision = CAUSES[int(recent.argmax()) if recent.any() else 2]
        off_path = max(off_path, _off(x["hand_xpos"], start.position, position))
        errors[tick] = np.linalg.norm(x["hand_xpos"] - command[:3])
        motion[:, tick] = x["qpos"][:7], x["qvel"][:7], y["qvel_ref"], x["actuator_force"][:7]
    return Move(
        number,
        float(errors[-1]),
        float(np.degrees(np.linalg.norm(_turn(orientation, x["hand_xquat"])))),
        float(np.sqrt(np.mean(errors**2))),
        bool(y["singular"]),
        tuple(y["limit"].tolist()),
        _largest_share(motion),
        # But for the first two ticks, in which the servos take up what they hold.
        float(np.abs(np.diff(motion[3][2:], axis=0) / STEP_SIZE / TORQUE_RATE_MAX).max()),
        1e6 * busy / len(commands),
        slower,
        refused,
        off_path,
        collision,
    )


def begin_at(plant: Plant, start: Start) -> None:
    """Put the arm at a start, at rest."""
    if start is not HOME:
        plant.data.qpos[:7] = start.q
        plant.set_state(plant.get_state())


def _off(place: Array, start: Array, end: Array) -> float:
    """Distance of a place from the line between two others [m]."""
    way = end - start
    along = min(max(float((place - start) @ way / (way @ way)), 0.0), 1.0)
    return float(np.linalg.norm(place - start - along * way))


def _largest_share(motion: Array) -> float:
    """Largest share of any limit, of (qpos, qvel, qvel_ref, torque), each (n, 7)."""
    qpos, qvel, reference, torque = motion
    acceleration = np.diff(reference, axis=0) / STEP_SIZE
    used = (
        (qpos - (Q_MAX + Q_MIN) / 2) / ((Q_MAX - Q_MIN) / 2),
        shares("velocity", qvel),
        shares("velocity", reference),
        shares("acceleration", acceleration),
        shares("jerk", np.diff(acceleration, axis=0) / STEP_SIZE),
        shares("torque", torque),
    )
    return max(float(np.abs(share).max()) for share in used)


def run_moves(
    count: int,
    seed: int = SEED,
    gains: Gains | None = None,
    processes: int | None = None,
    make: Callable[[Gains], Any] = our_controller,
    only: Collection[int] = (),
    timing_share: float | None = None,
    starts: bool = False,
) -> list[Move]:
    """Run random moves, several at a time: all of them, or only those of some numbers."""
    drawn = random_starts(count, seed) if starts else ((HOME, g) for g in random_goals(count, seed))
    numbered = [(n, *way) for n, way in enumerate(drawn, 1) if not only or n in only]
    run = partial(run_move, gains=gains or Gains(), make=make, timing_share=timing_share)
    with ProcessPoolExecutor(processes) as pool:
        return list(pool.map(run, *zip(*numbered, strict=True), chunksize=2))


def main(arguments: Sequence[str] | None = None) -> int:
    """Try random straight moves, print what misses its goal; return how many did."""
    parser = argparse.ArgumentParser(
        prog="python .ci/studies/random_moves.py", description=main.__doc__
    )
    parser.add_argument("--count", type=int, default=500, help="number of moves")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the drawing")
    parser.add_argument("--processes", type=int, help="how many at a time; default: one a core")
    parser.add_argument(
        "--retimed",
        nargs="?",
        type=float,
        const=0.95,
        metavar="SHARE",
        help="give each move the time it needs within this share of the limits; default: 0.95",
    )
    parser.add_argument("--starts", action="store_true", help="begin at random joint positions")
    parser.add_argument("--touch", action="store_true", help="count collisions that are reported")
    options = parser.parse_args(arguments)
    with TemporaryDirectory() as folder:
        moves = run_moves(
            options.count,
            options.seed,
            Gains(observer=options.touch),
            processes=options.processes,
            make=partial(LawInC, compile_law(Path(folder))),
            timing_share=options.retimed,
            starts=options.starts,
        )
    failed = [move for move in moves if not (move.keeps_all if options.retimed else move.ok)]
    for move in failed:
        joints = [joint for joint, kind in enumerate(move.limit, 1) if kind]
        print(
            f"move {move.number}: {move.refused} {1e3 * move.end_error:.2f} mm, "
            f"{move.end_turn:.2f} deg from its goal, joints at limits: {joints or 'none'}"
            f"{', singular' if move.singular else ''}, share {move.share:.3f}, of the torque rate "
            f"{move.torque_rate:.1f}"
        )
    rms, rates = 1e3 * float(np.median([m.rms for m in moves])), [m.torque_rate for m in moves]
    print(
        f"{len(moves) - len(failed)} of {len(moves)} moves end within {1e3 * AT_GOAL[0]:g} mm and "
        f"{AT_GOAL[1]:g} deg with all limits kept{', torque rate included' * bool(options.retimed)}"
        f"; tracking RMS median {rms:.3f} mm; largest share of a limit "
        f"{max(move.share for move in moves):.3f}; torque rate above the robot's limit in "
        f"{sum(rate > 1.0 for rate in rates)} moves, largest share {max(rates):.1f}; "
        f"off the path by up to {1e3 * max(m.off_path for m in moves):.0f} mm"
    )
    if options.touch:
        collisions = {move.number: move.collision for move in moves if move.collision}
        print(
            f"{len(collisions)} collisions reported: "
            + ", ".join(f"{list(collisions.values()).count(cause)} {cause}" for cause in CAUSES)
        )
        print("".join(f"move {n}: {cause}\n" for n, cause in collisions.items()), end="")
    slower = np.array([move.slower for move in moves if not move.refused])
    if options.retimed:
        print(
            f"{len(moves) - len(slower)} were refused; the others take {np.median(slower):.2f} "
            f"times as long (median), 90 % below {np.percentile(slower, 90):.2f}, at most "
            f"{slower.max():.2f}"
        )
    return len(failed)


if __name__ == "__main__":
    raise SystemExit(min(main(), 1))
