"""Runs a scenario in memory, as `run` does, and looks for what will not go well on the way."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...fmus.errors import CosimError
from ..judging.contacts import Touch
from ..judging.criterion import miss_text
from ..judging.holds import find_holds
from ..recording import Recording
from ..run.prepare import Prepared
from ..run.result import Run
from ..run.run import Execution
from ..run.stopping import StopRequest
from ..scenario.criteria import HELD_FORCE
from ..scenario.limits import LIMITS, saturated, shares, torque_rates

Array = NDArray[np.float64]
Finding = tuple[float | None, str]  # time [s], or None for the whole run; and what is wrong then

GRAVITY: Final = 9.81  # [m/s^2]
SLIDING: Final = 0.05  # [m/s] of a held block on table or floor, above which it is no setting down
AWAY: Final = 0.001  # [m] of the hand from where it took the block or let it go
SMOOTHING: Final = 50  # [ticks] over which forces and the hand's acceleration are averaged
FORCE_RATE: Final = 47.0  # [N/s] at which the force of a finger falls when it opens
SHOWN: Final = 4  # contacts that are listed


def rehearse(prepared: Prepared) -> Run:
    """Run what was prepared, without files; the summary says why it failed, if it did."""
    with Execution(prepared, writes=False) as execution:
        with suppress(CosimError):
            execution.advance(execution.ticks, StopRequest())
        return execution.close()


def findings(run: Run, prepared: Prepared) -> Iterator[Finding]:
    """Yield what goes wrong; first unwanted contacts, often the cause of the rest."""
    recording = run.recording
    if not run.summary.complete:
        yield None, str(run.summary.reason)
    for entry in run.summary.contact.get("unwanted", ())[:SHOWN]:
        yield entry["time_s"], f"{Touch(**entry)}; the path must lead around: `panda-cosim route`"
    yield from _dragging(recording)
    yield from _servos(recording, prepared)
    yield from _grip(recording, prepared)
    yield from _releases(recording)
    if prepared.scenario.expect == "success":
        for criterion in run.summary.criteria:
            if criterion.measured and not criterion.ok:
                yield None, f"[success] {miss_text(criterion)}"


def _dragging(recording: Recording) -> Iterator[Finding]:
    sliding = np.linalg.norm(recording["plant.qvel"][:, 9:11], axis=1) > SLIDING
    pressed = recording["plant.contact_force"] > HELD_FORCE
    for row in np.flatnonzero(sliding & pressed & (recording["plant.support_force"] > 0.0))[:1]:
        at = float(recording.time[row])
        text = f"the fingers drag or push the block along its support at t = {at:.3f} s; "
        yield at, text + "unless intended, lift it first, or set it down later"


def _servos(recording: Recording, prepared: Prepared) -> Iterator[Finding]:
    """Say which servo saturates first, and where the torque rate is too high."""
    torque, plant = recording["plant.actuator_force"][:, :7], prepared.values["plant"]
    scale = np.array([plant[f"torque_limit_scale[{joint}]"] for joint in range(1, 8)], dtype=float)
    full = saturated(torque, scale)
    for row in np.flatnonzero(full.any(axis=1))[:1]:
        joint, at = int(full[row].argmax()), float(recording.time[row])
        text = f"the servo of joint {joint + 1} saturates at t = {at:.3f} s, at "
        yield at, f"{text}{abs(torque[row, joint]):.3g} N.m; move more slowly, or carry less"
    rates = np.abs(shares("torque rate", torque_rates(torque)))
    row, joint = (int(i) for i in np.unravel_index(rates.argmax(), rates.shape))
    share = float(rates[row, joint])
    if share > 1.0:
        most, at = float(LIMITS["torque rate"].bound[joint]), float(recording.time[row])
        text = f"torque rate of joint {joint + 1} is {share * most:.3g} N.m/s at t = {at:.3f} s, "
        text += f"contacts included; must be at most {most:.3g} N.m/s ({share:.0%}); "
        noisy = "lower controller.ik_gain, or " if prepared.scenario.mismatch.has_sensors else ""
        yield at, f"{text}{noisy}move more slowly and touch more gently"


def _grip(recording: Recording, prepared: Prepared) -> Iterator[Finding]:
    """Compare friction with the block's weight and acceleration; say where it is lost."""
    weakest = weakest_grip(recording, prepared)
    if weakest is not None and weakest[1] < weakest[2]:
        at, force, needed = weakest
        text = f"at t = {at:.3f} s the grip holds {force:.3g} N by friction; the block needs "
        yield at, f"{text}{needed:.3g} N: grip more firmly, or move more slowly"
    raised = _raised(recording)
    for hold in find_holds(recording):
        if raised[hold.end - 1] and hold.release_command == hold.end < recording.rows:
            at = float(recording.time[hold.end])
            yield at, f"the block falls out of the closed fingers at t = {at:.3f} s"


def _raised(recording: Recording) -> NDArray[np.bool_]:
    """Whether the hand holds the block and is above where it took it, at each row."""
    raised, height = np.zeros(recording.rows, dtype=bool), recording["plant.hand_xpos"][:, 2]
    for hold in find_holds(recording):
        rows = slice(hold.grasp, hold.release_command)
        raised[rows] = height[rows] > height[hold.grasp] + AWAY
    return raised


def weakest_grip(recording: Recording, prepared: Prepared) -> tuple[float, float, float] | None:
    """Return time [s], friction [N] and need [N] where the grip is weakest while it carries."""
    carried = _raised(recording)
    if not carried.any():
        return None
    plant = prepared.values["plant"]
    force = _average(recording["plant.contact_force"])
    joints = recording["plant.qvel"][:, :7]
    speed = _average(np.einsum("nij,nj->ni", recording["plant.jac"][:, :3], joints))
    acceleration = np.diff(speed, axis=0, prepend=speed[:1]) / STEP_SIZE
    acceleration[:, 2] += GRAVITY
    needed = float(plant["block_mass"]) * np.linalg.norm(acceleration, axis=1)
    friction = float(plant["block_friction"]) * force
    row = np.flatnonzero(carried)[(friction[carried] / needed[carried]).argmin()]
    return float(recording.time[row]), float(friction[row]), float(needed[row])


def _releases(recording: Recording) -> Iterator[Finding]:
    """Say where the hand moves on before the fingers have let go."""
    command, force = recording["controller.pos_cmd"], recording["plant.contact_force"]
    for hold in find_holds(recording):
        row = hold.release_command
        if row >= hold.end:
            continue
        away = np.linalg.norm(command[row:] - command[row], axis=1) > AWAY
        pressing = 0.5 * float(force[row + int(away.argmax())]) if away.any() else 0.0
        if 2.0 * pressing > HELD_FORCE:
            at, longer = float(recording.time[row]), pressing / FORCE_RATE
            text = f"the hand moves on while each finger still presses with {pressing:.3g} N; it "
            yield at, f"{text}must stay {longer:.2f} s longer, or grip less"


def _average(values: Array) -> Array:
    """Average values (n, ...) over the last `SMOOTHING` rows, up to each."""
    padded = np.pad(values, [(SMOOTHING, 0), *[(0, 0)] * (values.ndim - 1)], mode="edge")
    total = padded.cumsum(axis=0)
    mean: Array = (total[SMOOTHING:] - total[:-SMOOTHING]) / SMOOTHING
    return mean
