"""The parts of a scenario: the file behind each of its FMUs, read without running it."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ...assets.franka import CTRL_OPEN, FINGER_SPEED_MAX, HOME_Q, OPENING_MAX, Q_MAX, Q_MIN
from ...fmus.build.engines import has_engine
from ...fmus.build.native import NativeFmu
from ...fmus.errors import InputError, did_you_mean, excerpt, refuse, valid_names
from ...fmus.interface.sensors import MEASURED
from ...fmus.interface.tables import INTERFACES
from ...fmus.interface.variables import Interface, Variable
from ...fmus.master.fmu_file import described_interface, read_fmu
from ...fmus.master.wiring import Name
from ...fmus.sources.targets import OWN, Kind, Target, build, build_fmu
from ...task.fields import check_rules
from ...task.scenario import Scenario

if TYPE_CHECKING:
    from ...fmus.sources.law import LawFile

OURS: Final = ("controller", "plant")
MODELS: Final = (".xml", ".urdf", ".mjb")
# Words for the project's own FMUs. The trajectory's is made for each table.
WORDS: Final = tuple(word for word in OWN if word != "trajectory")
FORMS: Final = f"LAW.py:CLASS, an .fmu file, a model (.xml, .urdf, .mjb), or {', '.join(WORDS)}"
# Output of a law if the arm has motors.
TORQUES: Final = Variable(
    "ctrl", (8,), (*["N.m"] * 7, "1"), "input", "continuous", "Torques of seven joints, then the "
    "gripper, 0 (closed) to 255 (open)", (0.0,) * 7 + (CTRL_OPEN,),
)  # fmt: skip
# [1/s] By which it follows the law: the Franka Hand moves its fingers no faster.
RATES: Final = (*[math.inf] * 7, CTRL_OPEN * 2.0 * FINGER_SPEED_MAX / OPENING_MAX)
# A law's first output that is surely not what the scene takes:
AT_HOME: Final = 0.2  # [rad] torques of all joints that are so near to the joints' angles
BEYOND: Final = 1.0  # [rad] angles that are so far beyond a joint's range
_NAME: Final = re.compile(r"[A-Za-z_]\w*", re.A)


@dataclass(frozen=True)
class Part:
    """One FMU of a scenario."""

    name: str  # of the instance
    file: Path | None  # where it comes from; None: the project's own
    interface: Interface
    own: str = ""  # which of the project's own it is, by its word; "": none
    source: NativeFmu | None = None  # what it is built from; None: ours, or an .fmu
    target: Target = field(default_factory=Target)  # what it is built for, unless told otherwise
    built: Path | None = None  # an .fmu, which is used as it is

    def make(self, target: Target | None = None) -> Path:
        """Build the FMU, if need be, for this platform or a target; return its path."""
        chosen = replace(target, mujoco=self.target.mujoco) if target else self.target
        if self.source is not None:
            return build_fmu(self.source, target=chosen)
        return self.built or build([self.own], target=chosen)[self.own]

    @property
    def is_model(self) -> bool:
        """Whether it is made of a MuJoCo model here."""
        return self.interface.is_model and not (self.file and self.built)


def part_path(scenario: Scenario, given: str) -> tuple[Path, str]:
    """Return the file that a scenario names, and the class in it, if it names one."""
    file, colon, name = given.rpartition(":")
    if not (colon and file.endswith(".py")):
        file, name = given, ""
    return (scenario.folder or Path()) / file, name


def read_parts(
    scenario: Scenario, kind: Kind, files: Mapping[str, Path], *, run_code: bool
) -> list[Part]:
    """Read all FMUs that a scenario names, by name."""
    # With a trajectory, `plant` and `controller` default to the project's own.
    for name in scenario.fmus:
        if not _NAME.fullmatch(name):
            raise InputError(f"[fmus] {excerpt(name)}: must be a name of letters, digits and _")
    ours: tuple[str, ...] = () if scenario.is_system else OURS
    if scenario.mismatch.has_sensors:
        ours = ("sensors", *ours)
    # What only reads downloads no engine; the installed one gives the same interfaces.
    here = scenario if run_code or has_engine(scenario.mujoco) else replace(scenario, mujoco="")
    parts: dict[str, Part] = {}
    laws: dict[str, LawFile] = {}
    names = sorted({*ours, *scenario.fmus})
    for name in names:
        text = scenario.fmus.get(name, name)
        if text in WORDS:
            target = Target(kind, mujoco=here.mujoco)
            interface, built = OWN[text].interface, files.get(text)
            parts[name] = Part(name, None, interface, text, target=target, built=built)
        elif law := _law(here, name, text):
            laws[name] = law
        else:
            parts[name] = _read(here, name, text, run_code)
    for name, law in laws.items():  # its signals are those of the parts around it
        parts[name] = _law_part(scenario, name, law, parts)
    _check_engine(scenario, kind, parts)
    return [parts[name] for name in names]


def _check_engine(scenario: Scenario, kind: Kind, parts: Mapping[str, Part]) -> None:
    """Refuse keys about MuJoCo and about the plant where no FMU is meant."""
    ours = [part.own for part in parts.values() if part.own in OURS]
    in_python = any(Target(kind).kind_of(word) != "native" for word in ours)
    has_model = any(part.is_model for part in parts.values())
    is_scaled = scenario.input_scale != 1.0
    rules = {
        "mujoco: FMUs in Python use the installed version": scenario.mujoco and in_python,
        "mujoco: no FMU here is made from a MuJoCo model": scenario.mujoco and not has_model,
        "input_scale: there is no FMU named plant": is_scaled and "plant" not in parts,
    }
    check_rules({f"{rule}; must be left out": broken for rule, broken in rules.items()})


def _law(scenario: Scenario, name: str, text: str) -> LawFile | None:
    """Read the class that [fmus] names, if it is a law; refuse what is no part at all."""
    path, class_name = part_path(scenario, text)
    if path.suffix not in (".py", ".fmu", *MODELS):
        refuse(f"[fmus] {name}", text, f"must be {FORMS}", WORDS)
    if not path.is_file():
        raise InputError(f"[fmus] {name}: {path}: no such file; must be {FORMS}")
    if path.suffix != ".py":
        return None
    if not class_name:
        refuse(f"[fmus] {name}", text, "must name a class: FILE.py:CLASS")
    from ...fmus.sources.law import read_law  # noqa: PLC0415 - few scenarios need it

    return read_law(path, class_name)


def _read(scenario: Scenario, name: str, text: str, run_code: bool) -> Part:
    """Read a file that is no law: a slave of PythonFMU, an FMU, or a model."""
    path, class_name = part_path(scenario, text)
    section = scenario.sections.get(name, {})
    match path.suffix:
        case ".fmu":
            fmu = read_fmu(path).restructured(section)
            return Part(name, path, described_interface(fmu), built=path)
        case ".py":
            return _slave(name, path, class_name, run_code)
    from ...fmus.sources.model_fmu import model_part  # noqa: PLC0415 - few scenarios need it

    model = model_part(path, scenario.robot, section.get("keyframe", ""))
    return Part(name, path, model.interface, source=model, target=Target(mujoco=scenario.mujoco))


def _slave(name: str, path: Path, class_name: str, run_code: bool) -> Part:
    from ...fmus.sources.python_fmu import slave_fmu  # noqa: PLC0415 - few scenarios need it

    if not run_code:
        raise UnreadSlaveError(f"{path}: {class_name} is a PythonFMU slave; its variables are "
                               "only known when it is run")  # fmt: skip
    slave = slave_fmu(path, class_name)
    path = build_fmu(slave)
    return Part(name, path, described_interface(read_fmu(path)), source=slave)


class UnreadSlaveError(InputError):
    """A PythonFMU slave's variables are not known without running it."""


def _law_part(scenario: Scenario, name: str, law: LawFile, parts: Mapping[str, Part]) -> Part:
    """Give a law's FMU the shapes and units of the variables it is connected to."""
    from ...fmus.sources.law import law_fmu, law_interface  # noqa: PLC0415 - few need it

    is_ours = name == "controller" and not scenario.is_system
    ctrl = _ctrl_of(scenario, name, law, parts)
    interface = law_interface(law, _signals(scenario, name, is_ours, parts).get, ctrl)
    start = tuple(float(s.start or 0.0) for s in ctrl.scalars(0))
    first = _first_ctrl(scenario) if is_ours else None
    rates = RATES if ctrl is TORQUES else None
    return Part(name, law.path, interface, source=law_fmu(law, interface, start, first, rates))


def _signals(
    scenario: Scenario, law: str, is_ours: bool, parts: Mapping[str, Part]
) -> dict[str, Variable]:
    """What a law's inputs are: as connected, as our controller's, or outputs of their name."""
    outputs = {v.name: v for p in reversed([*parts.values()]) for v in p.interface.of("output")}
    known = {v.name: v for v in INTERFACES["controller"].of("input")}
    if not ("plant" in parts and measures_a_panda(parts["plant"].interface)):
        known = {name: known[name] for name in scenario.commands} if is_ours else {}
    connected = {
        target.removeprefix(f"{law}."): variable
        for target, source in scenario.connect.items()
        if target.startswith(f"{law}.") and (variable := _variable(parts, source, "output"))
    }
    return outputs | known | connected


def _first_ctrl(scenario: Scenario) -> dict[str, Any] | None:
    """What torques, or servo targets, of the arm are like at the start, where it rests."""
    if scenario.is_torque_driven:
        low, high = np.array(HOME_Q) - AT_HOME, np.array(HOME_Q) + AT_HOME
        reason = 'that is where the arm is [rad]; scene "tabletop" takes angles, this one torques'
    elif "plant" in scenario.fmus:
        return None
    else:
        low, high = Q_MIN - BEYOND, Q_MAX + BEYOND
        reason = 'the joints cannot get there [rad]; scene "motors" takes torques, this one angles'
    within = not scenario.is_torque_driven
    return {"low": low.tolist(), "high": high.tolist(), "within": within, "reason": reason}


def measures_a_panda(interface: Interface) -> bool:
    """Whether a plant has all outputs that PandaController measures; its vectors may be longer."""
    shapes = {v.name: v.shape for v in interface.of("output")}
    measured = [INTERFACES["controller"].variable(name) for name in MEASURED]
    return all(
        len(shapes.get(v.name, ())) == len(v.shape) and shapes[v.name] >= v.shape for v in measured
    )


def _ctrl_of(scenario: Scenario, name: str, law: LawFile, parts: Mapping[str, Part]) -> Variable:
    """The input that a law's ctrl is connected to."""
    targets = [target for target, source in scenario.connect.items() if source == f"{name}.ctrl"]
    for connected in filter(None, (_variable(parts, target, "input") for target in targets)):
        return connected
    if scenario.is_torque_driven and name == "controller":
        return TORQUES
    plant_first = sorted(parts.values(), key=lambda part: part.name != "plant")
    inputs = {f"{p.name}.{v.name}": v for p in plant_first for v in p.interface.of("input")}
    for variable in inputs.values():
        if variable.name == "ctrl":
            return variable
    must = f"must name one of {', '.join(inputs) or 'none'}{did_you_mean('ctrl', inputs)}"
    raise InputError(f"{law.path}: no input takes the ctrl of {name}; [connect] {must}")


def _variable(parts: Mapping[str, Part], end: str, causality: str) -> Variable | None:
    instance, _, name = end.partition(".")
    return parts[instance].interface.end(name, causality) if instance in parts else None


def split(place: str, key: str, fmus: Collection[str]) -> Name:
    """FMU and variable that a key names; an FMU's name may have dots."""
    fitting = [name for name in fmus if key.startswith(f"{name}.")]
    if not fitting:
        first = key.partition(".")[0]
        valid = valid_names(first, fmus)
        raise InputError(f"{place}{excerpt(key)}: no FMU {excerpt(first)}; {valid}")
    instance = max(fitting, key=len)
    return instance, key.removeprefix(f"{instance}.")


def end_of(
    place: str, text: str, parts: Mapping[str, Part], causality: str
) -> tuple[str, Variable]:
    """Return FMU and variable of what is named FMU.VARIABLE, or an element of one."""
    instance, name = split(place, text, parts)
    part = parts[instance]
    variable = part.interface.end(name, causality)
    if variable is None:
        names = [v.name for v in part.interface.variables if v.causality == causality]
        raise InputError(
            f"{place}{excerpt(text)}: {instance} ({part.file or part.interface.model}) has no "
            f"{causality} of this name; {valid_names(name, names)}"
        )
    return instance, variable
