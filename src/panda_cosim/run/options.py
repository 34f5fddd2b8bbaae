"""How a scenario is run; what is run, `Scenario.changed` changes."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

from ..fmus.errors import InputError, refuse
from ..fmus.master.step import Coupling, Stepper
from ..fmus.sources.targets import Kind
from ..task.fields import Quantity, check_choice
from ..task.tolerances import flattened
from ..task.typed import check_types
from ..task.values import Values

MAX_TIME_LIMIT = 1e9  # [s]


@dataclass(frozen=True)
class Options:
    """How a scenario is run, never what.

    Attributes:
        overrides: Deprecated, as are `coupling` and `parts`: give `values`, by key.
        realtime: Speed relative to the wall clock; 0: as fast as possible.
        fmus: FMU files by instance; None: the project's own.
        kind: Kind of the project's own: "native", "python", "pythonfmu" (in Python, packed by
            PythonFMU), or "auto": native while they are proven equal to the Python code.
        isolate: Run each FMU in a separate process, so that a crash ends only that process.
        step_timeout: Wall time that a step of an isolated FMU may take [s]; None: unlimited.
        time_limit: Wall time that all steps may take [s]; None: unlimited. Checked between
            steps; for an FMU that hangs in a step, use `isolate` and `step_timeout`.
        master: What steps the FMUs: "kernel", in C where it can, or "fmpy", by FMPy's methods.
        profile: Measure the time of each FMU by call, for the summary.
        waits: Whether FMUs that listen wait for a program that somebody starts, for ever or for
            `time_limit`; else, or if the scenario has a client, for 30 s.
        log: FMUs, by instance, all of whose messages go to standard error as they come.

    Raises:
        InputError: A value is out of bounds, or step_timeout is set without isolate.
    """

    overrides: Mapping[str, Any] = field(default_factory=dict)
    coupling: Coupling | None = None
    realtime: float = 0.0
    fmus: Mapping[str, Path] | None = None
    kind: Kind = "auto"
    isolate: bool = False
    step_timeout: float | None = None
    time_limit: float | None = None
    parts: Mapping[str, str] = field(default_factory=dict)
    master: Stepper = "kernel"
    log: Sequence[str] = ()
    profile: bool = False
    waits: bool = False

    def __post_init__(self) -> None:
        """Check values that may come from a command line."""
        check_types(type(self), vars(self))
        Quantity(0.0, MAX_TIME_LIMIT).check("realtime", self.realtime)
        check_choice("kind", self.kind, get_args(Kind))
        check_choice("master", self.master, get_args(Stepper))
        if not (self.step_timeout is None or 0.0 < self.step_timeout < math.inf):
            refuse("--step-timeout", self.step_timeout, "must be a number above 0 s")
        if self.step_timeout is not None and not self.isolate:
            raise InputError("--step-timeout: needs --isolate, which alone can end a step")
        if self.time_limit is not None:
            Quantity(0.0, MAX_TIME_LIMIT, "s").check("time_limit", self.time_limit)
        if self.values:
            text = f"Options say how to run; what to run is values={self.values}, or changed(...)"
            warnings.warn(text, DeprecationWarning, stacklevel=3)

    @property
    def values(self) -> Values:
        """Values of the scenario that were given here, by key; until the next release."""
        values = {f"fmus.{name}": file for name, file in self.parts.items()}
        values |= {} if self.coupling is None else {"coupling": self.coupling}
        return values | dict(flattened(self.overrides))
