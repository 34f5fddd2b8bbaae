"""The robot's limits: the largest use of each, and what its real interface would refuse."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from ...assets.franka import ROBOTS, RobotLimits
from ...task.limits import LIMITS_OF, METRICS, reference_rates, robot_of, saturated, torque_rates
from ..recording import Recording, by_rows

Level = Literal["wrong", "refused", "hint", "good"]

DERIVATIVES: Final = ("velocity", "acceleration", "jerk")
ARMS: Final = {"fer": "panda", "fr3": "fr3"}  # as the key `robot` of a scenario has them


@dataclass(frozen=True)
class Check:
    """One condition of the interface; checks.toml says what the fields are."""

    interface: str
    error: str
    what: str
    unit: str
    remedy: str
    necessary: bool = True
    limit: str = "the limit"


_TABLES = tomllib.loads(Path(__file__).with_name("checks.toml").read_text(encoding="utf-8"))
REMEDIES: Final[Mapping[str, str]] = _TABLES.pop("remedies")  # what to change
# By the key of their largest share in summary.json.
CHECKS: Final[Mapping[str, Check]] = {
    key: Check(**entry | {"remedy": REMEDIES[entry["remedy"]]}) for key, entry in _TABLES.items()
}


def remedy_of(what: str, *, ours: bool) -> str:
    """Return what helps against a limit that held the arm back; `ours`: all FMUs are."""
    own = {name: REMEDIES[name] if ours else "" for name in ("retime", "noise", "weak")}
    return REMEDIES[what].format(**own)


def outcome(preflight: Mapping[str, Any], *, complete: bool) -> Iterator[tuple[Level, str]]:
    """Yield in lines what the robot would refuse, by that section of a run's summary.json."""
    if not preflight:
        return
    robot, own = preflight["robot"], preflight["interface"]
    if preflight["refusals"] is None:
        yield "wrong", f"{robot}: signals that the {own} interface is judged by are not recorded"
    elif not preflight["refusals"] and not complete:
        yield "hint", f"{robot} refuses nothing over the {own} interface up to where the run ended"
    elif not preflight["refusals"]:
        yield "good", f"{robot} refuses nothing over the {own} interface"
    for each in preflight["findings"]:
        if not each["necessary"]:
            yield "hint", f"{robot} recommends against: {_text(each)}"
        elif each["interface"] in (own, "arm"):
            yield "refused", f"{robot} refuses: {_text(each)}"
        else:
            yield "hint", f"{robot} refuses over the {each['interface']} interface: {_text(each)}"
    if (preflight["refusals"] or 0) > 1:
        yield "hint", f"{robot} stops at the first refusal; later ones may follow from it"
    if (one_more := preflight["late"].get("lost_packets")) and not preflight["joint_refusals"]:
        borne = f"{preflight['lost_packets']} lost packets in a row"
        yield "hint", f"{robot} tolerates {borne}; one more, and it refuses: {_text(one_more)}"


def _text(refusal: Mapping[str, Any]) -> str:
    """Describe the first violation of a condition."""
    row = f" (row {refusal['row']})" if refusal["row"] else ""
    joint = f" {refusal['joint']}" if refusal["what"].endswith("joint") else ""
    limit = refusal.get("limit", "the limit")
    share = f" (in the run up to {refusal['share']:.3g} times it)" if "share" in refusal else ""
    return (
        f"{refusal['error']} at t = {refusal['time_s']:.3f} s{row}: {refusal['what']}{joint} is "
        f"{refusal['value']:.4g} {refusal['unit']}; {limit} is {refusal['bound']:.4g} "
        f"{refusal['unit']}{share}; {refusal['remedy']}"
    )


Array = NDArray[np.float64]

HAND: Final = "plant.hand_xpos"
FORCE: Final = "plant.actuator_force"  # of the servos [N.m, N]
REFERENCE: Final = "controller.qvel_ref"
# Values 1 to 6 of `controller.limit`.
KINDS: Final = ("position", "velocity", "acceleration", "jerk", "torque", "torque rate")


def limit_shares(recording: Recording) -> dict[str, Any]:
    """Largest use of each robot limit, per joint or finger, 1 at the limit."""
    # Positions, speeds and torques are the plant's. Metrics named `reference_` are those of the
    # controller's joint reference: acceleration and jerk are finite differences between its
    # updates. The torque rate is that of the servos' torques, without their switching on.
    shares: dict[str, Any] = {}
    missing = {}
    controller = recording.metadata.get("parameters", {}).get("controller", {})
    for key in _USES:
        if key.startswith("reference_") and controller.get("impedance"):
            missing[key] = "the impedance law has no joint reference"
        elif reason := lacking(key, recording):
            missing[key] = reason
        elif not len(recording.time):
            missing[key] = "no row is recorded"
        else:
            shares[key] = [float(np.abs(used).max()) for used in shares_over_time(recording, key)]
    return shares | {"not_measured": missing}


def lacking(key: str, recorded: Container[str]) -> str:
    """Return which signal the use of a limit lacks, or ""."""
    # The hand tells our arm from another plant, whose joints these limits are not of.
    needed = (*_USES[key][0], *((HAND,) if not key.startswith("reference_") else ()))
    missing = [each.partition("[")[0] for each in needed if each not in recorded]
    return f"{missing[0]} is not recorded" if missing else ""


def all_lacking(recorded: Container[str]) -> str:
    """Return a signal without which no use of a limit is known, or ""."""
    reasons = [lacking(key, recorded) for key in _USES]
    return reasons[0] if all(reasons) else ""


def shares_over_time(recording: Recording, metric: str) -> Iterator[Array]:
    """Yield the use of a limit at each row (n,), joint by joint, 1 and -1 at the limit."""
    return iter(_USES[metric][1](recording))


Elements = Callable[[Recording], Iterable[Array]]  # each (n,), so that a long run takes little


def _robot(recording: Recording) -> RobotLimits:
    return ROBOTS[robot_of(recording.metadata)]


def _share(quantity: str, used: Elements) -> Elements:
    """Return the shares of a limit that does not depend on the position."""

    def shares(recording: Recording) -> Iterable[Array]:
        limit = LIMITS_OF[robot_of(recording.metadata)][quantity].bound
        return map(np.divide, used(recording), limit)

    return shares


def _positions(recording: Recording) -> Iterable[Array]:
    """Yield how far each joint is from the middle of its range."""
    low, high = _robot(recording).q_min, _robot(recording).q_max
    centre = (high + low) / 2
    away = map(np.subtract, _of("plant.qpos")(recording), centre)
    return map(np.divide, away, high - centre)


def _velocities(velocity: str, position: str) -> Elements:
    """Return the shares of the velocity limits at positions."""

    def shares(recording: Recording) -> Iterable[Array]:
        robot = _robot(recording)
        if not robot.approach:
            return map(np.divide, _of(velocity)(recording), robot.velocity)

        def used(q: Array, qd: Array) -> Array:
            return qd[:, :7] / robot.speed(q[:, :7], qd[:, :7])

        return by_rows(recording, used, position, velocity).T

    return shares


def _of(signal: str, first: int = 1, count: int = 7) -> Elements:
    return lambda recording: (recording[f"{signal}[{first + i}]"] for i in range(count))


def _torque_rates(recording: Recording) -> Iterable[Array]:
    has_torque = by_rows(recording, lambda torque: torque[:, :7].any(axis=1), FORCE)
    on = int(np.append(has_torque, True).argmax())
    return (torque_rates(torque, on) for torque in _of(FORCE)(recording))


def _reference_rates(order: int) -> Elements:
    """Return acceleration (0) or jerk (1) of the reference, at the controller's updates."""
    return lambda recording: (
        reference_rates(velocity, recording.metadata, held=False)[order]
        for velocity in _of(REFERENCE)(recording)
    )


_Q, _QD, _F = "plant.qpos[16]", "plant.qvel[9]", f"{FORCE}[7]"
_REF, _Q_REF = f"{REFERENCE}[7]", "controller.qpos_ref[7]"
# By metric: the signals that it needs, and the shares of the limit, joint by joint.
_USES: Final[Mapping[str, tuple[tuple[str, ...], Elements]]] = {
    "position_share": ((_Q,), _positions),
    "velocity_share": ((_QD, _Q), _velocities("plant.qvel", "plant.qpos")),
    "torque_share": ((_F,), _share("torque", _of(FORCE))),
    "torque_rate_share": ((_F,), _share("torque rate", _torque_rates)),
    "finger_speed_share": ((_QD,), _share("finger speed", _of("plant.qvel", 8, 2))),
    "reference_velocity_share": ((_REF, _Q_REF), _velocities(REFERENCE, "controller.qpos_ref")),
    "reference_acceleration_share": ((_REF,), _share("acceleration", _reference_rates(0))),
    "reference_jerk_share": ((_REF,), _share("jerk", _reference_rates(1))),
}


def largest_share(shares: Mapping[str, Any]) -> float | None:
    """Largest of all `limit_shares`; None if nothing was measured."""
    return max((max(shares[key]) for key in METRICS if key in shares), default=None)


def exceeded(shares: Mapping[str, Any]) -> list[str]:
    """List each kind of exceeded limit, such as "torque rate of joint 2 (176%)"."""
    lines = []
    for key, metric in METRICS.items():
        values = shares.get(key)
        most = int(np.argmax(values)) if values else 0
        if values and values[most] > 1.0:
            part = "finger" if key == "finger_speed_share" else "joint"
            share = f"{values[most]:.0%}"
            share = "just above 100%" if share == "100%" else share
            lines.append(f"{metric} of {part} {most + 1} ({share})")
    return lines


def first_limit(recording: Recording) -> dict[str, Any] | None:
    """Return `time_s`, `joint` (from 1) and `kind` of the limit that bound first, or None."""
    plant = recording.metadata.get("parameters", {}).get("plant", {})
    scale = np.array([plant.get(f"torque_limit_scale[{joint}]", 1.0) for joint in range(1, 8)])
    known = (FORCE, "controller.limit") if HAND in recording else ("controller.limit",)
    names = [name for name in known if f"{name}[7]" in recording]
    for time, *signals in recording.in_blocks("time", *names):
        by_name, kinds = dict(zip(names, signals, strict=True)), np.zeros((len(time), 7))
        if FORCE in by_name:
            kinds[saturated(by_name[FORCE][:, :7], scale)] = 1 + KINDS.index("torque")
        if "controller.limit" in by_name:
            limit = by_name["controller.limit"]
            kinds = np.where(limit > 0.0, limit, kinds)
        for row in np.flatnonzero(kinds.any(axis=1))[:1]:
            joint = int(np.flatnonzero(kinds[row])[0])
            kind = KINDS[int(kinds[row, joint]) - 1]
            return {"time_s": float(time[row]), "joint": joint + 1, "kind": kind}
    return None
