"""Prepares a run once: the scenario with its options, its system, start values and inputs."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass

from ...fmus.master.system import OpenSystem, open_system
from ..scenario.scenario import Scenario
from ..system.assembly import Assembly, assemble
from .inputs import Inputs
from .options import Options, with_options
from .start import StartValues, check_criteria, start_values


@dataclass(frozen=True, eq=False)
class Prepared:
    """All that a run needs before its FMUs are opened; nothing has been built or written.

    Attributes:
        scenario: With the values of the options.
        options: How it is run.
        assembly: Its FMUs and their connections.
        values: All parameters by instance and scalar variable.
    """

    scenario: Scenario
    options: Options
    assembly: Assembly
    values: StartValues

    def inputs(self, scenario: Scenario | None = None) -> Inputs:
        """Return the external inputs, of a changed scenario if one is given."""
        start = self.assembly.inputs_at_start(self.values)
        return Inputs(scenario or self.scenario, self.values, self.assembly.external, start)

    def open(self, warnings: list[str]) -> AbstractContextManager[OpenSystem]:
        """Build, open and initialize the FMUs; their messages are appended to `warnings`."""

        def hear(instance: str, status: str, text: str) -> None:
            kind = "" if status.lower() == "warning" else f" {status.lower()}"
            warnings.append(f"{instance}{kind}: {text}")

        start = self.assembly.start_time
        return open_system(
            self.assembly.system,
            self.assembly.changed(self.values),
            start=start,
            stop=start + self.scenario.duration,
            step_size=self.scenario.step,
            coupling=self.scenario.coupling,
            on_message=hear,
            isolate=self.options.isolate,
            step_timeout=self.options.step_timeout,
        )


def prepare(
    scenario: Scenario,
    options: Options | None = None,
    *,
    interactive: bool = False,
    run_code: bool = True,
) -> Prepared:
    """Check a scenario and prepare its run; `check` and all runs begin with this.

    `interactive`: all inputs that nothing feeds can be set from outside. `run_code`: slaves may be
    run to find their variables; else one raises `UnreadSlaveError`.
    """
    options = options or Options()
    scenario = with_options(scenario, options)
    assembly = assemble(
        scenario, options.kind, files=options.fmus, run_code=run_code, from_outside=interactive
    )
    check_criteria(scenario, assembly)
    values = start_values(scenario, assembly=assembly)
    assembly.recorded()  # refuses columns of the same name
    prepared = Prepared(scenario, options, assembly, values)
    prepared.inputs()  # refuses a table that cannot be resolved
    return prepared
