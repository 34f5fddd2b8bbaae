"""Explains what is wrong, or looks wrong, in a scenario's folder: prepares it and rehearses it.

The rehearsal runs it in memory, as `run` does, and looks for what will not go well on the way.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import SequenceMatcher
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...assets import STEP_SIZE
from ...controller.gains import PRESETS
from ...fmus.build.libraries import has_engine, mujoco_version
from ...fmus.errors import CosimError, InputError, did_you_mean
from ...fmus.interface.parameters import grouped
from ...fmus.interface.plant import PLANT
from ...fmus.interface.variables import Variable
from ...fmus.master.system import conversions, notes, read_fmus
from ...plant.plant import Plant, PlantParameters
from ...result.judging.contacts import Touch
from ...result.judging.holds import find_holds
from ...result.judging.limits import Level, outcome
from ...result.judging.verdict import MISSED, NOT_MEASURED, UNEXPECTED
from ...result.recording import Recording
from ...result.recording.reader import shapes_of
from ...run.execution import Execution
from ...run.prepare import Prepared, prepare
from ...run.result import Run
from ...run.start import (
    StartValues,
    carried_mass,
    check_tolerances,
    instants,
    late_pushes,
    law_gains,
    resolve,
    start_values,
    unsuitable_gains,
)
from ...run.stopping import StopRequest
from ...run.summary import unrecorded
from ...run.system.assembly import Assembly, system_scenario
from ...run.system.connector import OPTIONAL, Connector
from ...run.system.parts import UnreadSlaveError
from ...task.criteria import HELD_FORCE
from ...task.files import as_argument
from ...task.limits import LIMITS, saturated, shares, torque_rates
from ...task.scenario import SCENARIO_FILE, TABLE_FILE, Scenario, is_shipped, shipped_scenarios
from ...task.timing.demand import LimitViolation, find_violations
from ...task.timing.reference import joint_reference
from ...task.trajectory import TIME_TOLERANCE
from ...task.values import Values

SYSTEM: Final = ".ssp"
SHOWN: Final = 4  # limit violations that are listed
ALIKE: Final = 0.6  # of two names, as `SequenceMatcher` measures it
LOOKED_AT: Final = 20  # unconnected inputs
_SIDE: Final = re.compile(r"[_.]?(input|output|in|out|cmd|meas|measured)$", re.I)


@dataclass(frozen=True)
class Diagnostic:
    """One remark about a scenario."""

    # `wrong`: it cannot run; `refused` by the real robot; `hint`: it runs, but perhaps not as
    # intended; `good`.
    level: Level
    text: str  # what is wrong, where, and what would be right


def check_folder(
    folder: Path,
    values: Values | None = None,
    robot: str = "",
) -> list[Diagnostic]:
    """Check a scenario's folder, or an .ssp file, as `run` prepares it, also for a `robot`."""
    if folder.suffix != SYSTEM and not folder.is_dir():
        return _diagnostics("wrong", [_no_folder(folder)])
    try:
        scenario = read_checked(folder).changed(values or {})
        scenario = replace(scenario, preflight=robot or scenario.preflight)
        prepared = prepare(scenario, run_code=False)
        is_foreign = prepared.scenario.has_own_parts
        level: Level = "wrong" if robot else "hint"  # of conditions that are not measured
        diagnostics = _foreign(prepared, level) if is_foreign else _rehearsed(prepared)
    except UnreadSlaveError as error:
        text = f"{error}; connections and parameters are checked by a run"
        return _diagnostics("hint", [*_remarks(scenario), text])
    except (InputError, ValueError) as error:
        file = folder if folder.suffix == SYSTEM else folder / SCENARIO_FILE
        place = "" if str(error).startswith(str(folder)) else f"{file}: "
        return [Diagnostic("wrong", f"{place}{error}")]
    # An .ssp file has neither a purpose nor criteria.
    remarks = [] if folder.suffix == SYSTEM else [*_remarks(prepared.scenario)]
    remarks += unsuitable_gains(prepared.scenario, prepared.values)
    try:
        check_tolerances(prepared.scenario, prepared.assembly)
    except InputError as error:  # which `run` ignores, and `regress` refuses
        remarks.append(f"{SCENARIO_FILE}: {error}")
    if not has_engine(engine := prepared.scenario.mujoco):
        remarks.append(f"mujoco: {engine} is not installed, but would be by a run; checked with "
                       f"{mujoco_version()}")  # fmt: skip
    return [*_diagnostics("hint", remarks), *diagnostics]


def read_checked(path: Path) -> Scenario:
    """Read a scenario's folder, or what runs the system of an .ssp file."""
    return system_scenario(path) if path.suffix == SYSTEM else Scenario.read(path)


def _diagnostics(level: Level, texts: Iterable[str]) -> list[Diagnostic]:
    return [Diagnostic(level, text) for text in texts]


def _no_folder(folder: Path) -> str:
    """Return what to do about a folder that is not there."""
    if folder.is_file():
        return f"{folder}: not a folder; must be that of a scenario, such as {folder.parent}"
    near = did_you_mean(folder.name, shipped_scenarios())
    new = f"; `panda-cosim new {as_argument(folder)}` makes one that runs"
    return f"{folder}: no such folder{near or new}"


def _foreign(prepared: Prepared, level: Level) -> list[Diagnostic]:
    """Describe a scenario of other FMUs, whose code is not run; no robot's conditions are seen."""
    scenario, assembly = prepared.scenario, prepared.assembly
    fmus = read_fmus(assembly.system, prepared.start_values(), scenario.coupling)
    seen = (f"{name}: {text}" for name, _, text in notes(fmus, assembly.system, scenario.step))
    hints = _diagnostics("hint", [*assembly.notes, *_suggestions(assembly), *seen])
    hints += _diagnostics("good", conversions(fmus, assembly.system))
    hints += _order(prepared)
    models = ", ".join(f"{name} ({i.model})" for name, i in assembly.interfaces.items())
    count = len(assembly.connections)
    about = f"{scenario.name}: {models}, {count} connections, {scenario.duration:g} s"
    unseen = "no FMU was run; limits, collisions and grip are checked only with our own FMUs"
    if scenario.preflight:
        run = f"`panda-cosim run {_name(scenario)} --set preflight={scenario.preflight}`"
        text = f"what {scenario.preflight} refuses is not known before a run: {run}"
        hints.append(Diagnostic(level, text))
    columns = {column.name for column in assembly.recorded(scenario.coupling)}
    recorded = {*columns, *shapes_of(tuple(columns))}
    file = f"{scenario.folder}/{SCENARIO_FILE}"
    if lacking := [f"{file}: [success] {text}" for text in unrecorded(scenario.success, recorded)]:
        return [*_diagnostics("wrong", lacking), *hints]
    if len(assembly.interfaces) > 1 and not count:
        text = f"{about}; it runs, but its FMUs are not connected ({unseen})"
        return [*hints, Diagnostic("hint", text)]
    return [*hints, Diagnostic("good", f"{about}; it can run ({unseen})")]


def _order(prepared: Prepared) -> list[Diagnostic]:
    """Say in which order FMUs are stepped, if they are connected."""
    if not prepared.assembly.connections:
        return []
    return [Diagnostic("good", prepared.assembly.course(prepared.scenario.coupling))]


def _suggestions(assembly: Assembly) -> Iterator[str]:
    """Yield lines of [connect] for inputs that nothing feeds: shape, type, unit and name fit."""
    connector = Connector(assembly.parts)
    fed = {*assembly.external, *(connection.target for connection in assembly.connections)}
    unfed = (
        (part.name, variable)
        for part in assembly.parts
        if part.file is not None
        for variable in part.interface.of("input")
        if variable.name not in OPTIONAL
        if not any((part.name, name) in fed for name in variable.names())
    )
    for name, variable in islice(unfed, LOOKED_AT):
        source = _nearest(connector, name, variable)
        if source:
            target = f"{name}.{variable.name}"
            yield f'nothing feeds {target}; perhaps [connect] "{target}" = "{source}"'


def _nearest(connector: Connector, name: str, fed: Variable) -> str:
    """Return the output that fits an input: of a name like its own, or the only one of its unit."""
    fitting, stem = [], _SIDE.sub("", fed.name.lower())
    for part in connector.parts.values():
        for giving in part.interface.of("output") if part.name != name else ():
            with suppress(InputError):
                source = f"{part.name}.{giving.name}"
                connector.check(source, giving, f"{name}.{fed.name}", fed)
                alike = SequenceMatcher(None, _SIDE.sub("", giving.name.lower()), stem).ratio()
                fitting.append((alike, source, giving))
    likeness, source, _ = max(fitting, default=(0.0, "", fed), key=lambda each: each[0])
    if likeness >= ALIKE:
        return source
    same_unit = [each for each in fitting if fed.unit not in ("", "1") and each[2].unit]
    return same_unit[0][1] if len(same_unit) == 1 else ""


def _rehearsed(prepared: Prepared) -> list[Diagnostic]:
    """Run a scenario of our own FMUs in memory; say what goes wrong, and at last whether it can."""
    Plant(PlantParameters(**grouped(PLANT, prepared.values["plant"])))  # refuses its block's place
    scenario, run = prepared.scenario, rehearse(prepared)
    trouble = _diagnostics("hint", [*_located(run, prepared), *_limits(prepared)])
    lines = outcome(run.summary.preflight, complete=run.summary.complete)
    name = _name(scenario)
    real = [Diagnostic(level, text.replace("SCENARIO", name)) for level, text in lines]
    real += _order(prepared)
    if run.summary.verdict is NOT_MEASURED:  # what the criteria wait for never happens
        place = f"{scenario.folder}/{SCENARIO_FILE}: [success]"
        return [Diagnostic("wrong", f"{place} {run.summary.detail}"), *trouble, *real]
    about = _about(scenario)
    if trouble:
        count = f"{len(trouble)} problem{'s' if len(trouble) > 1 else ''}"
        last = Diagnostic("hint", f"{about}; it runs, but has the {count} above")
    else:
        if grip := weakest_grip(run.recording, prepared):
            about += f"; the grip holds {grip[1]:.3g} N by friction, {grip[2]:.3g} N needed"
        last = Diagnostic("good", f"{about}; it can run")
    return [*trouble, *real, last]


def _name(scenario: Scenario) -> str:
    """Return what commands take."""
    return scenario.name if is_shipped(scenario) else as_argument(Path(str(scenario.folder)))


def _about(scenario: Scenario) -> str:
    """Return in one line what was checked."""
    rows, pushes = len(scenario.rows), len(scenario.push)
    parts = [f"{scenario.name}: {rows} rows", f"{scenario.duration:g} s"]
    if pushes:
        parts.append(f"{pushes} push{'es' if pushes > 1 else ''}")
    if scenario.mismatch.values:
        parts.append(f"mismatch of {', '.join(scenario.mismatch.values)}")
    return ", ".join(parts)


def _located(run: Run, prepared: Prepared) -> Iterator[str]:
    """Yield what goes wrong, with the row that the hand is on its way to, or the last."""
    times = resolve(prepared.scenario, prepared.values).times
    for at, text in findings(run, prepared):
        place = SCENARIO_FILE
        if at is not None:
            row = min(int(np.searchsorted(times, at - TIME_TOLERANCE)) + 1, len(times))
            place = f"{TABLE_FILE}: row {row}"
        yield f"{place}: {text}"


# What the files alone show.


def _remarks(scenario: Scenario) -> Iterator[str]:
    if not scenario.purpose:
        yield f"{SCENARIO_FILE}: purpose is empty; one line should say what the scenario is for"
    if scenario.success == type(scenario.success)():
        yield f"{SCENARIO_FILE}: [success] is empty, so every run that reaches its end is a success"
    is_timed = scenario.timing != "table" or scenario.route
    if not is_timed and scenario.timing_share != Scenario.timing_share:
        yield f'{SCENARIO_FILE}: timing_share has no effect on a run with timing = "table"'
    if scenario.mismatch.seed and not scenario.mismatch.values:
        yield f"{SCENARIO_FILE}: [mismatch] seed has no effect, as nothing is drawn"
    last = 0.0 if scenario.is_system else scenario.rows[-1].time
    if last > scenario.duration:
        yield (
            f"{TABLE_FILE}: the last row is at {last:g} s, after the duration of "
            f"{scenario.duration:g} s: it is never reached"
        )
    yield from late_pushes(scenario)


def _limits(prepared: Prepared) -> Iterator[str]:
    """Check the path against the robot's limits; the tutorial's law ignores them."""
    scenario = prepared.scenario
    if not PRESETS[scenario.gains].use_reference:
        return
    violations, _ = feasibility(scenario, prepared.values)
    texts = [f"{TABLE_FILE}: {violation}" for violation in violations[:SHOWN]]
    if len(violations) > SHOWN:
        texts.append(f"{TABLE_FILE}: and {len(violations) - SHOWN} more violations")
    name = _name(scenario)
    if all(violation.quantity != "reach" for violation in violations):
        more = f"`panda-cosim retime {name} --keep-times` gives these rows more time"
    elif scenario.success.block_position:
        more = f"`panda-cosim route {name}` plans another path"
    else:
        more = "more time does not help: move the rows within reach, away from the stretched arm"
    if texts:
        texts[-1] += f"; {more}"
    yield from texts


def feasibility(
    scenario: Scenario, values: StartValues | None = None, share: float = 1.0
) -> tuple[list[LimitViolation], dict[str, float]]:
    """Compare a table's joint reference with the robot's limits."""
    # The controller itself, with its limits disabled and an ideal arm, turns the commands into the
    # reference; torques are those of the arm with the block in its hand where the fingers close.
    # Returns the worst violation of each kind in each row, and the largest share of each limit.
    values = values or start_values(scenario)
    trajectory = resolve(scenario, values)
    reference = joint_reference(trajectory, instants(scenario), law_gains(scenario, values))
    return find_violations(trajectory, reference, carried_mass(scenario, values), share)


Array = NDArray[np.float64]
Finding = tuple[float | None, str]  # time [s], or None for the whole run; and what is wrong then

GRAVITY: Final = 9.81  # [m/s^2]
SLIDING: Final = 0.05  # [m/s] of a held block on table or floor, above which it is no setting down
AWAY: Final = 0.001  # [m] of the hand from where it took the block or let it go
JOLT: Final = 0.02  # [s] for which the torques answer the begin or end of a push
SMOOTHING: Final = 50  # [ticks] over which forces and the hand's acceleration are averaged
FORCE_RATE: Final = 47.0  # [N/s] at which the force of a finger falls when it opens


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
        yield None, run.summary.detail
    for entry in run.summary.contact.get("unwanted", ())[:SHOWN]:
        yield entry["time_s"], f"{Touch(**entry)}; the path must avoid this: `panda-cosim route`"
    yield from _dragging(recording)
    yield from _servos(recording, prepared)
    yield from _grip(recording, prepared)
    yield from _releases(recording)
    if run.summary.verdict in (MISSED, UNEXPECTED):
        yield None, f"[success] {run.summary.detail}"


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
        for push in prepared.scenario.push:
            if any(0.0 <= at - edge < JOLT for edge in (push.start, push.start + push.duration)):
                yield at, f"{text}the push from t = {push.start:g} s causes it: push more gently"
                return
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
        if raised[hold.end - 1] and hold.let_go == hold.end < recording.rows:
            at = float(recording.time[hold.end])
            yield at, f"the block falls out of the closed fingers at t = {at:.3f} s"


def _raised(recording: Recording) -> NDArray[np.bool_]:
    """Whether the hand holds the block and is above where it took it, at each row."""
    raised, height = np.zeros(recording.rows, dtype=bool), recording["plant.hand_xpos"][:, 2]
    for hold in find_holds(recording):
        rows = slice(hold.grasp, hold.let_go)
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
        row = hold.let_go
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
