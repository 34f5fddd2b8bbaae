"""What can be changed in a run, and to what: checks each action without any FMU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ...fmus.errors import InputError
from ...fmus.interface.parameters import ParameterValue, expand
from ...fmus.interface.variables import Scalar, Value
from ...fmus.master.step import COUPLINGS
from ...fmus.messages import excerpt
from .inputs import checked_values
from .prepare import Prepared


@dataclass(frozen=True)
class Change:
    """What `Adjustments.set` allows.

    Attributes:
        value: As the journal has it.
        instance: The FMU whose parameters are to be set; "" for an input.
        parameters: Their values by scalar variable.
    """

    value: Any
    instance: str = ""
    parameters: Mapping[str, Value] = field(default_factory=dict)


class Adjustments:
    """The inputs, parameters and waypoints of a run, as its actions change them.

    A session asks it before it changes an FMU. By itself, it checks a whole journal before
    anything is run.

    Attributes:
        interfaces: Variables of each FMU.
        values: Current values of all parameters by instance and scalar variable.
        inputs: Pushes and commands.
    """

    def __init__(self, prepared: Prepared) -> None:
        self._scenario = prepared.scenario
        self.interfaces = prepared.assembly.interfaces
        self.values = {name: dict(values) for name, values in prepared.values.items()}
        self.inputs = prepared.inputs()

    @cached_property
    def tunables(self) -> dict[str, Scalar]:
        """Parameters that `set` can change, with unit, bounds and description."""
        return {
            f"{instance}.{scalar.name}": scalar
            for instance, interface in self.interfaces.items()
            for scalar in interface.scalars()
            if scalar.variable.variability == "tunable"
        }

    def set(self, name: str, value: ParameterValue) -> Change:
        """Hold an input, or check the values of a tunable parameter, see `Session.set`."""
        if name in self.inputs:
            interface = self.interfaces[name.partition(".")[0]]
            held = checked_values(interface, name, value, len(self.inputs.columns(name)))
            self.inputs.hold(name, held)
            return Change(held)
        instance, _, parameter = name.partition(".")
        if instance not in self.interfaces:
            names = ", ".join(self.interfaces)
            raise InputError(f"{name}: no instance {instance!r}; valid: {names}")
        values = expand(instance, self.interfaces[instance], {parameter: value})
        for scalar in values:
            if f"{instance}.{scalar}" not in self.tunables:
                valid = dict.fromkeys(s.variable.name for s in self.tunables.values())
                raise InputError(
                    f"{name}: is a fixed parameter, which cannot change in a run; tunable: "
                    f"{', '.join(valid) or 'none'}"
                )
        return Change(as_json(value), instance, values)

    def note(self, change: Change) -> None:
        """Note values that an FMU has taken."""
        if change.instance:
            self.values[change.instance] |= change.parameters

    def release(self, name: str) -> None:
        """Give a held input the scenario's values again, see `Session.release`."""
        self.inputs.release(name)

    def move_waypoint(self, row: int, changes: Mapping[str, Any], now: float) -> None:
        """Change a row of the trajectory table, see `Session.move_waypoint`."""
        if self._scenario.is_system:
            raise InputError("move_waypoint: the scenario is a system without a trajectory")
        from .session_scenario import moved  # noqa: PLC0415 - only in sessions

        self.inputs.use(moved(self._scenario, self.inputs.table, row, changes, now))

    @staticmethod
    def check_coupling(coupling: object) -> None:
        """Check the name of a coupling."""
        if coupling not in COUPLINGS:
            raise InputError(f"coupling: {excerpt(coupling)}; valid: {', '.join(COUPLINGS)}")


def as_json(value: Any) -> Any:
    """Return a value as JSON holds it."""
    if isinstance(value, str | bool) or value is None:
        return value
    if isinstance(value, Mapping):
        raise InputError(f"value {value!r}; must be a number or numbers")
    return np.asarray(value).tolist()
