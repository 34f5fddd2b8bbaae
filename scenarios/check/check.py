"""Explains what is wrong, or looks wrong, in a scenario's folder."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from ...controller.gains import PRESETS
from ...fmus.errors import InputError
from ...fmus.interface.parameters import ParameterValue, grouped
from ...fmus.interface.plant import PLANT
from ...fmus.master.system import read_fmus, step_notes
from ...plant.plant import Plant, PlantParameters
from ..compare.reference import REFERENCE_FILE, Reference
from ..files import as_argument
from ..judging.criterion import miss_text
from ..run.options import Options
from ..run.prepare import Prepared, prepare
from ..run.settings import with_values
from ..run.start import Overrides, resolve, start_values
from ..scenario.scenario import (
    NO_TABLE,
    SCENARIO_FILE,
    TABLE_FILE,
    Scenario,
    is_shipped,
    shipped_scenarios,
)
from ..scenario.table import TableRow, TrajectoryTable
from ..scenario.trajectory import TIME_TOLERANCE, Trajectory
from ..system.assembly import Assembly
from ..system.parts import UnreadSlaveError
from .feasibility import check_feasibility
from .rehearsal import Rehearsal, findings, rehearse, weakest_grip

Level = Literal["wrong", "hint", "good"]
Look = Callable[[Scenario], Iterator[str]]

REACH: Final = 0.855  # [m] from the shoulder to the flange, Franka's data sheet
SHOULDER: Final = (0.0, 0.0, 0.333)  # [m] joint 2, world frame
FLOOR: Final = 0.105  # [m] of the hand's origin, when the fingertips touch the floor
SHOWN: Final = 4  # limit violations that are listed
FORCE_RATE: Final = 47.0  # [N/s] at which the force of a finger falls when it is told to open


# Stands in for a table that cannot be read, so that the settings are checked all the same.
_ANY_TABLE: Final = TrajectoryTable(
    tuple(TableRow(time, "home", (0.0, 0.0, 0.0), 0.08) for time in (0.0, 1.0))
)


@dataclass(frozen=True)
class Diagnostic:
    """One remark about a scenario.

    Attributes:
        level: `wrong`: it cannot run; `hint`: it runs, but perhaps not as intended; `good`.
        text: What is wrong, where, and what would be right.
    """

    level: Level
    text: str


def check_folder(
    folder: Path,
    overrides: Overrides | None = None,
    settings: Mapping[str, ParameterValue] | None = None,
) -> list[Diagnostic]:
    """Check a scenario's folder."""
    try:
        wrong, prepared = _prepared(folder, Options(overrides=overrides or {}), settings or {})
    except UnreadSlaveError as error:
        text = f"{error}; connections and parameters are checked by a run"
        return [*_hints(Scenario.read(folder), FOREIGN_HINTS), Diagnostic("hint", text)]
    if prepared is None:
        return [Diagnostic("wrong", text) for text in wrong]
    scenario = prepared.scenario
    if scenario.has_own_parts:
        return [*_hints(scenario, FOREIGN_HINTS), *_foreign(scenario, prepared.assembly)]
    seen, hints = rehearse(prepared), _hints(scenario, HINTS)
    trouble = [Diagnostic("hint", text) for text in _located(seen, prepared)]
    trouble += _hints(scenario, (_limits,))
    if wrong := list(_unmeasured(scenario, seen)):
        return [*(Diagnostic("wrong", text) for text in wrong), *hints, *trouble]
    about = _about(scenario)
    if trouble:
        count = f"{len(trouble)} problem{'s' if len(trouble) > 1 else ''}"
        last = Diagnostic("hint", f"{about}; it can be started, but has the {count} above")
    else:
        if grip := weakest_grip(seen.recording, prepared):
            about += f"; the grip holds {grip[1]:.3g} N by friction, {grip[2]:.3g} N needed"
        last = Diagnostic("good", f"{about}; it can run")
    return [*hints, *trouble, last]


def _about(scenario: Scenario) -> str:
    """Return in one line what was checked."""
    rows, pushes = len(scenario.table.rows), len(scenario.push)
    parts = [f"{scenario.name}: {rows} rows", f"{scenario.duration:g} s"]
    if pushes:
        parts.append(f"{pushes} push{'es' if pushes > 1 else ''}")
    if scenario.mismatch.values:
        parts.append(f"mismatch of {', '.join(scenario.mismatch.values)}")
    return ", ".join(parts)


def _unmeasured(scenario: Scenario, seen: Rehearsal) -> Iterator[str]:
    """Yield the criteria that a run gives no value, as what they wait for never happens."""
    for criterion in () if seen.failure else seen.summary.criteria:
        if not criterion.measured:
            yield f"{scenario.folder}/{SCENARIO_FILE}: [success] {miss_text(criterion)}"


def _located(seen: Rehearsal, prepared: Prepared) -> Iterator[str]:
    """Yield what goes wrong, with the row that the hand is on its way to, or the last."""
    times = resolve(prepared.scenario, prepared.values).times
    for at, text in findings(seen, prepared):
        if at is None:
            yield f"{TABLE_FILE}: {text}"
        else:
            row = min(int(np.searchsorted(times, at - TIME_TOLERANCE)) + 1, len(times))
            yield f"{TABLE_FILE}: row {row}: {text}"


def _hints(scenario: Scenario, looks: Iterable[Look]) -> list[Diagnostic]:
    return [Diagnostic("hint", text) for look in looks for text in look(scenario)]


def _foreign(scenario: Scenario, assembly: Assembly) -> list[Diagnostic]:
    """Describe a scenario of other FMUs, whose code was not run."""
    fmus = ", ".join(f"{name} ({i.model})" for name, i in assembly.interfaces.items())
    count = len(assembly.connections)
    about = f"{scenario.name}: {fmus}, {count} connections, {scenario.duration:g} s"
    unseen = "limits, collisions and grip are checked only with the project's plant and controller"
    steps = step_notes(read_fmus(assembly.system, {}, isolate=True), scenario.step)
    told = [*assembly.notes, *(f"{name}: {text}" for name, _, text in steps)]
    notes = [Diagnostic("hint", note) for note in told]
    if len(assembly.interfaces) > 1 and not count:
        text = f"{about}; it can be started, but its FMUs are not connected ({unseen})"
        return [*notes, Diagnostic("hint", text)]
    return [*notes, Diagnostic("good", f"{about}; it can run ({unseen})")]


def _is_system(folder: Path) -> bool:
    try:
        return Scenario.read(folder).is_system
    except InputError:
        return False


def _prepared(
    folder: Path, options: Options, settings: Mapping[str, ParameterValue]
) -> tuple[list[str], Prepared | None]:
    """Prepare a run as `run` does, up to where the FMUs would be instantiated."""
    if folder.is_file():
        return [f"{folder}: is a file; must be a scenario's folder, such as {folder.parent}"], None
    if not folder.is_dir():
        return [f"{folder}: no such folder; {_instead(folder)}"], None
    table, wrong = NO_TABLE if _is_system(folder) else _ANY_TABLE, []
    try:
        if table is not NO_TABLE:
            table = TrajectoryTable.read(folder / TABLE_FILE)
    except InputError as error:
        wrong.append(str(error))
    try:
        scenario = with_values(Scenario.read(folder, table), settings)
        prepared = prepare(scenario, options, run_code=False)
        _try_start(prepared, options)
    except (InputError, ValueError) as error:
        if isinstance(error, UnreadSlaveError) and not wrong:
            raise
        file = folder / SCENARIO_FILE
        wrong.append(str(error) if str(error).startswith(str(file)) else f"{file}: {error}")
    return wrong, None if wrong else prepared


def _instead(folder: Path) -> str:
    """Return what helps where there is no folder: that of the shipped scenario, or a new one."""
    shipped = shipped_scenarios().get(str(folder))
    if shipped is not None:
        return f"the shipped scenario of that name is in {shipped}"
    return f"`panda-cosim new {as_argument(folder)}` makes one that runs"


def _try_start(prepared: Prepared, options: Options) -> None:
    """Read the FMUs and match them with what they are given; place our plant's block."""
    scenario, assembly = prepared.scenario, prepared.assembly
    if scenario.has_own_parts:
        read_fmus(assembly.system, assembly.changed(prepared.values), isolate=options.isolate)
    else:
        Plant(PlantParameters(**grouped(PLANT, prepared.values["plant"])))


def _resolved(scenario: Scenario) -> Trajectory:
    return resolve(scenario, start_values(scenario))


def _purpose(scenario: Scenario) -> Iterator[str]:
    if not scenario.purpose:
        yield f"{SCENARIO_FILE}: purpose is empty; one line should say what the scenario is for"


def _success(scenario: Scenario) -> Iterator[str]:
    if scenario.success == type(scenario.success)():
        yield f"{SCENARIO_FILE}: [success] is empty, so every run that reaches its end is a success"


def _length(scenario: Scenario) -> Iterator[str]:
    last = scenario.table.rows[-1].time
    if last > scenario.duration:
        yield (
            f"{TABLE_FILE}: the last row is at {last:g} s, after the duration of "
            f"{scenario.duration:g} s: it is never reached"
        )
    for push in scenario.push:
        if push.start >= scenario.duration:
            yield f"{SCENARIO_FILE}: [[push]] at {push.start:g} s begins after the end"


def _places(scenario: Scenario) -> Iterator[str]:
    """Check where the rows are in the world."""
    for number, position in enumerate(_resolved(scenario).positions, 1):
        place = f"{TABLE_FILE}: row {number} at {np.round(position, 3).tolist()} m"
        reach = float(np.linalg.norm(position - np.array(SHOULDER)))
        if reach > REACH:
            yield f"{place} is {reach:.3f} m from the shoulder; the arm reaches {REACH} m"
        if position[2] < FLOOR:
            yield f"{place} is so low that the fingers touch the floor; z from {FLOOR} m is free"


def _limits(scenario: Scenario) -> Iterator[str]:
    """Check the path against the robot's limits; the tutorial's law ignores them."""
    if not PRESETS[scenario.gains].use_reference:
        return
    violations = check_feasibility(scenario).violations
    told = [f"{TABLE_FILE}: {violation}" for violation in violations[:SHOWN]]
    if len(violations) > SHOWN:
        told.append(f"{TABLE_FILE}: and {len(violations) - SHOWN} more limits that are exceeded")
    if any(violation.quantity != "reach" for violation in violations):
        place = Path(str(scenario.folder))
        name = scenario.name if is_shipped(scenario) else as_argument(place)
        told[-1] += f"; `panda-cosim retime {name} --keep-times` gives such rows more time"
    yield from told


def _reference(scenario: Scenario) -> Iterator[str]:
    path = Path(str(scenario.folder)) / REFERENCE_FILE
    if path.is_file():
        try:
            Reference.read(path)
        except InputError as error:
            yield str(error)


FOREIGN_HINTS: Final[tuple[Look, ...]] = (_purpose, _success, _reference)
HINTS: Final[tuple[Look, ...]] = (
    _purpose,
    _success,
    _length,
    _places,
    _reference,
)
