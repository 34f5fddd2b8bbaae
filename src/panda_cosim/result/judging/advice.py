"""What went wrong in a run and what helps, from its recording and summary.

`run` and `check` say the same lines, in the order of time: causes come before their symptoms. What
helps is in advice.toml.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...assets.fields import Array
from ...fmus.interface.plant import FORCES
from ...task.criteria import HELD_FORCE
from ...task.scenario import TABLE_FILE
from ..recording import Recording
from .block import SUPPORT
from .contacts import SIGNAL as UNWANTED
from .contacts import Touch
from .holds import FORCE, HAND, Hold, find_holds
from .limits import exceeded
from .rows import table_row
from .summary import Metrics, Summary

Level = Literal["wrong", "refused", "hint", "good"]
Finding = tuple[float, str, str]  # when [s], what is wrong then, and which remedy helps

REMEDIES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
SINGULAR: Final = "controller.singular"
GRIPPER: Final = "controller.ctrl[8]"
GRADUAL: Final = 0.32  # of 255, in a tick, by which it may move
GRAVITY: Final = 9.81  # [m/s^2]
SLIDING: Final = 0.05  # [m/s] of a held block on table or floor, above which it is no setting down
AWAY: Final = 0.001  # [m] of the hand from where it took the block or let it go
SWING, SWUNG = 0.1, 0.9  # [s] and share of the torque with the other sign in that time
JOLT: Final = 0.02  # [s] for which the torques answer the begin or end of a push
SMOOTHING: Final = 50  # [ticks] over which forces and the hand's acceleration are averaged
FORCE_RATE: Final = 47.0  # [N/s] at which the force of a finger falls when it opens


def advise(recording: Recording, summary: Summary, *, ours: bool = True) -> Iterator[str]:
    """Yield what went wrong and what helps, in lines, each with the table's row.

    `ours`: all FMUs are; of others the block and its grip are not known, and no command takes them.
    """
    if not recording.rows:
        return
    found = [*_contacts(recording, summary), *_limits(recording, summary)]
    if ours:
        holds = find_holds(recording)
        found += (*_dragging(recording), *_grip(recording, holds), *_releases(recording, holds))
    put_in = {name: REMEDIES[name] if ours else "" for name in ("retime", "route", "noise", "weak")}
    for at, text, remedy in sorted(found):
        row = table_row(recording.metadata, at)
        place = f"{TABLE_FILE}: row {row}: " if row else ""
        helps = REMEDIES.get(remedy, remedy).format(**put_in)
        yield f"{place}{text}; {helps}" if helps else f"{place}{text}"


def _contacts(recording: Recording, summary: Summary) -> Iterator[Finding]:
    """Name the unwanted contacts, which often cause all that follows."""
    contacts = [Touch(**each) for each in summary.contact.get("unwanted", ())]
    # A task whose criteria all hold with these contacts, such as a peg in its hole, needs them.
    remedy = "" if summary.criteria and summary.success else "contact"
    for touch in contacts:
        yield touch.time_s, str(touch), remedy
    peak = summary.contact.get("unwanted_force_N")
    if peak and not contacts:
        at = float(recording.time[recording[UNWANTED].argmax()])
        yield at, f"unwanted contacts have up to {peak:.3g} N, at t = {at:.3f} s", remedy


def _dragging(recording: Recording) -> Iterator[Finding]:
    sliding = np.hypot(recording["plant.qvel[10]"], recording["plant.qvel[11]"]) > SLIDING
    pressed = (recording[FORCE] > HELD_FORCE) & (recording[SUPPORT] > 0.0)
    for row in np.flatnonzero(sliding & pressed)[:1]:
        at = float(recording.time[row])
        text = f"the fingers drag or push the block along its support at t = {at:.3f} s"
        yield at, text, "drag"


def _limits(recording: Recording, summary: Summary) -> Iterator[Finding]:
    """Name the robot limit that bound the controller first, and those that were exceeded."""
    causes = [(each["time_s"], "the contact") for each in summary.contact.get("unwanted", ())[:1]]
    if (collision := summary.events.get("collision")) is not None:
        causes.append((collision, f"the collision at t = {collision:.3f} s"))

    def remedy(at: float, name: str) -> str:
        after = [cause for cause in causes if cause[0] <= at]
        return f"it follows {max(after)[1]}" if after else name

    if first := summary.first_limit:
        at, kind = first["time_s"], f"{first['kind']} limit"
        text = f"the {kind} of joint {first['joint']} first limits the motion at t = {at:.3f} s"
        stretched = SINGULAR in recording and recording[SINGULAR][recording.time >= at][0]
        is_unstable = kind == "torque limit" and _swings(recording, at, first["joint"])
        helps = "singular" if stretched else "unstable" if is_unstable else kind
        yield at, text, remedy(at, helps)
        causes.append((at, f"the {kind}"))
    for name, share, at in exceeded(recording, summary.limits):
        causes += _pushes(recording, at)
        text = f"{name} is {share} of its limit at t = {at:.3f} s"
        kind = name.partition(" of ")[0]
        if kind == "finger speed" and not _is_commanded(recording, at):
            kind = "finger touch"
        yield at, text, remedy(at, kind) if kind in REMEDIES else ""


def _swings(recording: Recording, at: float, joint: int) -> bool:
    """Whether a joint's torque goes from limit to limit, as in a loop that is unstable."""
    soon = (recording.time >= at) & (recording.time < at + SWING)
    torque = recording[f"plant.actuator_force[{joint}]"][soon]
    return min(float(torque.max()), -float(torque.min())) > SWUNG * abs(float(torque[0]))


def _is_commanded(recording: Recording, at: float) -> bool:
    """Whether the gripper's command has just moved faster than the fingers can; if unknown, yes."""
    before = (recording.time > at - SWING) & (recording.time <= at)
    moves = np.diff(recording[GRIPPER][before]) if GRIPPER in recording else np.inf
    return bool((np.abs(moves) > GRADUAL).any())


def _pushes(recording: Recording, at: float) -> Iterator[tuple[float, str]]:
    """Yield when a push began or ended that the torques answer at an instant [s]."""
    rows = (recording.time > at - JOLT) & (recording.time <= at)
    for name in (f"plant.{force}" for force in FORCES.values()):
        if name in recording and np.diff(recording[name][rows], axis=0).any():
            yield at, "a push: push more gently"


def _grip(recording: Recording, holds: Sequence[Hold]) -> Iterator[Finding]:
    """Compare friction with the block's weight and acceleration; say where it is lost."""
    weakest, raised = weakest_grip(recording), _raised(recording, holds)
    if weakest is not None and weakest[1] < weakest[2]:
        at, force, needed = weakest
        text = f"at t = {at:.3f} s the grip holds {force:.3g} N by friction; the block needs "
        yield at, f"{text}{needed:.3g} N", "grip"
    for hold in holds:
        if raised[hold.end - 1] and hold.let_go == hold.end < recording.rows:
            at = float(recording.time[hold.end])
            yield at, f"the block falls out of the closed fingers at t = {at:.3f} s", "grip"


def _raised(recording: Recording, holds: Sequence[Hold]) -> NDArray[np.bool_]:
    """Whether the hand holds the block and is above where it took it, at each row."""
    raised, height = np.zeros(recording.rows, dtype=bool), recording[f"{HAND}[3]"]
    for hold in holds:
        rows = slice(hold.grasp, hold.let_go)
        raised[rows] = height[rows] > height[hold.grasp] + AWAY
    return raised


def weakest_grip(recording: Recording) -> tuple[float, float, float] | None:
    """Return time [s], friction [N] and need [N] where the grip is weakest while it carries."""
    carried = _raised(recording, find_holds(recording))
    if not carried.any():
        return None
    plant = recording.metadata["parameters"]["plant"]
    force, hand = _average(recording[FORCE]), recording[HAND]
    speed = _average(np.diff(hand, axis=0, prepend=hand[:1]) / STEP_SIZE)
    acceleration = np.diff(speed, axis=0, prepend=speed[:1]) / STEP_SIZE
    acceleration[:, 2] += GRAVITY
    needed = float(plant["block_mass"]) * np.linalg.norm(acceleration, axis=1)
    friction = float(plant["block_friction"]) * force
    row = np.flatnonzero(carried)[(friction[carried] / needed[carried]).argmin()]
    return float(recording.time[row]), float(friction[row]), float(needed[row])


def _releases(recording: Recording, holds: Sequence[Hold]) -> Iterator[Finding]:
    """Say where the hand moves on before the fingers have let go."""
    command, force = recording["controller.pos_cmd"], recording[FORCE]
    for hold in holds:
        row = hold.let_go
        if row >= hold.end:
            continue
        away = np.linalg.norm(command[row:] - command[row], axis=1) > AWAY
        pressing = 0.5 * float(force[row + int(away.argmax())]) if away.any() else 0.0
        if 2.0 * pressing > HELD_FORCE:
            at, longer = float(recording.time[row]), pressing / FORCE_RATE
            text = f"the hand moves on while each finger still presses with {pressing:.3g} N; it "
            yield at, f"{text}must stay {longer:.2f} s longer, or grip less", ""


def _average(values: Array) -> Array:
    """Average values (n, ...) over the last `SMOOTHING` rows, up to each."""
    padded = np.pad(values, [(SMOOTHING - 1, 0), *[(0, 0)] * (values.ndim - 1)], mode="edge")
    return np.asarray(sliding_window_view(padded, SMOOTHING, axis=0).mean(axis=-1))


def refusals(preflight: Metrics, *, complete: bool) -> Iterator[tuple[Level, str]]:
    """Yield in lines what the robot would refuse, by that section of a run's summary.json."""
    if not preflight:
        return
    robot, own = preflight["robot"], preflight["interface"]
    what = f"over the {own} interface"
    if own == "arm":  # a program's
        what = "of what the arm did; the program's commands were judged as they came"
    if preflight["refusals"] is None:
        yield "wrong", f"{robot}: signals that the {own} interface is judged by are not recorded"
    elif not preflight["refusals"]:
        until = "" if complete else " up to where the run ended"
        yield "good" if complete else "hint", f"{robot} refuses nothing {what}{until}"
    for each in preflight["findings"]:
        yield _told(robot, own, each)
    if (preflight["refusals"] or 0) > 1:
        yield "hint", f"{robot} stops at the first refusal; later ones may follow from it"
    if (one_more := preflight["late"].get("lost_packets")) and not preflight["joint_refusals"]:
        borne = f"{preflight['lost_packets']} lost packets in a row"
        yield "hint", f"{robot} tolerates {borne}; one more, and it refuses: {_refusal(one_more)}"


def _told(robot: str, own: str, found: Metrics) -> tuple[Level, str]:
    """Say which robot refuses a violation: over its own interface, or another one."""
    text, name = _refusal(found), found["interface"]
    if not found["necessary"]:
        return "hint", f"{robot} recommends against: {text}"
    if name in (own, "arm"):
        return "refused", f"{robot} refuses: {text}"
    return "hint", f"{robot} refuses over the {name} interface: {text}"


def _refusal(found: Metrics) -> str:
    """Describe the first violation of a condition."""
    row = f" (row {found['row']})" if found["row"] else ""
    joint = f" {found['joint']}" if found["what"].endswith("joint") else ""
    limit = found.get("limit", "the limit")
    share = f" (in the run up to {found['share']:.3g} times it)" if "share" in found else ""
    return (
        f"{found['error']} at t = {found['time_s']:.3f} s{row}: {found['what']}{joint} is "
        f"{found['value']:.4g} {found['unit']}; {limit} is {found['bound']:.4g} "
        f"{found['unit']}{share}; {found['remedy']}"
    )
