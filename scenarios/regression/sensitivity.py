"""Finds the smallest change of each parameter that a scenario's reference detects.

A reference that does not detect a change of a gain does not test that gain. Each parameter is
changed alone, by a share of its value. Bisection on a logarithmic scale finds the smallest share
for which the run no longer matches its reference.
"""

from __future__ import annotations

import math
import shutil
import threading
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ...fmus.errors import InputError
from ...fmus.interface.tables import INTERFACES
from ...fmus.interface.variables import Value, Variable
from ..definition.scenario import Scenario
from ..running.assembly import assemble
from ..running.start import start_values
from .reference import how_to_make, reference_path
from .runner import Outcome, Runner

LARGEST: Final = 0.5  # of a parameter's value
SMALLEST: Final = 1e-4
STEPS: Final = 6  # bisections: the result is at most 14 % too large


@dataclass(frozen=True)
class Parameter:
    """A parameter that can be changed by a share of its value.

    Attributes:
        instance: Instance of the FMU.
        name: Without an index; a vector's elements change together.
        value: Number, or tuple of numbers.
        sign: 1: it is increased; -1: decreased, if it cannot be increased.
    """

    instance: str
    name: str
    value: float | tuple[float, ...]
    sign: int

    @property
    def full_name(self) -> str:
        """Name with the instance."""
        return f"{self.instance}.{self.name}"

    def changed(self, share: float) -> dict[str, dict[str, Any]]:
        """Return an override with the value changed by a share."""
        factor = 1.0 + self.sign * share
        values = self.value if isinstance(self.value, tuple) else (self.value,)
        scaled = tuple(factor * value for value in values)
        return {self.instance: {self.name: scaled if len(scaled) > 1 else scaled[0]}}


@dataclass(frozen=True)
class Threshold:
    """The smallest detected change of a parameter.

    Attributes:
        name: The parameter, with its instance.
        value: Its value in the scenario.
        change: Smallest detected share of it, with its sign; None: not even `LARGEST`.
        noticed_by: The difference in one line; "": none.
    """

    name: str
    value: float | tuple[float, ...]
    change: float | None
    noticed_by: str


def sensitivity(
    scenario: Scenario,
    folder: Path,
    jobs: int,
    tell: Callable[[Threshold], None] | None = None,
    only: Collection[str] | None = None,
) -> list[Threshold]:
    """Find for each parameter the smallest change that the scenario's reference detects.

    Args:
        scenario: A scenario with a reference in its folder.
        folder: Folder for the runs, which are removed.
        jobs: How many run at the same time.
        tell: Called with each result as it arrives.
        only: Names of parameters, such as `controller.kp`; None: all that `parameters` gives.

    Raises:
        InputError: There is no reference, or the unchanged run differs from it.
    """
    from ...fmus.packaging.build import build  # noqa: PLC0415 - imports much

    path = reference_path(scenario)
    if not path.is_file():
        raise InputError(f"{path}: does not exist; {how_to_make(path)} makes it")
    build()
    stop = threading.Event()
    unchanged = _run(scenario, folder / "unchanged", {})
    if unchanged.verdict != "same":
        raise InputError(
            f"{scenario.name}: differs from its reference as it is: {unchanged.reason}"
        )

    def find(parameter: Parameter) -> Threshold:
        place = folder / parameter.full_name
        threshold = _bisect(
            parameter, lambda share: _run(scenario, place, parameter.changed(share)), stop
        )
        if tell is not None and not stop.is_set():
            tell(threshold)
        return threshold

    with ThreadPoolExecutor(jobs) as pool:
        try:
            chosen = [p for p in parameters(scenario) if only is None or p.full_name in only]
            return list(pool.map(find, chosen))
        finally:
            stop.set()  # any exception here ends the other threads after their current runs


def parameters(scenario: Scenario) -> list[Parameter]:
    """Return the scenario's parameters with numbers other than 0, in the tables' order."""
    values = start_values(scenario)
    interfaces = assemble(scenario).interfaces if scenario.has_own_parts else INTERFACES
    found = [
        _changeable(instance, variable, values[instance])
        for instance, interface in interfaces.items()
        for variable in interface.of("parameter")
    ]
    return [parameter for parameter in found if parameter is not None]


def _changeable(instance: str, variable: Variable, values: Mapping[str, Value]) -> Parameter | None:
    """Return a parameter if it can be changed by a share; `values` are by scalar variable."""
    if variable.kind != "Real" or variable.multiple_of is not None:
        return None
    flat = tuple(float(values.get(name, 0.0)) for name in variable.names())
    if not any(flat):
        return None
    scalars = list(variable.scalars(0))
    for sign in (1, -1):
        ends = [(1.0 + sign * LARGEST) * each for each in flat]
        bounds = [(s.minimum, s.maximum) for s in scalars]
        if all(_within(end, *bound) for end, bound in zip(ends, bounds, strict=True)):
            return Parameter(instance, variable.name, flat if variable.shape else flat[0], sign)
    return None


def _within(value: float, low: float | None, high: float | None) -> bool:
    return (low is None or value >= low) and (high is None or value <= high)


def _bisect(
    parameter: Parameter, run: Callable[[float], Outcome], stop: threading.Event
) -> Threshold:
    name = parameter.full_name
    outcome = run(LARGEST)
    if outcome.verdict == "same":
        return Threshold(name, parameter.value, None, "")
    low, high = math.log(SMALLEST), math.log(LARGEST)
    noticed = outcome
    for _ in range(STEPS):
        if stop.is_set():
            break
        middle = (low + high) / 2
        outcome = run(math.exp(middle))
        if outcome.verdict == "same":
            low = middle
        else:
            high, noticed = middle, outcome
    return Threshold(name, parameter.value, parameter.sign * math.exp(high), noticed.reason)


def _run(scenario: Scenario, place: Path, overrides: Mapping[str, Mapping[str, Any]]) -> Outcome:
    with Runner(place, overrides) as runner:
        outcome = runner.submit(scenario).result()
    shutil.rmtree(place, ignore_errors=True)
    return outcome


__all__ = ["LARGEST", "Threshold", "parameters", "sensitivity"]
