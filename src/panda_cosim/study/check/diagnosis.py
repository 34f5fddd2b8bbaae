"""Explains what is wrong, or looks wrong, in a scenario's folder: prepares it and rehearses it.

The rehearsal runs it in memory, as `run` does, and looks for what will not go well on the way.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from ...controller.presets import PRESETS
from ...fmus.build.engines import has_engine
from ...fmus.build.identity import mujoco_version
from ...fmus.errors import CosimError, InputError
from ...fmus.interface.parameters import grouped
from ...fmus.interface.plant import PLANT
from ...fmus.master.fmu import check_libraries
from ...fmus.master.system import conversions, notes, read_fmus
from ...fmus.sources.model_fmu import load_binary
from ...plant.parameters import PlantParameters
from ...plant.plant import Plant
from ...result.judging.advice import REMEDIES, Level, advise, refusals, weakest_grip
from ...result.judging.verdicts import MISSED, NOT_MEASURED, UNEXPECTED
from ...result.recording.reader import shapes_of
from ...run.execution import Execution
from ...run.finished import Run
from ...run.folder import model_in
from ...run.prepare import Prepared, prepare
from ...run.start import (
    StartValues,
    carried_mass,
    check_tolerances,
    doubts,
    instants,
    law_gains,
    resolve,
    start_values,
)
from ...run.summary import unrecorded
from ...run.system.assembly import system_scenario, with_parameter_set
from ...run.system.parts import UnreadSlaveError
from ...task.client import MissingPackageError
from ...task.files import as_argument
from ...task.scenario import SCENARIO_FILE, TABLE_FILE, Scenario, is_shipped
from ...task.timing.demand import LimitViolation, find_violations
from ...task.timing.joint_reference import joint_reference
from ...task.values import Values
from .suggestions import suggestions

SYSTEM: Final = ".ssp"
SHOWN: Final = 4  # limit violations that are listed


@dataclass(frozen=True)
class Diagnostic:
    """One remark about a scenario."""

    # `wrong`: it cannot run; `refused` by the real robot; `hint`: it runs, but perhaps not as
    # intended; `good`.
    level: Level
    text: str  # what is wrong, where, and what would be right


def check_folder(
    folder: Path, values: Values | None = None, robot: str = "", ssv: Path | None = None
) -> list[Diagnostic]:
    """Check a scenario's folder, or an .ssp file, as `run` prepares it, also for a `robot`.

    `ssv` is a parameter set of SSP.
    """
    is_system = folder.suffix == SYSTEM
    file = folder if is_system else folder / SCENARIO_FILE
    try:
        scenario = (system_scenario if is_system else Scenario.read)(folder)
        scenario = with_parameter_set(scenario, ssv, values or {}, run_code=False)
        scenario = replace(scenario, preflight=robot or scenario.preflight)
        prepared = prepare(scenario, run_code=False)
        level: Level = "wrong" if robot else "hint"  # of conditions that are not measured
        is_foreign = prepared.scenario.has_own_parts
        diagnostics = _foreign(prepared, level) if is_foreign else _rehearsed(prepared)
    # What is known only once it runs; a scenario without its package is skipped by `regress`.
    except (UnreadSlaveError, MissingPackageError) as error:
        return _diagnostics("hint", [*_remarks(scenario), f"not checked: {error}"])
    except (InputError, ValueError) as error:
        place = "" if str(error).startswith(str(folder)) else f"{file}: "
        return [Diagnostic("wrong", f"{place}{error}")]
    # An .ssp file has neither a purpose nor criteria.
    remarks = [] if is_system else [*_remarks(prepared.scenario)]
    remarks += doubts(prepared.scenario, prepared.values)
    try:
        check_tolerances(prepared.scenario, prepared.assembly)
    except InputError as error:  # which `run` ignores, and `regress` refuses
        remarks.append(f"{SCENARIO_FILE}: {error}")
    if not has_engine(engine := prepared.scenario.mujoco):
        remarks.append(f"mujoco: {engine} is not installed, but would be by a run; checked with "
                       f"{mujoco_version()}")  # fmt: skip
    return [*_diagnostics("hint", remarks), *diagnostics]


def _diagnostics(level: Level, texts: Iterable[str]) -> list[Diagnostic]:
    return [Diagnostic(level, text) for text in texts]


def _foreign(prepared: Prepared, level: Level) -> list[Diagnostic]:
    """Describe a scenario of other FMUs, whose code is not run; no robot's conditions are seen."""
    scenario, assembly = prepared.scenario, prepared.assembly
    fmus = read_fmus(assembly.system, prepared.start_values(), scenario.coupling)
    for fmu in fmus.values():
        check_libraries(fmu)
    seen = (f"{name}: {text}" for name, text in notes(fmus, assembly.system, scenario.step))
    hints = _diagnostics("hint", [*assembly.notes, *suggestions(assembly), *seen])
    hints += _diagnostics("good", [*conversions(fmus, assembly.system), *_order(prepared)])
    models = ", ".join(f"{name} ({i.model})" for name, i in assembly.interfaces.items())
    count = len(assembly.connections)
    about = f"{scenario.name}: {models}, {count} connections, {scenario.duration:g} s"
    unseen = "no FMU was run; limits, collisions and grip are checked only with our own FMUs"
    unseen = f"the client was not started, and {unseen}" if scenario.client else unseen
    trouble: list[str] = []
    is_alone = not (scenario.system or scenario.client)
    if is_alone and all(not part.file or part.is_model for part in assembly.parts):
        trouble = [*_passed_through(prepared), *_told(prepared, rehearse(prepared))]
        unseen = "rehearsed in memory"
    hints += _diagnostics("hint", trouble)
    if scenario.preflight:
        run = f"`panda-cosim run {_name(scenario)} --set preflight={scenario.preflight}`"
        text = f"what {scenario.preflight} refuses is not known before a run: {run}"
        hints.append(Diagnostic(level, text))
    columns = tuple(column.name for column in assembly.recorded(scenario.coupling))
    lacking = unrecorded(scenario.success, {*columns, *shapes_of(columns)})
    file = f"{scenario.folder}/{SCENARIO_FILE}"
    if wrong := _diagnostics("wrong", (f"{file}: [success] {text}" for text in lacking)):
        return [*wrong, *hints]
    if len(assembly.interfaces) > 1 and not count:
        text = f"{about}; it runs, but its FMUs are not connected ({unseen})"
        return [*hints, Diagnostic("hint", text)]
    return [*hints, _conclusion(about, len(trouble), f"it can run ({unseen})")]


def _conclusion(about: str, troubles: int, otherwise: str) -> Diagnostic:
    """Return the last line."""
    if not troubles:
        return Diagnostic("good", f"{about}; {otherwise}")
    count = f"{troubles} problem{'s' if troubles > 1 else ''}"
    return Diagnostic("hint", f"{about}; it runs, but has the {count} above")


def _order(prepared: Prepared) -> Iterator[str]:
    """Say in which order FMUs are stepped, if they are connected."""
    if prepared.assembly.connections:
        yield prepared.assembly.course(prepared.scenario.coupling)


def _rehearsed(prepared: Prepared) -> list[Diagnostic]:
    """Run a scenario of our own FMUs in memory; say what goes wrong, and at last whether it can."""
    Plant(PlantParameters(**grouped(PLANT, prepared.values["plant"])))  # refuses its block's place
    scenario, run = prepared.scenario, rehearse(prepared)
    name, summary = _name(scenario), run.summary
    trouble = _diagnostics("hint", [*_told(prepared, run), *_limits(prepared)])
    lines = refusals(summary.preflight, complete=summary.complete)
    real = [Diagnostic(level, text.replace("SCENARIO", name)) for level, text in lines]
    real += _diagnostics("good", _order(prepared))
    if summary.verdict is NOT_MEASURED:  # what the criteria wait for never happens
        place = f"{scenario.folder}/{SCENARIO_FILE}: [success]"
        return [Diagnostic("wrong", f"{place} {run.summary.detail}"), *trouble, *real]
    about = f"{scenario.name}: {len(scenario.rows)} rows, {scenario.duration:g} s"
    if scenario.mismatch.values:
        about += f", mismatch of {', '.join(scenario.mismatch.values)}"
    if not trouble and (grip := weakest_grip(run.recording)):
        about += f"; the grip holds {grip[1]:.3g} N by friction, {grip[2]:.3g} N needed"
    return [*trouble, *real, _conclusion(about, len(trouble), "it can run")]


def _told(prepared: Prepared, run: Run) -> list[str]:
    """Return what `run` says of a run."""
    scenario, summary = prepared.scenario, run.summary
    lines = advise(run.recording, summary, ours=not scenario.has_own_parts)
    told = [text.replace("SCENARIO", _name(scenario)) for text in lines]
    if not summary.complete:
        told.insert(0, f"{SCENARIO_FILE}: {summary.detail}")
    if summary.verdict in (MISSED, UNEXPECTED):
        told.append(f"{SCENARIO_FILE}: [success] {summary.detail}")
    return told


def _passed_through(prepared: Prepared) -> Iterator[str]:
    """Name shapes of a scene of one's own that lack what the block meets, such as finger pads."""
    if "plant" not in prepared.scenario.fmus or "block_mass" not in prepared.values["plant"]:
        return
    model = load_binary(model_in(prepared.assembly.system.fmus["plant"]), "plant")
    met, arm = model.geom("obj_geom").conaffinity[0], model.body("link0").rootid[0]
    touches = (model.geom_contype | model.geom_conaffinity) != 0
    touches &= model.body_rootid[model.geom_bodyid] != arm
    for number in np.flatnonzero(touches & (model.geom_conaffinity & met < met)):
        yield (
            f"plant: geom {model.geom(number).name or number}: the finger pads pass through it; "
            'must have class="surroundings", or class="block" to be gripped'
        )


def _name(scenario: Scenario) -> str:
    """Return what commands take."""
    return scenario.name if is_shipped(scenario) else as_argument(Path(str(scenario.folder)))


# What the files alone show.


def _remarks(scenario: Scenario) -> Iterator[str]:
    last = scenario.rows[-1].time if scenario.rows else 0.0
    is_timed = scenario.timing != "table" or scenario.route
    remarks = {
        "purpose is empty; one line should say what the scenario is for": not scenario.purpose,
        "[success] is empty, so every run that reaches its end is a success":
            scenario.success == type(scenario.success)(),
        'timing_share has no effect on a run with timing = "table"':
            not is_timed and scenario.timing_share != Scenario.timing_share,
        "[mismatch] seed has no effect, as nothing is drawn":
            scenario.mismatch.seed and not scenario.mismatch.values,
    }  # fmt: skip
    yield from (f"{SCENARIO_FILE}: {text}" for text, holds in remarks.items() if holds)
    if last > scenario.duration:
        after = f"after the duration of {scenario.duration:g} s: it is never reached"
        yield f"{TABLE_FILE}: the last row is at {last:g} s, {after}"


def _limits(prepared: Prepared) -> Iterator[str]:
    """Check the path against the robot's limits; the tutorial's law ignores them."""
    scenario = prepared.scenario
    if not PRESETS[scenario.gains].use_reference:
        return
    violations, _ = feasibility(scenario, prepared.values)
    name, helps = _name(scenario), REMEDIES["singular"]
    if all(violation.quantity != "reach" for violation in violations):
        helps = f"`panda-cosim retime {name} --keep-times` gives that row more time"
    elif scenario.success.block_position:
        helps = f"`panda-cosim route {name}` plans another path"
    for violation in violations[:SHOWN]:
        yield f"{TABLE_FILE}: {violation}; {helps}"
    if len(violations) > SHOWN:
        yield f"{TABLE_FILE}: and {len(violations) - SHOWN} more violations"


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


def rehearse(prepared: Prepared) -> Run:
    """Run what was prepared, without files; the summary says why it failed, if it did."""
    with Execution(prepared, writes=False) as execution:
        with suppress(CosimError):
            execution.advance()
        return execution.close()
