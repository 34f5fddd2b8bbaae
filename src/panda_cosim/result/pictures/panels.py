"""The panels of a run's plot: one table of what each shows."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...assets.fields import Array
from ...assets.franka import OPENING_MAX
from ...result.judging.holds import Hold, find_holds
from ...result.judging.limits import shares_over_time
from ..thinning import drawn_rows
from .motion import SHAPES, check_signals

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ...result.recording import Recording

DPI = 110

# Of pages and pictures. Curves have Okabe and Ito's colours, which colour-blind readers can tell
# apart, ordered so that neighbours differ in lightness, too, and two more.
_PALETTE = json.loads(Path(__file__).parents[1].joinpath("palette.json").read_text("utf-8"))
COLOURS = tuple(_PALETTE["curves"].values())
INK, GREY, SHADE, GOOD, BAD = map(_PALETTE["light"].get, ("ink", "muted", "soft", "good", "bad"))
STYLE = Path(__file__).with_name("plot.mplstyle")

COMMAND: dict[str, Any] = {"color": INK, "linewidth": 1.0, "dashes": (4, 2.5), "label": "command"}
HAND, POSITION = "plant.hand_xpos", "controller.pos_cmd"
BLOCK_HEIGHT = "plant.qpos[12]"  # z of its centre [m]
TICKS_REACH = 200.0  # [%] of a limit, up to which the axis is marked at the limit and its half
LIMIT = "share of limit [%]"
ROWS_DRAWN = 4000  # points of a curve; more than a page's width in pixels; extremes are kept


Panel = Callable[["Axes", "Curves"], None]


@dataclass(frozen=True)
class Curves:
    """A run to plot; each signal is read when it is drawn, as a long one takes much memory."""

    recording: Recording
    time: Array  # (n,) [s]
    holds: Sequence[Hold]
    waypoints: Array  # instants of the table's rows (k,) [s], if the recording has them
    names: tuple[str, ...] = ()  # of these rows, if any

    def __getitem__(self, column: str) -> Array:
        """Return a column (n,)."""
        return self.recording[column]


def read_curves(recording: Recording) -> Curves:
    """Return a recording to plot."""
    check_signals(recording, SHAPES)
    metadata = recording.metadata
    waypoints = np.array(metadata.get("row_times", ()), dtype=float)
    names = tuple(metadata.get("row_names", ()))
    return Curves(recording, recording.time, find_holds(recording), waypoints, names)


def trace(axes: Axes, time: Array, values: Array, **style: Any) -> None:
    """Draw a long curve through fewer points."""
    rows = drawn_rows([values], ROWS_DRAWN)
    axes.plot(time[rows], values[rows], **style)


def _legend(axes: Axes, columns: int) -> None:
    """Put the legend above the panel, to the right of its title, clear of the curves."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.015), ncols=columns)


def _hand(axes: Axes, curves: Curves) -> None:
    for index, name in enumerate("xyz"):
        style = {"color": COLOURS[index], "label": name, "linewidth": 2.2, "alpha": 0.75}
        trace(axes, curves.time, curves[f"{HAND}[{index + 1}]"], **style)
    for axis, label in enumerate((COMMAND["label"], "_", "_"), 1):  # one name in the legend
        trace(axes, curves.time, curves[f"{POSITION}[{axis}]"], **COMMAND | {"label": label})
    _legend(axes, 4)


def _error(axes: Axes, curves: Curves) -> None:
    axis = (curves[f"{HAND}[{i}]"] - curves[f"{POSITION}[{i}]"] for i in (1, 2, 3))
    error = np.asarray(1000 * np.sqrt(sum(away**2 for away in axis)))
    rms, peak = float(np.sqrt(np.mean(error**2))), int(np.argmax(error))
    trace(axes, curves.time, error, color=COLOURS[0])
    axes.axhline(rms, color=COLOURS[1], linewidth=1.1, dashes=(4, 2.5), label=f"RMS {rms:.3g} mm")
    label = f"max {error[peak]:.3g} mm at {curves.time[peak]:.2f} s"
    axes.plot(curves.time[peak], error[peak], "o", color=COLOURS[1], markersize=5, label=label)
    top = 1.12 * max(float(error[peak]), 1e-6)
    if math.isfinite(top):
        axes.set_ylim(0, top)
    _legend(axes, 2)


def _opening(axes: Axes, curves: Curves) -> None:
    opening = 1000 * (curves["plant.qpos[8]"] + curves["plant.qpos[9]"])  # of the two fingers
    trace(axes, curves.time, opening, color=COLOURS[0], linewidth=2.0, label="between fingertips")
    trace(axes, curves.time, 1000 * curves["controller.grip_cmd"], **COMMAND)
    axes.set_ylim(-3, 1000 * OPENING_MAX * 1.08)
    _legend(axes, 2)


def _contact(axes: Axes, curves: Curves) -> None:
    force = curves["plant.contact_force"]
    trace(axes, curves.time, force, color=COLOURS[2])
    axes.set_ylim(0, 1.15 * max(float(force.max()), 1.0))


def _block(axes: Axes, curves: Curves) -> None:
    height = curves[BLOCK_HEIGHT]
    trace(axes, curves.time, height, color=COLOURS[1], linewidth=1.8)
    axes.set_ylim(min(0.0, float(height.min())), 1.15 * max(float(height.max()), 0.1))


def _positions(axes: Axes, curves: Curves) -> None:
    """Draw the joint positions within their ranges: -100 % is the lower limit, 100 % the upper."""
    _draw_shares(axes, curves.time, shares_over_time(curves.recording, "position_share"))
    _legend(axes, 7)


def _limited(metric: str) -> Panel:
    """Return a panel of what has a limit for each joint, as shares of it."""

    def draw(axes: Axes, curves: Curves) -> None:
        what = axes.get_title(loc="left")
        peaks = _draw_shares(axes, curves.time, shares_over_time(curves.recording, metric))
        peak = f"{np.max(peaks):.0f} % (joint {int(np.argmax(peaks)) + 1})"
        axes.set_title(f"{what}, {peak} of the limit at most")

    return draw


def _draw_shares(axes: Axes, time: Array, shares: Iterator[Array]) -> list[float]:
    """Draw one curve per joint between the two limits; return the joints' peaks [%]."""
    for limit in (-100, 100):
        axes.axhline(limit, color=INK, linewidth=1.0, dashes=(1, 1.5))
    peaks = []
    for joint, share in enumerate(shares):
        label = f"{joint + 1}" if joint else "joint 1"
        trace(axes, time, 100 * share, color=COLOURS[joint], linewidth=1.2, label=label)
        peaks.append(100 * float(np.abs(share).max()))
    reach = 1.06 * float(np.max([100.0, *peaks]))
    if math.isfinite(reach):
        axes.set_ylim(-reach, reach)
    if reach < TICKS_REACH:
        axes.set_yticks([-100, -50, 0, 50, 100])
    return peaks


def _power(axes: Axes, curves: Curves) -> None:
    pairs = ((f"plant.actuator_force[{joint}]", f"plant.qvel[{joint}]") for joint in range(1, 8))
    trace(axes, curves.time, np.sum([curves[force] * curves[v] for force, v in pairs], axis=0))


def panels_of(recording: Recording) -> tuple[tuple[tuple[str, str, Panel], ...], ...]:
    """Return the panels; without a joint reference, the arm's power instead of its jerk."""
    names = [f"controller.qvel_ref[{joint}]" for joint in range(1, 8)]
    if names[-1] in recording.columns and any(recording[name].any() for name in names):
        return PANELS
    left, right = PANELS
    return left, (*right[:2], ("Power of the arm's servos", "power [W]", _power), *right[3:])


PANELS: tuple[tuple[tuple[str, str, Panel], ...], ...] = (
    (  # the left column, from top to bottom: title, axis, what is drawn
        ("Hand position in the world frame", "position [m]", _hand),
        ("Tracking error", "|hand - command| [mm]", _error),
        ("Gripper opening", "opening [mm]", _opening),
        ("Contact force, fingers on block", "normal force [N]", _contact),
        ("Height of the block's centre", "height [m]", _block),
    ),
    (
        ("Joint positions", "share of range [%]", _positions),
        ("Joint velocities", LIMIT, _limited("velocity_share")),
        ("Jerk of the reference", LIMIT, _limited("reference_jerk_share")),
        ("Joint torques", LIMIT, _limited("torque_share")),
        ("Torque rates", LIMIT, _limited("torque_rate_share")),
    ),
)
