"""Makes and opens the FMUs of a scenario."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager

from ...fmus.master.system import OpenSystem, System, open_system, panda_system
from ..definition.scenario import Scenario
from .assembly import Assembly
from .options import Options
from .start import StartValues


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
