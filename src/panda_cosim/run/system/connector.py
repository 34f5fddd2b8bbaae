"""What feeds the FMUs of a scenario: connections, by name or as [connect] says, and its inputs.

Inputs that the scenario drives have one value each, or values over time.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError, did_you_mean, excerpt
from ...fmus.interface.controller import FORCE_COMMAND, POSTURE_COMMANDS
from ...fmus.interface.parameters import ParameterValue, expand, targets
from ...fmus.interface.plant import FORCES
from ...fmus.interface.sensors import measurement_of
from ...fmus.interface.tables import Connection
from ...fmus.interface.types import can_convert, in_row, is_lossless, type_of
from ...fmus.interface.units import OUR_UNITS, Units, conversion
from ...fmus.interface.variables import Interface, Scalar, Value, Variable
from ...fmus.master.fmu_file import read_value
from ...fmus.master.wiring import Name
from ...plant.parameters import ARM_JOINTS
from ...task.scenario import Scenario
from .parts import Part, measures_a_panda

# Inputs of PandaPlant and PandaController that act only in some scenarios; those that may stay
# unconnected.
RARE: Final = ("torque", *POSTURE_COMMANDS, FORCE_COMMAND)
OPTIONAL: Final = (*FORCES.values(), *RARE)
_OF_ARM: Final = ("qpos", "qvel")  # of PandaPlant, which begin with the arm's
_CONVERT: Final = re.compile(r"convert\((.+)\)", re.S)
# What takes an arm's ctrl, by its unit.
FITTING: Final = {"N.m": '; scene "motors" takes torques', "rad": '; scene "tabletop" takes angles'}
SHOWN: Final = 8  # unconnected inputs of an FMU that are named


class Connector:
    """Connects the FMUs of a scenario, and checks shapes and units on the way."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = {part.name: part for part in parts}
        self.connections: list[Connection] = []
        self._open: dict[str, list[str]] = {}  # unconnected inputs by FMU
        self._fed: set[Name] = set()
        self._outputs: dict[str, list[tuple[str, Variable]]] = {}  # by their names
        for part in parts:
            for variable in part.interface.of("output"):
                self._outputs.setdefault(variable.name, []).append((part.name, variable))

    @property
    def notes(self) -> list[str]:
        """One line for each FMU with unconnected inputs."""
        return [
            f"{name}: nothing feeds {', '.join(inputs[:SHOWN])}"
            + (f" and {len(inputs) - SHOWN} more inputs" if len(inputs) > SHOWN else "")
            + ": start values are kept"
            for name, inputs in self._open.items()
        ]

    def is_fed(self, instance: str, name: str) -> bool:
        """Whether an input, or an element of it, is fed."""
        return any(i == instance and n.partition("[")[0] == name for i, n in self._fed)

    def mark_fed(self, instance: str, variable: Variable) -> None:
        """Mark an input as external."""
        self._fed |= {(instance, name) for name in variable.names()}

    def drive(self, names: Collection[Name]) -> None:
        """Mark inputs as driven by the scenario; what is connected cannot be."""
        if both := self._fed.intersection(names):
            ends = ", ".join(sorted(".".join(name) for name in both))
            raise InputError(f"[inputs] {ends}: is fed already; must be an unconnected input")
        self._fed.update(names)

    def connect(self, target: str, source: str) -> None:
        """Connect two ends, written as in [connect]: `fmu.variable`, or an element of one."""
        # The source may be `convert(fmu.variable)`, which also converts types with loss.
        asked = _CONVERT.fullmatch(source)
        source = asked[1] if asked else source
        to_part, fed = self._end(target, "input")
        from_part, giving = self._end(source, "output")
        self.check(source, giving, target, fed, "[connect] ", converts=bool(asked))
        self._connect(from_part, giving, to_part, fed, converts=bool(asked))

    def connect_torques(self) -> None:
        """Connect the controller's ctrl if the arm has motors: torques, then the gripper."""
        outputs = {v.name for v in self.parts["controller"].interface.of("output")}
        inputs = {v.name for v in self.parts["plant"].interface.of("input")}
        if "ctrl" not in outputs or not {"ctrl", "torque"} <= inputs:
            return
        if "motor_torque" in outputs:  # our own, whose ctrl moves the gripper alone
            self.connect("plant.torque", "controller.motor_torque")
            return
        if self.is_fed("plant", "torque") or self.is_fed("plant", "ctrl"):
            return
        for i in range(1, 8):
            self.connect(f"plant.torque[{i}]", f"controller.ctrl[{i}]")
        self.connect("plant.ctrl[8]", "controller.ctrl[8]")
        self.mark_fed("plant", self.parts["plant"].interface.variable("ctrl"))

    def connect_sensors(self, names: Sequence[str]) -> None:
        """Connect measurements to the controller's inputs of some names that are not fed yet."""
        inputs = {v.name for v in self.parts["controller"].interface.of("input")}
        for name in names:
            if name in inputs and not self.is_fed("controller", name):
                self.connect(f"controller.{name}", f"sensors.{measurement_of(name)}")

    def connect_rest_by_name(self) -> None:
        """Connect all inputs that are not fed yet."""
        for part in self.parts.values():
            for variable in part.interface.of("input"):
                self.connect_by_name(part, variable)

    def connect_by_name(self, part: Part, variable: Variable) -> None:
        """Connect an input to the one output of its name."""
        unfed = [name for name in variable.names() if (part.name, name) not in self._fed]
        if not unfed:
            return
        outputs = [
            (name, v) for name, v in self._outputs.get(variable.name, ()) if name != part.name
        ]
        target = f"{part.name}.{variable.name}"
        if not outputs:
            if part.file is not None and variable.name not in OPTIONAL:
                whole = len(unfed) == variable.size
                self._open.setdefault(part.name, []).extend([variable.name] if whole else unfed)
            return
        if len(outputs) > 1:
            names = " and ".join(f"{name}.{variable.name}" for name, _ in outputs)
            raise InputError(f"{target}: {names} both match; choose one in [connect]")
        source, giving = outputs[0]
        is_of_arm = giving.name in _OF_ARM and variable.shape == (len(ARM_JOINTS),)
        if is_of_arm and measures_a_panda(self.parts[source].interface):
            giving = replace(giving, shape=variable.shape, unit=giving.units[: variable.size])
        self.check(f"{source}.{giving.name}", giving, target, variable)
        self._connect(source, giving, part.name, variable)

    def check(  # noqa: PLR0913 - two ends, each with its name
        self,
        source: str,
        giving: Variable,
        target: str,
        fed: Variable,
        place: str = "",
        *,
        converts: bool = False,
    ) -> None:
        """Check that shapes, types and units of both ends match."""
        ends = f"{place}{source} {_shape_and_unit(giving)} feeds {target} {_shape_and_unit(fed)}"
        if giving.shape != fed.shape:
            hint = ""
            if source.partition(".")[0] in self.parts:
                item = fed.names()[0].removeprefix(fed.name)
                source_item = giving.names()[0].removeprefix(giving.name)
                hint = ", or [connect] must name elements, such as "
                hint += f'"{target}{item}" = "{source}{source_item}"'
            raise InputError(f"{ends}; must have the same shape{hint}")
        can_ask = can_convert(giving, fed) and source.partition(".")[0] in self.parts
        hint = f', or be asked for in [connect]: "{target}" = "convert({source})"' * can_ask
        if not (can_convert if converts else is_lossless)(giving, fed):
            raise InputError(
                f"{ends}; type {type_of(giving)} feeds type {type_of(fed)}, which must be able to "
                f"hold all its values{hint}"
            )
        known = self._units(source), self._units(target)
        for one, other in zip(giving.units, fed.units, strict=True):
            if conversion(one, known[0], other, known[1]) is None and not converts:
                fitting = FITTING.get(one, "") if other in FITTING else ""
                raise InputError(
                    f"{ends}; must have the same unit, or both be defined by the same SI base "
                    f"units{fitting}{hint}"
                )

    def _units(self, end: str) -> Units:
        """Definitions of an FMU's units; what the scenario gives is not converted."""
        part = self.parts.get(end.partition(".")[0])
        return part.interface.units or OUR_UNITS if part else {}

    def unfed_message(self, instance: str, name: str) -> str:
        """Return the error for an input that must be connected; it lists the candidates."""
        _, variable = self._end(f"{instance}.{name}", "input")
        outputs = [f"{p.name}.{v.name} {_shape_and_unit(v)}" for p in self.parts.values()
                   if p.name != instance for v in p.interface.of("output")]  # fmt: skip
        return (
            f"{instance}.{name} {_shape_and_unit(variable)}: nothing feeds it; must be an output "
            f"{name} of another FMU, or connected in [connect]; outputs: "
            f"{', '.join(outputs) or 'none'}"
        )

    def _connect(
        self, source: str, giving: Variable, target: str, fed: Variable, *, converts: bool = False
    ) -> None:
        for one, other in zip(giving.names(), fed.names(), strict=True):
            if (target, other) in self._fed:
                raise InputError(f"[connect] {target}.{other}: is fed twice")
            self._fed.add((target, other))
            ends = (source, one), (target, other)
            self.connections.append(Connection(*ends, converts_types=converts))

    def _end(self, text: str, causality: str) -> tuple[str, Variable]:
        """Find one end of a connection: a variable, or an element of one."""
        instance, _, name = text.partition(".")
        if instance not in self.parts:
            raise InputError(
                f"[connect] {excerpt(text)}: no FMU {excerpt(instance)}; valid: "
                f"{', '.join(self.parts)}{did_you_mean(instance, self.parts)}"
            )
        part = self.parts[instance]
        variable = part.interface.end(name, causality)
        if variable is not None:
            return instance, variable
        names = [v.name for v in part.interface.variables if v.causality == causality]
        raise InputError(
            f"[connect] {excerpt(text)}: {part.place} has no {causality} of this name; valid: "
            f"{', '.join(names) or 'none'}{did_you_mean(name, names)}"
        )


def _shape_and_unit(variable: Variable) -> str:
    """Shape and unit, as `(7) [rad]`."""
    shape = "x".join(map(str, variable.shape)) or "scalar"
    return f"({shape}) [{', '.join(dict.fromkeys(variable.units))}]"


Array = NDArray[np.float64]
EARLY: Final = 1e-9  # [s] by which a tick may be before the row that holds from its time on


@dataclass(frozen=True, eq=False)
class DrivenInput:
    """An input over time: one row, or several at times that do not decrease.

    A continuous Real is interpolated linearly, others are held from their row on; before the first
    row and after the last, the input has these rows' values. At a jump, the later row counts.
    """

    scalar: Scalar
    values: Sequence[Value]  # of each row
    times: Array  # (n,) [s]

    @property
    def _is_interpolated(self) -> bool:
        variable = self.scalar.variable
        is_real = type_of(variable) in ("Float64", "Float32")
        return is_real and variable.variability == "continuous" and len(self.values) > 1

    def _rows(self, times: Array) -> Any:
        """The last row up to each time; the first one before it."""
        return (np.searchsorted(self.times, times + EARLY, side="right") - 1).clip(0)

    def at_start(self, time: float) -> Value:
        """Start value, for the time of the start [s]."""
        at = np.array([time])
        return (
            float(self.sample(at)[0]) if self._is_interpolated else self.values[self._rows(at)[0]]
        )

    def sample(self, times: Array) -> Any:
        """Values at some times, as rows hold them."""
        if not self._is_interpolated:
            column = [in_row(self.scalar, value) for value in self.values]
            return [column[row] for row in self._rows(times)]
        values, before = np.array(self.values), self._rows(times).clip(max=len(self.values) - 2)
        t0, t1 = self.times[before], self.times[before + 1]
        share = ((t1 - times) / np.where(t1 > t0, t1 - t0, 1.0)).clip(0.0, 1.0)
        return share * values[before] + (1.0 - share) * values[before + 1]


def driven_inputs(
    scenario: Scenario, interfaces: Mapping[str, Interface]
) -> dict[Name, DrivenInput]:
    """Check the inputs of [inputs] and of its file against the FMUs; by FMU and scalar."""
    by_fmu: dict[str, dict[str, ParameterValue]] = {}
    for key, value in scenario.inputs.items():
        if key != "file":
            instance, name = _split(key, interfaces)
            by_fmu.setdefault(instance, {})[name] = value
    driven: dict[Name, DrivenInput] = {}
    by_name = {i: {s.name: s for s in each.scalars()} for i, each in interfaces.items()}
    for instance, values in by_fmu.items():
        place = f"[inputs] {instance}"
        for name, value in expand(place, interfaces[instance], values, "input").items():
            driven[instance, name] = DrivenInput(by_name[instance][name], [value], np.zeros(1))
    table = scenario.input_table
    for key, cells in table.columns.items():
        instance, name = _split(key, interfaces)
        scalar, *others = targets(instance, interfaces[instance], by_name[instance], name, "input")
        if others or (instance, scalar.name) in driven:
            what = "has several elements" if others else "is in [inputs], too"
            raise InputError(f"{table.place}: {key}: {what}; must be one element, given once")
        place = f"{table.place}: {key}: row"
        values_over_time = [
            scalar.checked(f"{place} {row}", read_value(f"{place} {row}:", scalar.variable, cell))
            for row, cell in enumerate(cells, 1)
        ]
        times = np.array(table.times)
        driven[instance, scalar.name] = DrivenInput(scalar, values_over_time, times)
    return driven


def _split(key: str, interfaces: Mapping[str, Interface]) -> Name:
    """FMU and variable that a key names; an FMU's name may have dots."""
    fitting = [name for name in interfaces if key.startswith(f"{name}.")]
    if not fitting:
        raise InputError(
            f"[inputs] {excerpt(key)}: no such FMU; valid: {', '.join(interfaces)}"
            f"{did_you_mean(key.partition('.')[0], interfaces)}"
        )
    instance = max(fitting, key=len)
    return instance, key.removeprefix(f"{instance}.")
