"""Prepares the run of a scenario, makes its FMUs and opens them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

from ...fmus.master.system import OpenSystem, System, open_system, panda_system
from ..definition.scenario import Scenario
from .assembly import Assembly, assemble
from .external import ScenarioInputs
from .fmu_files import taken
from .options import Options, with_options
from .start import StartValues, check_criteria, start_values


@dataclass(frozen=True)
class Prepared:
    """All that a run needs before its FMUs are made.

    Attributes:
        scenario: As it is run.
        assembly: Its system; None: the project's own plant and controller.
        values: Start values by instance and scalar variable.
        inputs: What it gives the FMUs at each tick.
    """

    scenario: Scenario
    assembly: Assembly | None
    values: StartValues
    inputs: ScenarioInputs


def prepare(scenario: Scenario, options: Options, *, run_code: bool = True) -> Prepared:
    """Check a scenario and assemble its system; `check` and all runs begin with this.

    Args:
        scenario: The scenario.
        options: How it is run.
        run_code: Whether PythonFMU slaves may be run to find their variables.

    Raises:
        InputError: Something cannot be used.
        UnreadSlaveError: There is a slave, and it may not be run.
    """
    if scenario.has_own_parts and not run_code:
        assemble(scenario, run_code=False)  # before anything that would run a slave
    scenario = with_options(scenario, options)
    foreign = scenario.is_foreign
    assembly = assemble(scenario, options.kind, run_code=run_code) if foreign else None
    check_criteria(scenario, assembly)
    values = start_values(scenario, assembly=assembly)
    if assembly is not None:
        assembly.recorded()  # refuses columns of the same name
    columns = None if assembly is None else taken(scenario, assembly)
    return Prepared(scenario, assembly, values, ScenarioInputs(scenario, values, columns))


def make_system(
    scenario: Scenario, assembly: Assembly | None, options: Options, pushed: Sequence[str]
) -> System:
    """Build the FMUs of a scenario.

    Args:
        scenario: The scenario.
        assembly: Its system; None: the project's own plant and controller.
        options: Which FMUs are used.
        pushed: Bodies of our plant on which external forces act.
    """
    if assembly is not None:
        return assembly.make()
    return panda_system(pushed=pushed, fmus=options.fmus, kind=options.kind, asked=scenario.asked)


def open_fmus(  # noqa: PLR0913 - a run has this many sides
    scenario: Scenario,
    assembly: Assembly | None,
    options: Options,
    system: System,
    values: StartValues,
    warnings: list[str],
) -> AbstractContextManager[OpenSystem]:
    """Open the FMUs of a scenario and initialize them.

    Args:
        scenario: The scenario.
        assembly: Its system; None: the project's own plant and controller.
        options: How the FMUs are run.
        system: From `make_system`.
        values: Start values.
        warnings: Takes the FMUs' messages.
    """

    def hear(instance: str, status: str, text: str) -> None:
        kind = "" if status.lower() == "warning" else f" {status.lower()}"
        warnings.append(f"{instance}{kind}: {text}")

    start = 0.0 if assembly is None else assembly.start_time
    return open_system(
        system,
        values if assembly is None else assembly.given(values),
        start=start,
        stop=start + scenario.duration,
        step_size=scenario.step,
        coupling=scenario.coupling,
        on_message=hear,
        isolate=options.isolate,
        step_timeout=options.step_timeout,
    )
