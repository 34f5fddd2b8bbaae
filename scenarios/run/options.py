"""Options of a run, and the scenario that they make of one."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

from ...fmus.errors import InputError
from ...fmus.master.step import Coupling
from ...fmus.master.system import check_step_timeout
from ...fmus.messages import did_you_mean
from ...fmus.sources.targets import Kind
from ..fields import Quantity, check_choice
from ..scenario.scenario import Scenario
from .start import Overrides

MAX_TIME_LIMIT = 1e9  # [s]


@dataclass(frozen=True)
class Options:
    """Options of a run, besides the scenario's own settings.

    Attributes:
        overrides: Parameters by instance and name.
        coupling: Coupling, instead of the scenario's; None: the scenario's.
        realtime: Speed relative to the wall clock; 0: as fast as possible.
        fmus: FMU files by instance; None: the project's own.
        kind: Kind of the project's own: "native" or "python".
        isolate: Run each FMU in a separate process, so that a crash ends only that process.
        step_timeout: Wall time that a step of an isolated FMU may take [s]; None: unlimited.
        time_limit: Wall time that all steps may take [s]; None: unlimited. Checked between
            steps; for an FMU that hangs in a step, use `isolate` and `step_timeout`.
        keep_recording: False: the recording stays in memory, and only the summary is kept.
        retry: Replace the files of a killed or failed run in the folder.
        parts: FMUs by instance, instead of the scenario's [fmus]; paths are relative to the
            working directory.

    Raises:
        InputError: A value is out of bounds, or step_timeout is given without isolate.
    """

    overrides: Overrides = field(default_factory=dict)
    coupling: Coupling | None = None
    realtime: float = 0.0
    fmus: Mapping[str, Path] | None = None
    kind: Kind = "native"
    isolate: bool = False
    step_timeout: float | None = None
    time_limit: float | None = None
    keep_recording: bool = True
    retry: bool = False
    parts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check values that may come from a command line."""
        if not (math.isfinite(self.realtime) and self.realtime >= 0.0):
            raise InputError(f"realtime: value {self.realtime!r}; must be a number of at least 0")
        check_choice("kind", self.kind, get_args(Kind))
        check_step_timeout(self.step_timeout, isolate=self.isolate)
        if self.time_limit is not None:
            Quantity(0.0, MAX_TIME_LIMIT, "s").check("time_limit", self.time_limit)


def with_options(scenario: Scenario, options: Options) -> Scenario:
    """Return the scenario with the values of the options, which `prepare` checks."""
    named = {name: _from_here(given) for name, given in options.parts.items()}
    if named:
        if scenario.system:
            raise InputError(
                f"{next(iter(named))}: cannot be combined with system = {scenario.system!r}"
            )
        scenario = replace(scenario, fmus={**scenario.fmus, **named})
    ours = () if scenario.is_system else ("plant", "controller", "sensors")
    instances = tuple(dict.fromkeys((*ours, *scenario.fmus)))
    for name in options.overrides:
        if name not in instances and not scenario.system:
            hint = did_you_mean(name, instances)
            raise InputError(f"{name!r} is not an instance; valid: {', '.join(instances)}{hint}")
    others = {n: v for n, v in options.overrides.items() if n not in ("plant", "controller")}
    plant, controller = (options.overrides.get(name, {}) for name in ("plant", "controller"))
    is_ours = not scenario.is_system and "plant" not in scenario.fmus
    return replace(
        scenario,
        scene=str(plant.get("scene", scenario.scene)) if is_ours else scenario.scene,
        coupling=options.coupling or scenario.coupling,
        plant=_merged(
            scenario.plant, {n: v for n, v in plant.items() if n != "scene" or not is_ours}
        ),
        controller=_merged(scenario.controller, controller),
        parameters={
            **scenario.parameters,
            **{n: _merged(scenario.parameters.get(n, {}), v) for n, v in others.items()},
        },
    )


def _from_here(given: str) -> str:
    """A part named on the command line, relative to the working directory."""
    file, colon, name = given.rpartition(":")
    whole = colon and file.endswith(".py")
    return f"{os.path.realpath(file)}:{name}" if whole else os.path.realpath(given)


def _merged(section: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Merge both; an override of `kp` replaces the section's `kp[3]`, too."""
    kept = {k: v for k, v in section.items() if k.partition("[")[0] not in overrides}
    return kept | dict(overrides)
