"""The parts of a scenario: the file behind each of its FMUs, read without running it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ...assets.franka import CTRL_OPEN, HOME_Q, Q_MAX, Q_MIN
from ...fmus.build.engines import has_engine
from ...fmus.build.native import NativeFmu
from ...fmus.errors import InputError, did_you_mean, excerpt, refuse
from ...fmus.interface.sensors import MEASURED
from ...fmus.interface.tables import INTERFACES
from ...fmus.interface.variables import Interface, Variable
from ...fmus.master.fmu_file import described_interface, read_fmu
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
    target: Target = field(
        default_factory=Target
    )  # what it is built for, unless another is asked for
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
        is_file = self.file is not None and self.file.suffix == ".fmu"
        return self.interface.is_model and not is_file

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
    kind: Kind = "auto",
    files: Mapping[str, Path] | None = None,
    *,
    run_code: bool = True,
) -> list[Part]:
    """Read all FMUs that a scenario names, by name."""
    # With a trajectory, `plant` and `controller` default to the project's own.
    for name in scenario.fmus:
        if not _NAME.fullmatch(name):
            raise InputError(f"[fmus] {excerpt(name)}: must be a name of letters, digits and _")
    ours: tuple[str, ...] = () if scenario.is_system else OURS
    if scenario.mismatch.has_sensors and ours:
        ours = ("sensors", *ours)
    # What only reads downloads no engine; the installed one gives the same interfaces.
    here = scenario if run_code or has_engine(scenario.mujoco) else replace(scenario, mujoco="")
    read = {
        name: _given(here, name, kind, run_code)
        if name in scenario.fmus
        else _own(name, name, Target(kind, mujoco=here.mujoco), files or {})
        for name in sorted({*ours, *scenario.fmus})
    }
    parts = {name: part for name, part in read.items() if isinstance(part, Part)}
    for name, law in read.items():
        if not isinstance(law, Part):  # its signals are those of the parts around it
            parts[name] = _law_part(scenario, name, law, parts)
    _check_engine(scenario, kind, parts)
    return [parts[name] for name in read]


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


def _own(name: str, word: str, own: Target, files: Mapping[str, Path]) -> Part:
    """Return one of the project's own FMUs under a name."""
    if own.kind_of(word) != "native":
        from ...fmus.sources.python_fmu import require_pythonfmu  # noqa: PLC0415 - few need it

        require_pythonfmu()
    return Part(name, None, OWN[word].interface, word, target=own, built=files.get(name))


def _given(scenario: Scenario, name: str, kind: Kind, run_code: bool) -> Part | LawFile:
    """Return what [fmus] names: one of the project's own by its word, or a file."""
    text = scenario.fmus[name]
    if text in WORDS:
        return _own(name, text, Target(kind, mujoco=scenario.mujoco), {})
    return _read(scenario, name, text, run_code)


def _read(scenario: Scenario, name: str, text: str, run_code: bool) -> Part | LawFile:
    path, class_name = part_path(scenario, text)
    if path.suffix not in (".py", ".fmu", *MODELS):
        refuse(f"[fmus] {name}", text, f"must be {FORMS}", WORDS)
    if not path.is_file():
        raise InputError(f"[fmus] {name}: {path}: no such file; must be {FORMS}")
    if path.suffix == ".py":
        if not class_name:
            refuse(f"[fmus] {name}", text, "must name a class: FILE.py:CLASS")
        from ...fmus.sources.law import read_law  # noqa: PLC0415 - few scenarios need it

        law = read_law(path, class_name)
        if law is not None:
            return law
        from ...fmus.sources.python_fmu import require_pythonfmu, slave_fmu  # noqa: PLC0415

        require_pythonfmu()
        if not run_code:
            raise UnreadSlaveError(f"{path}: {class_name} is a PythonFMU slave; its variables are "
                                   "only known when it is run")  # fmt: skip
        slave = slave_fmu(path, class_name)
        path = build_fmu(slave)
        interface = described_interface(read_fmu(path))
        return Part(name, path, interface, source=slave)
    if path.suffix != ".fmu":
        from ...fmus.sources.model_fmu import model_part  # noqa: PLC0415 - see above

        keyframe = scenario.sections.get(name, {}).get("keyframe", "")
        model = model_part(path, scenario.robot, keyframe)
        engine = Target(mujoco=scenario.mujoco)
        return Part(name, path, model.interface, source=model, target=engine)
    fmu = read_fmu(path).restructured(scenario.sections.get(name, {}))
    return Part(name, path, described_interface(fmu), built=path)


class UnreadSlaveError(InputError):
    """A PythonFMU slave's variables are not known without running it."""


def _law_part(scenario: Scenario, name: str, law: LawFile, parts: Mapping[str, Part]) -> Part:
    """Give a law's FMU the shapes and units of the variables it is connected to."""
    from ...fmus.sources.law import law_fmu, law_interface  # noqa: PLC0415 - few need it

    ctrl = _ctrl_of(scenario, name, law, parts)
    ours, plant = INTERFACES["controller"], parts.get("plant")
    measured = plant is not None and measures_a_panda(plant.interface)
    commanded = name == "controller" and not scenario.is_system
    inputs = (v.name for v in ours.of("input"))
    known = {n for n in inputs if measured or (commanded and n in scenario.commands)}

    def signal(name_of_input: str) -> Variable | None:
        source = scenario.connect.get(f"{name}.{name_of_input}", "")
        connected = _variable(parts, source, "output")
        if connected is not None or name_of_input in known:
            return connected or ours.variable(name_of_input)
        outputs = (v for p in parts.values() for v in p.interface.of("output"))
        return next((v for v in outputs if v.name == name_of_input), None)

    interface = law_interface(law, signal, ctrl)
    start = tuple(float(s.start or 0.0) for s in ctrl.scalars(0))
    first = _first_ctrl(scenario) if name == "controller" and not scenario.is_system else None
    return Part(name, law.path, interface, source=law_fmu(law, interface, start, first))


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
    for target, source in scenario.connect.items():
        connected = _variable(parts, target, "input") if source == f"{name}.ctrl" else None
        if connected is not None:
            return connected
    if scenario.is_torque_driven and name == "controller":
        return TORQUES
    for part in sorted(parts.values(), key=lambda p: p.name != "plant"):
        for variable in part.interface.of("input"):
            if variable.name == "ctrl":
                return variable
    inputs = [f"{p.name}.{v.name}" for p in parts.values() for v in p.interface.of("input")]
    raise InputError(
        f"{law.path}: no input takes the ctrl of {name}; [connect] must name one of "
        f"{', '.join(inputs) or 'none'}{did_you_mean('ctrl', inputs)}"
    )


def _variable(parts: Mapping[str, Part], end: str, causality: str) -> Variable | None:
    instance, _, name = end.partition(".")
    return parts[instance].interface.end(name, causality) if instance in parts else None
