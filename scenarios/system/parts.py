"""The parts of a scenario: the file behind each of its FMUs, read without running it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ...assets.franka import CTRL_OPEN
from ...fmus.errors import InputError
from ...fmus.files.fmu_file import described_interface, read_fmu
from ...fmus.interface.sensors import SENSORS
from ...fmus.interface.tables import COMMANDS, INTERFACES
from ...fmus.interface.variables import Interface, Variable, joints
from ...fmus.messages import did_you_mean, excerpt
from ...fmus.sources.targets import Kind, Target, build, build_fmu
from ..scenario.scenario import Scenario

if TYPE_CHECKING:
    from ...fmus.sources.law import LawFile

OURS: Final = ("controller", "plant")
MODELS: Final = (".xml", ".urdf", ".mjb")
FORMS: Final = "LAW.py:CLASS, an .fmu file, or a model (.xml, .urdf, .mjb)"
# Output of a law if the arm has motors.
TORQUES: Final = Variable(
    "ctrl", (8,), joints("N.m", "1"), "input", "continuous", "Torques of seven joints, then the "
    "gripper, 0 (closed) to 255 (open)", (0.0,) * 7 + (CTRL_OPEN,),
)  # fmt: skip
_NAME: Final = re.compile(r"[A-Za-z_]\w*", re.A)


@dataclass(frozen=True)
class Part:
    """One FMU of a scenario.

    Attributes:
        name: Name of the instance.
        file: Where it comes from, or None for the project's own.
        interface: Its variables.
        make: Builds the FMU, if need be, and returns its path.
        law: The law it is made from, if any.
    """

    name: str
    file: Path | None
    interface: Interface
    make: Callable[[], Path]
    law: LawFile | None = None

    @property
    def place(self) -> str:
        """Its name in messages."""
        return f"{self.name} ({self.file or self.interface.model})"


def part_path(scenario: Scenario, given: str) -> tuple[Path, str]:
    """Return the file that a scenario names, and the class in it, if it names one."""
    file, colon, name = given.rpartition(":")
    if not (colon and file.endswith(".py")):
        file, name = given, ""
    return (scenario.folder or Path()) / file, name


def read_parts(
    scenario: Scenario,
    kind: Kind = "native",
    files: Mapping[str, Path] | None = None,
    *,
    run_code: bool = True,
) -> list[Part]:
    """Read all FMUs that a scenario names, in the order of stepping: the plant is last.

    With a trajectory, `plant` and `controller` default to the project's own.
    """
    named: dict[str, str | None] = dict(scenario.fmus)
    for name in named:
        if not _NAME.fullmatch(name):
            raise InputError(f"[fmus] {excerpt(name)}: must be a name of letters, digits and _")
    if not scenario.is_system:
        sensors = ("sensors",) if scenario.mismatch.has_sensors else ()
        named = {**dict.fromkeys((*sensors, *OURS)), **named}
    order = sorted(named, key=lambda n: (n == "plant", n == "controller"))
    parts: dict[str, Part] = {}
    laws: dict[str, LawFile] = {}
    for name in order:
        given = named[name]
        found = (
            _ours(name, kind, files or {})
            if given is None
            else _read(scenario, name, given, run_code)
        )
        if isinstance(found, Part):
            parts[name] = found
        else:
            laws[name] = found
    for name, law in laws.items():
        parts[name] = _law_part(scenario, name, law, parts)
    return [parts[name] for name in order]


def _ours(name: str, kind: Kind, files: Mapping[str, Path]) -> Part:
    interface = SENSORS if name == "sensors" else INTERFACES[name]
    if name in files:
        return Part(name, None, interface, lambda: files[name])
    return Part(name, None, interface, lambda: build([name], target=Target(kind))[name])


def _read(scenario: Scenario, name: str, given: str, run_code: bool) -> Part | LawFile:
    path, class_name = part_path(scenario, given)
    if path.suffix not in (".py", ".fmu", *MODELS):
        raise InputError(f"[fmus] {name}: value {excerpt(given)}; must be {FORMS}")
    if not path.is_file():
        raise InputError(f"[fmus] {name}: {path}: there is no such file; must be {FORMS}")
    if path.suffix == ".py":
        if not class_name:
            raise InputError(
                f"[fmus] {name}: value {excerpt(given)}; must name a class: FILE.py:CLASS"
            )
        from ...fmus.sources.law import read_law  # noqa: PLC0415 - few scenarios need it

        law = read_law(path, class_name)
        if not law.is_slave:
            return law
        if not run_code:
            raise UnreadSlaveError(f"{path}: {class_name} is a PythonFMU slave; its variables are "
                                   "only known when it is run")  # fmt: skip
        from ...fmus.sources.python_fmu import slave_fmu  # noqa: PLC0415 - see above

        path = build_fmu(slave_fmu(law.path, law.name))
    elif path.suffix != ".fmu":
        from ...fmus.sources.model_fmu import model_part  # noqa: PLC0415 - see above

        model = model_part(path)
        return Part(name, path, model.interface, lambda: build_fmu(model))
    return Part(name, path, described_interface(read_fmu(path)), lambda: path)


class UnreadSlaveError(InputError):
    """A PythonFMU slave's variables are not known without running it."""


def _law_part(scenario: Scenario, name: str, law: LawFile, parts: Mapping[str, Part]) -> Part:
    """Give a law's FMU the shapes and units of the variables it is connected to."""
    from ...fmus.sources.law import law_fmu, law_interface  # noqa: PLC0415 - few need it

    ctrl = _ctrl_of(scenario, name, law, parts)

    def signal(wanted: str) -> Variable | None:
        target = f"{name}.{wanted}"
        given = _variable(parts, scenario.connect.get(target, ""), "output")
        if given is not None:
            return given
        ours = INTERFACES["controller"]
        plant = parts.get("plant")
        is_command = wanted in COMMANDS and name == "controller" and not scenario.is_system
        is_measured = plant is not None and measures_a_panda(plant.interface)
        if is_command or (is_measured and wanted in {v.name for v in ours.of("input")}):
            return ours.variable(wanted)
        found = [v for p in parts.values() for v in p.interface.of("output") if v.name == wanted]
        return found[0] if found else None

    interface = law_interface(law, signal, ctrl)
    start = tuple(float(s.start or 0.0) for s in ctrl.scalars(0))
    return Part(name, law.path, interface, lambda: build_fmu(law_fmu(law, interface, start)), law)


def measures_a_panda(interface: Interface) -> bool:
    """Whether a plant has all outputs that PandaController measures; its vectors may be longer."""
    given = {v.name: v.shape for v in interface.of("output")}
    wanted = [v for v in INTERFACES["controller"].of("input") if v.name not in COMMANDS]
    return all(
        len(given.get(v.name, ())) == len(v.shape) and given[v.name] >= v.shape for v in wanted
    )


def _ctrl_of(scenario: Scenario, name: str, law: LawFile, parts: Mapping[str, Part]) -> Variable:
    """The input that a law's ctrl is connected to."""
    for target, source in scenario.connect.items():
        if source == f"{name}.ctrl":
            found = _variable(parts, target, "input")
            if found is not None:
                return found
    if scenario.is_torque_driven and name == "controller":
        return TORQUES
    for part in sorted(parts.values(), key=lambda p: p.name != "plant"):
        for variable in part.interface.of("input"):
            if variable.name == "ctrl":
                return variable
    inputs = [f"{p.name}.{v.name}" for p in parts.values() for v in p.interface.of("input")]
    raise InputError(
        f"{law.path}: nothing takes the ctrl of {name}; [connect] must name an input, one of "
        f"{', '.join(inputs) or 'none'}{did_you_mean('ctrl', inputs)}"
    )


def _variable(parts: Mapping[str, Part], end: str, causality: str) -> Variable | None:
    instance, _, name = end.partition(".")
    return find_variable(parts[instance].interface, name, causality) if instance in parts else None


def find_variable(interface: Interface, name: str, causality: str) -> Variable | None:
    """Return a variable, or an element of one as a scalar variable; None: there is none."""
    for variable in interface.variables:
        if variable.causality != causality:
            continue
        if variable.name == name:
            return variable
        for i, scalar in enumerate(variable.scalars(0)):
            if scalar.name == name:
                start = variable.start[i] if isinstance(variable.start, tuple) else variable.start
                return replace(
                    variable, name=name, shape=(), unit=scalar.unit, start=start,
                    minimum=scalar.minimum, maximum=scalar.maximum,
                )  # fmt: skip
    return None
