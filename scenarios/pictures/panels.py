"""The panels of a run's plot, each a function of its axes and the curves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ...assets.franka import (
    OPENING_MAX,
    Q_MAX,
    Q_MIN,
    QD_MAX,
    QDDD_MAX,
    TORQUE_MAX,
    TORQUE_RATE_MAX,
)
from ...fmus.errors import InputError
from ..judging.holds import Hold, find_holds
from ..scenario.limits import reference_rates, torque_rates
from .motion import BLOCK_HEIGHT, FINGERS, SHAPES, FloatArray, Signals, take

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DPI = 110

# Okabe and Ito's colours, which colour-blind readers can tell apart, ordered so that neighbours
# differ in lightness, too; the yellow is left out, as it is too faint on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
INK = "#20242a"
GREY = "#6e747c"
SHADE = "#eef1f5"

STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "axes.labelsize": 9.5,
    "axes.edgecolor": "#9aa0a8",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.7,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.3,
    "lines.solid_capstyle": "round",
}

TICKS_REACH = 200.0  # [%] of a limit, up to which the axis is marked at the limit and its half
ROWS_DRAWN = 8000  # points; more than the page's width in pixels; extremes are kept


@dataclass(frozen=True)
class Curves:
    """The drawn signals of a run, all at the same instants."""

    time: FloatArray  # (n,) [s]
    hand: FloatArray  # position (n, 3) [m]
    hand_cmd: FloatArray  # (n, 3) [m]
    qpos: FloatArray  # (n, 16) [rad, m]
    qvel: FloatArray  # (n, 15) [rad/s]
    force: FloatArray  # of the servos (n, 8) [N.m, N]
    opening_cmd: FloatArray  # between the fingertips (n,) [m]
    contact: FloatArray  # normal force of the fingers on the block (n,) [N]
    reference: FloatArray | None  # velocity (n, 7) [rad/s]; None: the law records none
    holds: Sequence[Hold]
    metadata: Mapping[str, Any]
    waypoints: FloatArray  # instants of the table's rows (k,) [s], if the recording has them
    names: tuple[str, ...] = ()  # of these rows, if any

    @property
    def error(self) -> FloatArray:
        """Distance of the hand from its command (n,) [mm]."""
        return np.asarray(1000 * np.linalg.norm(self.hand - self.hand_cmd, axis=1))


def read_curves(recording: Signals) -> Curves:
    """Return the drawn signals of a recording."""
    signals = take(recording, SHAPES)
    names = recording.metadata.get("row_names")
    return Curves(
        time=recording.time,
        hand=signals["plant.hand_xpos"],
        hand_cmd=signals["controller.pos_cmd"],
        qpos=signals["plant.qpos"],
        qvel=signals["plant.qvel"],
        force=signals["plant.actuator_force"],
        opening_cmd=signals["controller.grip_cmd"],
        contact=signals["plant.contact_force"],
        reference=_reference(recording),
        holds=find_holds(recording),
        metadata=recording.metadata,
        waypoints=_numbers(recording.metadata.get("row_times")),
        names=tuple(map(str, names)) if isinstance(names, list) else (),
    )


def _reference(recording: Signals) -> FloatArray | None:
    """Return the velocity of the joint reference (n, 7) [rad/s]; None for a law without one."""
    try:
        return recording["controller.qvel_ref"]
    except (InputError, LookupError, ValueError):
        return None


def _numbers(values: object) -> FloatArray:
    """Return a list of numbers (k,); none if the metadata is damaged."""
    if not isinstance(values, list) or not all(isinstance(v, int | float) for v in values):
        return np.empty(0)
    return np.array(values, dtype=float)


def thin(values: FloatArray, count: int) -> Any:
    """Return at most `count` rows to draw a curve through.

    The smallest and the largest value of each stretch are kept, so that no peak is lost.
    """
    if len(values) <= count:
        return slice(None)
    edges = np.linspace(0, len(values), count // 2 + 1).astype(int)
    extremes = [
        begin + extreme(values[begin:end])
        for begin, end in pairwise(edges)
        for extreme in (np.argmin, np.argmax)
    ]
    return np.unique(extremes)


def _draw(axes: Axes, time: FloatArray, values: FloatArray, **style: Any) -> None:
    """Draw one curve."""
    rows = thin(values, ROWS_DRAWN)
    axes.plot(time[rows], values[rows], **style)


def hand(axes: Axes, curves: Curves) -> None:
    """Draw the position of the hand and its command."""
    axes.set_title("Hand position in the world frame")
    axes.set_ylabel("position [m]")
    for index, name in enumerate("xyz"):
        style = {"color": COLOURS[index], "label": name, "linewidth": 2.2, "alpha": 0.75}
        _draw(axes, curves.time, curves.hand[:, index], **style)
    for index in range(3):
        style = {"color": INK, "linewidth": 1.0, "dashes": (4, 2.5)}
        label = {"label": "command"} if index == 0 else {}
        _draw(axes, curves.time, curves.hand_cmd[:, index], **style, **label)
    _legend(axes, 4)


def error(axes: Axes, curves: Curves) -> None:
    """Draw the distance of the hand from its command."""
    error = curves.error
    rms, peak = float(np.sqrt(np.mean(error**2))), int(np.argmax(error))
    axes.set_title("Tracking error")
    axes.set_ylabel("|hand - command| [mm]")
    _draw(axes, curves.time, error, color=COLOURS[0])
    axes.axhline(rms, color=COLOURS[1], linewidth=1.1, dashes=(4, 2.5), label=f"RMS {rms:.3g} mm")
    axes.plot(
        curves.time[peak],
        error[peak],
        "o",
        color=COLOURS[1],
        markersize=5,
        label=f"max {error[peak]:.3g} mm at {curves.time[peak]:.2f} s",
    )
    top = 1.12 * max(float(error[peak]), 1e-6)
    if math.isfinite(top):
        axes.set_ylim(0, top)
    _legend(axes, 2)


def opening(axes: Axes, curves: Curves) -> None:
    """Draw the opening of the gripper."""
    axes.set_title("Gripper opening")
    axes.set_ylabel("opening [mm]")
    opening = 1000 * curves.qpos[:, FINGERS].sum(axis=1)
    _draw(axes, curves.time, opening, color=COLOURS[0], linewidth=2.0, label="between fingertips")
    command = {"color": INK, "linewidth": 1.0, "dashes": (4, 2.5), "label": "command"}
    _draw(axes, curves.time, 1000 * curves.opening_cmd, **command)
    axes.set_ylim(-3, 1000 * OPENING_MAX * 1.08)
    _legend(axes, 2)


def contact(axes: Axes, curves: Curves) -> None:
    """Draw the contact force of the fingers."""
    axes.set_title("Contact force, fingers on block")
    axes.set_ylabel("normal force [N]")
    _draw(axes, curves.time, curves.contact, color=COLOURS[2])
    axes.set_ylim(0, 1.15 * max(float(curves.contact.max()), 1.0))


def joint_positions(axes: Axes, curves: Curves) -> None:
    """Draw the joint positions within their ranges: -100 % is the lower limit, 100 % the upper."""
    middle, half = (Q_MAX + Q_MIN) / 2, (Q_MAX - Q_MIN) / 2
    share = 100 * (curves.qpos[:, :7] - middle) / half
    axes.set_title("Joint positions")
    axes.set_ylabel("share of range [%]")
    _plot_shares(axes, curves.time, share)
    _legend(axes, 7)


def joint_speeds(axes: Axes, curves: Curves) -> None:
    """Draw the joint velocities."""
    _plot_limited(axes, curves.time, "Joint velocities", curves.qvel[:, :7] / QD_MAX)


def torques(axes: Axes, curves: Curves) -> None:
    """Draw the servos' torques."""
    _plot_limited(axes, curves.time, "Joint torques", curves.force[:, :7] / TORQUE_MAX)


def jerk(axes: Axes, curves: Curves) -> None:
    """Draw the jerk of the joint reference."""
    if curves.reference is None:
        axes.set_title("Jerk of the reference: the law records no reference")
        axes.set_ylabel("share of limit [%]")
        return
    share = reference_rates(curves.reference, curves.metadata)[1] / QDDD_MAX
    _plot_limited(axes, curves.time, "Jerk of the reference", share)


def rates(axes: Axes, curves: Curves) -> None:
    """Draw the rates of the servos' torques."""
    share = torque_rates(curves.force[:, :7]) / TORQUE_RATE_MAX
    _plot_limited(axes, curves.time, "Torque rates", share)


def _plot_limited(axes: Axes, time: FloatArray, what: str, share: FloatArray) -> None:
    """Draw what has a limit for each joint, as shares of it (n, 7) [1]."""
    percent = 100 * share
    axes.set_title(f"{what}, {_peak(percent)} of the limit at most")
    axes.set_ylabel("share of limit [%]")
    _plot_shares(axes, time, percent)


def _peak(share: FloatArray) -> str:
    """Return the largest share [%] and its joint."""
    joint = int(np.argmax(np.abs(share).max(axis=0)))
    return f"{np.abs(share).max():.0f} % (joint {joint + 1})"


def _plot_shares(axes: Axes, time: FloatArray, share: FloatArray) -> None:
    """Draw one curve per joint between the two limits, -100 and 100 %."""
    for limit in (-100, 100):
        axes.axhline(limit, color=INK, linewidth=1.0, dashes=(1, 1.5))
    for joint in range(7):
        label = f"{joint + 1}" if joint else "joint 1"
        style = {"color": COLOURS[joint], "linewidth": 1.2, "label": label}
        _draw(axes, time, share[:, joint], **style)
    reach = 1.06 * max(100.0, float(np.abs(share).max()))
    if math.isfinite(reach):
        axes.set_ylim(-reach, reach)
    if reach < TICKS_REACH:
        axes.set_yticks([-100, -50, 0, 50, 100])


def block(axes: Axes, curves: Curves) -> None:
    """Draw the height of the block."""
    axes.set_title("Height of the block's centre")
    axes.set_ylabel("height [m]")
    height = curves.qpos[:, BLOCK_HEIGHT]
    _draw(axes, curves.time, height, color=COLOURS[1], linewidth=1.8)
    axes.set_ylim(min(0.0, float(height.min())), 1.15 * max(float(height.max()), 0.1))


def _legend(axes: Axes, columns: int) -> None:
    """Put the legend above the panel, to the right of its title, clear of the curves."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.015),
        ncols=columns,
        columnspacing=1.2,
        borderaxespad=0.0,
        borderpad=0.25,
    )


PANELS = (  # from top to bottom, the left column and the right one
    (hand, error, opening, contact, block),
    (joint_positions, joint_speeds, jerk, torques, rates),
)
