"""One page of curves of a run, drawn from its recording alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
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
from ...fmus.replacing import replacing
from ..definition.rates import reference_rates, torque_rates
from .motion import (
    BLOCK_HEIGHT,
    FINGERS,
    SHAPES,
    FloatArray,
    Signals,
    closed_spans,
    describe_run,
    take,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE = (13.0, 12.8)  # [inch]
DPI = 110
TICKS_REACH = 200.0  # [%] of a limit, up to which the axis is marked at the limit and its half
ROWS_DRAWN = 8000  # points; more than the page's width in pixels; extremes are kept

# Okabe and Ito's colours, which colour-blind readers can tell apart, ordered so that neighbours
# differ in lightness, too; the yellow is left out, as it is too faint on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
INK = "#20242a"
GREY = "#6e747c"
SHADE = "#eef1f5"
CARET_DOWN = 11  # matplotlib's marker that points down from its position

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


@dataclass(frozen=True)
class Curves:
    """The drawn signals of a run, all at the same instants.

    Attributes:
        time: Instants (n,) [s].
        hand: Position of the hand (n, 3) [m].
        hand_cmd: Its command (n, 3) [m].
        qpos: Positions (n, 16) [rad, m].
        qvel: Joint velocities (n, 15) [rad/s].
        force: Forces of the servos (n, 8) [N.m, N].
        opening_cmd: Commanded opening between the fingertips (n,) [m].
        contact: Normal force of the fingers on the block (n,) [N].
        reference: Velocity of the joint reference (n, 7) [rad/s]; None: the law records none.
        metadata: Of the recording.
        waypoints: Instants of the table's rows (k,) [s], if the recording has them.
        names: Names of these rows, if any.
    """

    time: FloatArray
    hand: FloatArray
    hand_cmd: FloatArray
    qpos: FloatArray
    qvel: FloatArray
    force: FloatArray
    opening_cmd: FloatArray
    contact: FloatArray
    reference: FloatArray | None
    metadata: Mapping[str, Any]
    waypoints: FloatArray
    names: tuple[str, ...] = ()

    @property
    def error(self) -> FloatArray:
        """Distance of the hand from its command (n,) [mm]."""
        return np.asarray(1000 * np.linalg.norm(self.hand - self.hand_cmd, axis=1))


def plot_run(recording: Signals, path: str | Path) -> Path:
    """Write a PNG with the curves of a run: hand, error, gripper, block, joints and their limits.

    Args:
        recording: The run.
        path: The file to write.

    Returns:
        The path.

    Raises:
        InputError: The recording has no rows or lacks a signal, or the file cannot be written.
    """
    path = Path(path)
    figure = draw_run(recording)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI)
    return path


def draw_run(recording: Signals) -> Figure:
    """Return the figure of a run, for a notebook or a format other than PNG."""
    # Without pyplot, which keeps every figure and may need a screen.
    from matplotlib import rc_context  # noqa: PLC0415 - slow to import
    from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import

    curves = _curves(recording)
    with rc_context(STYLE):
        figure = Figure(figsize=SIZE, facecolor="white")
        grid = figure.subplots(5, 2, sharex=True)
        figure.subplots_adjust(
            left=0.06, right=0.975, bottom=0.043, top=0.907, hspace=0.27, wspace=0.15
        )
        panels = (
            (_plot_hand, _plot_error, _plot_opening, _plot_contact, _plot_block),
            (_plot_joint_positions, _plot_joint_speeds, _plot_jerk, _plot_torques, _plot_rates),
        )
        for column, functions in enumerate(panels):
            for row, panel in enumerate(functions):
                panel(grid[row, column], curves)
                _mark_time(grid[row, column], curves)
            grid[-1, column].set_xlabel("time [s]")
        _name_waypoints(grid[0, 0], curves)
        _write_title(figure, recording)
    return figure


def _curves(recording: Signals) -> Curves:
    """Return the drawn signals of a recording."""
    signals = take(recording, SHAPES)
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
        metadata=recording.metadata,
        waypoints=_waypoints(recording.metadata.get("row_times")),
        names=_names(recording.metadata.get("row_names")),
    )


def _reference(recording: Signals) -> FloatArray | None:
    """Return the velocity of the joint reference (n, 7) [rad/s]; None for a law without one."""
    try:
        return recording["controller.qvel_ref"]
    except (InputError, LookupError, ValueError):
        return None


def _names(names: object) -> tuple[str, ...]:
    """Return the names of the table's rows; none if the metadata is damaged."""
    return tuple(map(str, names)) if isinstance(names, list) else ()


def _waypoints(times: object) -> FloatArray:
    """Return the instants of the table's rows (k,) [s]; none if the metadata is damaged."""
    if not isinstance(times, list) or not all(isinstance(t, int | float) for t in times):
        return np.empty(0)
    return np.array(times, dtype=float)


def thin(values: FloatArray, count: int) -> Any:
    """Return at most `count` rows to draw a curve through.

    The smallest and the largest value of each stretch are kept, so that no peak is lost.

    Args:
        values: The curve (n,).
        count: Number of rows, at least 2.
    """
    if len(values) <= count:
        return slice(None)
    edges = np.linspace(0, len(values), count // 2 + 1).astype(int)
    kept = [
        begin + extreme(values[begin:end])
        for begin, end in pairwise(edges)
        for extreme in (np.argmin, np.argmax)
    ]
    return np.unique(kept)


def _draw(axes: Axes, time: FloatArray, values: FloatArray, **style: Any) -> None:
    """Draw one curve."""
    rows = thin(values, ROWS_DRAWN)
    axes.plot(time[rows], values[rows], **style)


def _plot_hand(axes: Axes, curves: Curves) -> None:
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


def _plot_error(axes: Axes, curves: Curves) -> None:
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


def _plot_opening(axes: Axes, curves: Curves) -> None:
    """Draw the opening of the gripper."""
    axes.set_title("Gripper opening")
    axes.set_ylabel("opening [mm]")
    opening = 1000 * curves.qpos[:, FINGERS].sum(axis=1)
    _draw(axes, curves.time, opening, color=COLOURS[0], linewidth=2.0, label="between fingertips")
    command = {"color": INK, "linewidth": 1.0, "dashes": (4, 2.5), "label": "command"}
    _draw(axes, curves.time, 1000 * curves.opening_cmd, **command)
    axes.set_ylim(-3, 1000 * OPENING_MAX * 1.08)
    _legend(axes, 2)


def _plot_contact(axes: Axes, curves: Curves) -> None:
    """Draw the contact force of the fingers."""
    axes.set_title("Contact force, fingers on block")
    axes.set_ylabel("normal force [N]")
    _draw(axes, curves.time, curves.contact, color=COLOURS[2])
    axes.set_ylim(0, 1.15 * max(float(curves.contact.max()), 1.0))


def _plot_joint_positions(axes: Axes, curves: Curves) -> None:
    """Draw the joint positions within their ranges: -100 % is the lower limit, 100 % the upper."""
    middle, half = (Q_MAX + Q_MIN) / 2, (Q_MAX - Q_MIN) / 2
    share = 100 * (curves.qpos[:, :7] - middle) / half
    axes.set_title("Joint positions")
    axes.set_ylabel("share of range [%]")
    _plot_shares(axes, curves.time, share)
    _legend(axes, 7)


def _plot_joint_speeds(axes: Axes, curves: Curves) -> None:
    """Draw the joint velocities as shares of their limits."""
    share = 100 * curves.qvel[:, :7] / QD_MAX
    axes.set_title(f"Joint velocities, {_peak(share)} of the limit at most")
    axes.set_ylabel("share of limit [%]")
    _plot_shares(axes, curves.time, share)


def _plot_torques(axes: Axes, curves: Curves) -> None:
    """Draw the servos' torques as shares of their limits."""
    share = 100 * curves.force[:, :7] / TORQUE_MAX
    axes.set_title(f"Joint torques, {_peak(share)} of the limit at most")
    axes.set_ylabel("share of limit [%]")
    _plot_shares(axes, curves.time, share)


def _plot_jerk(axes: Axes, curves: Curves) -> None:
    """Draw the jerk of the joint reference as shares of the limits."""
    axes.set_ylabel("share of limit [%]")
    if curves.reference is None:
        axes.set_title("Jerk of the reference: the law records no reference")
        return
    share = 100 * reference_rates(curves.reference, curves.metadata)[1] / QDDD_MAX
    axes.set_title(f"Jerk of the reference, {_peak(share)} of the limit at most")
    _plot_shares(axes, curves.time, share)


def _plot_rates(axes: Axes, curves: Curves) -> None:
    """Draw the rates of the servos' torques as shares of their limits."""
    share = 100 * torque_rates(curves.force[:, :7]) / TORQUE_RATE_MAX
    axes.set_title(f"Torque rates, {_peak(share)} of the limit at most")
    axes.set_ylabel("share of limit [%]")
    _plot_shares(axes, curves.time, share)


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


def _plot_block(axes: Axes, curves: Curves) -> None:
    """Draw the height of the block."""
    axes.set_title("Height of the block's centre")
    axes.set_ylabel("height [m]")
    height = curves.qpos[:, BLOCK_HEIGHT]
    _draw(axes, curves.time, height, color=COLOURS[1], linewidth=1.8)
    axes.set_ylim(min(0.0, float(height.min())), 1.15 * max(float(height.max()), 0.1))


def _name_waypoints(axes: Axes, curves: Curves) -> None:
    """Write the names of the waypoints at their marks."""
    begin, end = float(curves.time[0]), float(curves.time[-1])
    for time, name in zip(curves.waypoints, curves.names, strict=False):
        if name and begin <= time <= end:
            axes.text(
                time, 0.97, name, color=GREY, fontsize=6, rotation=90, ha="right", va="top",
                transform=axes.get_xaxis_transform(), parse_math=False,
            )  # fmt: skip


def _mark_time(axes: Axes, curves: Curves) -> None:
    """Shade the spans in which the gripper is commanded to close, and mark the waypoints."""
    begin, end = float(curves.time[0]), float(curves.time[-1])
    for span in closed_spans(curves.time, curves.opening_cmd):
        axes.axvspan(*span, color=SHADE, linewidth=0, zorder=0)
    inside = curves.waypoints[(curves.waypoints >= begin) & (curves.waypoints <= end)]
    axes.plot(
        inside,
        np.ones(len(inside)),
        color=GREY,
        marker=CARET_DOWN,
        markersize=4,
        linestyle="none",
        clip_on=False,
        transform=axes.get_xaxis_transform(),
    )
    axes.set_xlim(begin, max(end, begin + 1e-3))
    axes.tick_params(length=3)


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


def _write_title(figure: Figure, recording: Signals) -> None:
    """Write what ran above all panels."""
    title, details = describe_run(recording)
    # Names come from users: a pair of $ in them is not a formula.
    plain: dict[str, Any] = {"va": "top", "parse_math": False}
    figure.text(0.02, 0.979, title, fontsize=16, fontweight="bold", **plain)
    figure.text(0.02, 0.953, details, fontsize=10, color=GREY, **plain)
    note = "shaded: gripper commanded to close    ▾ waypoint of the table"
    figure.text(0.975, 0.953, note, fontsize=9, color=GREY, va="top", ha="right")
