"""Connects the FMUs of a scenario: as [connect] says, and by name."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import Final

from ...fmus.errors import InputError
from ...fmus.interface.controller import FORCE_COMMAND, POSTURE_COMMANDS
from ...fmus.interface.plant import FORCES
from ...fmus.interface.sensors import measurement_of
from ...fmus.interface.tables import Connection
from ...fmus.interface.types import can_convert, is_lossless, type_of
from ...fmus.interface.units import OUR_UNITS, Units, conversion
from ...fmus.interface.variables import Variable
from ...fmus.master.wiring import Name
from ...plant.parameters import ARM_JOINTS
from .parts import Part, end_of, measures_a_panda

# Inputs of PandaPlant and PandaController that act only in some scenarios; those that may stay
# unconnected.
RARE: Final = ("torque", *POSTURE_COMMANDS, FORCE_COMMAND)
OPTIONAL: Final = (*FORCES.values(), *RARE)
_OF_ARM: Final = ("qpos", "qvel")  # of PandaPlant, which begin with the arm's, then the fingers'
_LENGTHS: Final = ((len(ARM_JOINTS),), (len(ARM_JOINTS) + 2,))  # of these, what others take
_CONVERT: Final = re.compile(r"convert\((.+)\)", re.S)
# What takes an arm's ctrl of another unit.
FITTING: Final = {
    ("N.m", "rad"): '; scene "motors" takes torques',
    ("rad", "N.m"): '; scene "tabletop" takes angles',
}
SHOWN: Final = 8  # unconnected inputs of an FMU that are named


class Connector:
    """Connects the FMUs of a scenario, and checks shapes, types and units on the way.

    `assemble` makes one for each scenario with parts of its own, and keeps only the connections
    that it has found. Those of an .ssp file are complete.
    """

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

    def drive(self, names: Collection[Name]) -> None:
        """Mark inputs as given by the scenario; what is connected cannot be."""
        check_unfed(names, self._fed)
        self._fed.update(names)

    def connect(self, target: str, source: str) -> None:
        """Connect two ends, written as in [connect]: `fmu.variable`, or an element of one."""
        # The source may be `convert(fmu.variable)`, which also converts types with loss.
        asked = _CONVERT.fullmatch(source)
        source = asked[1] if asked else source
        to_part, fed = end_of("[connect] ", target, self.parts, "input")
        from_part, giving = end_of("[connect] ", source, self.parts, "output")
        self.check(source, giving, target, fed, "[connect] ", converts=bool(asked))
        for name in fed.names():
            if (to_part, name) in self._fed:
                raise InputError(f"[connect] {to_part}.{name}: is fed twice")
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
        self._fed |= {("plant", f"ctrl[{i}]") for i in range(1, 8)}

    def connect_sensors(self, names: Sequence[str]) -> None:
        """Connect measurements to the controller's inputs of some names that are not fed yet."""
        inputs = {v.name: v for v in self.parts["controller"].interface.of("input")}
        for name in names:
            if name in inputs and not self.is_fed("controller", name):
                measured = self.parts["sensors"].interface.variable(measurement_of(name))
                # The rest, such as fingers, is not measured.
                for fed, giving in zip(inputs[name].names(), measured.names(), strict=False):
                    self.connect(f"controller.{fed}", f"sensors.{giving}")

    def connect_rest_by_name(self) -> None:
        """Connect all inputs that are not fed yet."""
        for part in self.parts.values():
            for variable in part.interface.of("input"):
                self.connect_by_name(part, variable)

    def connect_by_name(self, part: Part, variable: Variable) -> None:
        """Connect an input to the one output of its name."""
        unfed = [name for name in variable.names() if (part.name, name) not in self._fed]
        outputs = [(i, v) for i, v in self._outputs.get(variable.name, ()) if i != part.name]
        match outputs if unfed else ():
            case [(source, giving)]:
                self._connect_alike(source, giving, part.name, variable)
            case [_, _, *_]:
                names = " and ".join(f"{name}.{variable.name}" for name, _ in outputs)
                target = f"{part.name}.{variable.name}"
                raise InputError(f"{target}: {names} both match; choose one in [connect]")
            case [] if unfed and part.file is not None and variable.name not in OPTIONAL:
                whole = len(unfed) == variable.size
                self._open.setdefault(part.name, []).extend([variable.name] if whole else unfed)

    def _connect_alike(self, source: str, giving: Variable, target: str, fed: Variable) -> None:
        """Connect two ends of one name; a law for the arm takes the first elements."""
        is_of_arm = giving.name in _OF_ARM and fed.shape in _LENGTHS
        if is_of_arm and measures_a_panda(self.parts[source].interface):
            giving = replace(giving, shape=fed.shape, unit=giving.units[: fed.size])
        self.check(f"{source}.{giving.name}", giving, f"{target}.{fed.name}", fed)
        self._connect(source, giving, target, fed)

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
        is_of_fmu = source.partition(".")[0] in self.parts
        if giving.shape != fed.shape:
            to, of = (v.names()[0].removeprefix(v.name) for v in (fed, giving))
            hint = f', or [connect] must name elements, such as "{target}{to}" = "{source}{of}"'
            raise InputError(f"{ends}; must have the same shape{hint * is_of_fmu}")
        can_ask = can_convert(giving, fed) and is_of_fmu
        hint = f', or be asked for in [connect]: "{target}" = "convert({source})"' * can_ask
        if not (can_convert if converts else is_lossless)(giving, fed):
            must = f"which must be able to hold all its values{hint}"
            raise InputError(f"{ends}; type {type_of(giving)} feeds type {type_of(fed)}, {must}")
        for wrong in [] if converts else self._apart(source, giving, target, fed):
            raise InputError(
                f"{ends}; must have the same unit, or both be defined by the same SI base "
                f"units{FITTING.get(wrong, '')}{hint}"
            )

    def _apart(
        self, source: str, giving: Variable, target: str, fed: Variable
    ) -> Iterator[tuple[str, str]]:
        """Units of elements, from and to, between which there is no conversion."""
        of, to = self._units(source), self._units(target)
        for one, other in zip(giving.units, fed.units, strict=True):
            if conversion(one, of, other, to) is None:
                yield one, other

    def _units(self, end: str) -> Units:
        """Definitions of an FMU's units; what the scenario gives is not converted."""
        part = self.parts.get(end.partition(".")[0])
        return part.interface.units or OUR_UNITS if part else {}

    def require_ctrl(self) -> None:
        """Refuse a plant whose ctrl is not connected; the message lists the candidates."""
        _, ctrl = end_of("", "plant.ctrl", self.parts, "input")
        if not self.is_fed("plant", "ctrl"):
            outputs = [f"{part.name}.{v.name} {_shape_and_unit(v)}" for part in self.parts.values()
                       if part.name != "plant" for v in part.interface.of("output")]  # fmt: skip
            raise InputError(
                f"plant.ctrl {_shape_and_unit(ctrl)}: nothing feeds it; must be an output ctrl of "
                f"another FMU, or connected in [connect]; outputs: {', '.join(outputs) or 'none'}"
            )

    def _connect(
        self, source: str, giving: Variable, target: str, fed: Variable, *, converts: bool = False
    ) -> None:
        """Connect the elements of two ends, but those that are fed already."""
        for one, other in zip(giving.names(), fed.names(), strict=True):
            ends = (source, one), (target, other)
            if ends[1] not in self._fed:
                self._fed.add(ends[1])
                self.connections.append(Connection(*ends, converts_types=converts))


def check_unfed(driven: Collection[Name], fed: set[Name]) -> None:
    """Refuse inputs driven by the scenario that are connected."""
    if both := fed.intersection(driven):
        ends = ", ".join(sorted(map(".".join, both)))
        raise InputError(f"[inputs] {ends}: is fed already; must be an unconnected input")


def _shape_and_unit(variable: Variable) -> str:
    """Shape and unit, as `(7) [rad]`."""
    shape = "x".join(map(str, variable.shape)) or "scalar"
    return f"({shape}) [{', '.join(dict.fromkeys(variable.units))}]"
