"""How a scenario is run, and its values changed: by options, and by key for `--set` and sweeps.

A key is a parameter of an FMU (`plant.block_mass`, `controller.kp[3]`) or a place in the scenario:
`duration`, `table.rows[3].x`, `push[1].force[2]`, `success.max_slip`. Indices start at 1.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any, Final, get_args

from ...fmus.errors import InputError, did_you_mean
from ...fmus.interface.parameters import ParameterValue, literal
from ...fmus.master.step import Coupling, Stepper
from ...fmus.sources.targets import Kind
from ..fields import Quantity, check_choice, check_keys, field_names
from ..scenario.mismatch import Mismatch, default_of
from ..scenario.scenario import TABLE_FILE, Scenario
from ..scenario.table import QUATERNION_COLUMNS, InputTable
from .start import Overrides

MAX_TIME_LIMIT = 1e9  # [s]
TOP: Final = (
    "duration",
    "scene",
    "robot",
    "gains",
    "coupling",
    "tolerance",
    "interpolation",
    "timing",
    "timing_share",
    "route",
    "align",
    "mujoco",
    "preflight",
    "input_scale",
)
_SECTIONS: Final = ("table.", "push[", "success.", "mismatch.", "inputs.")
_STEP: Final = re.compile(r"(\w+)(?:\[(\d{1,6})\])?", re.A)
_COLUMNS: Final = {  # of the table's file, whose rows have them in vectors
    **{name: ("position", i) for i, name in enumerate("xyz")},
    **{name: ("orientation", i) for i, name in enumerate(QUATERNION_COLUMNS)},
}
Steps = tuple[str | int, ...]  # to a place in a scenario: names of fields, and indices from 0


@dataclass(frozen=True)
class Options:
    """Options of a run, besides the scenario's own settings.

    Attributes:
        overrides: Parameters by instance and name.
        coupling: Coupling, instead of the scenario's; None: the scenario's.
        realtime: Speed relative to the wall clock; 0: as fast as possible.
        fmus: FMU files by instance; None: the project's own.
        kind: Kind of the project's own: "native", "python", "pythonfmu" (in Python, packed by
            PythonFMU), or "auto": native while they are proven equal to the Python code.
        isolate: Run each FMU in a separate process, so that a crash ends only that process.
        step_timeout: Wall time that a step of an isolated FMU may take [s]; None: unlimited.
        time_limit: Wall time that all steps may take [s]; None: unlimited. Checked between
            steps; for an FMU that hangs in a step, use `isolate` and `step_timeout`.
        parts: FMUs by instance, instead of the scenario's [fmus]; paths are relative to the
            working directory.
        master: What steps the FMUs: "kernel", in C where it can, or "fmpy", by FMPy's methods.

    Raises:
        InputError: A value is out of bounds, or step_timeout is set without isolate.
    """

    overrides: Overrides = field(default_factory=dict)
    coupling: Coupling | None = None
    realtime: float = 0.0
    fmus: Mapping[str, Path] | None = None
    kind: Kind = "auto"
    isolate: bool = False
    step_timeout: float | None = None
    time_limit: float | None = None
    parts: Mapping[str, str] = field(default_factory=dict)
    master: Stepper = "kernel"

    def __post_init__(self) -> None:
        """Check values that may come from a command line."""
        if not (math.isfinite(self.realtime) and self.realtime >= 0.0):
            raise InputError(f"realtime: value {self.realtime!r}; must be a number of at least 0")
        check_choice("kind", self.kind, get_args(Kind))
        check_choice("master", self.master, get_args(Stepper))
        if not (self.step_timeout is None or 0.0 < self.step_timeout < math.inf):
            raise InputError(
                f"--step-timeout: value {self.step_timeout!r}; must be a number above 0 s"
            )
        if self.step_timeout is not None and not self.isolate:
            raise InputError("--step-timeout: needs --isolate, which alone can end a step")
        if self.time_limit is not None:
            Quantity(0.0, MAX_TIME_LIMIT, "s").check("time_limit", self.time_limit)


def with_options(scenario: Scenario, options: Options) -> Scenario:
    """Return the scenario with the values of the options, which `prepare` checks."""
    if options.parts and scenario.system:
        name = next(iter(options.parts))
        raise InputError(f"{name}: cannot be combined with system = {scenario.system!r}")
    parts = {name: _from_here(text) for name, text in options.parts.items()}
    scenario = replace(scenario, fmus={**scenario.fmus, **parts})
    ours = () if scenario.is_system else ("plant", "controller", "sensors")
    instances = tuple(dict.fromkeys((*ours, *scenario.fmus)))
    for name in options.overrides:
        if name not in instances and not scenario.system:
            hint = did_you_mean(name, instances)
            raise InputError(f"{name!r} is not an instance; valid: {', '.join(instances)}{hint}")
    others = {n: dict(v) for n, v in options.overrides.items()}
    plant, controller = others.pop("plant", {}), others.pop("controller", {})
    scene: Any = scenario.scene
    robot: Any = scenario.robot
    if not scenario.is_system and "plant" not in scenario.fmus:
        scene, robot = plant.pop("scene", scene), plant.pop("robot", robot)
    merged = {n: _merged(scenario.parameters.get(n, {}), v) for n, v in others.items()}
    return replace(
        scenario,
        scene=scene,
        robot=robot,
        coupling=options.coupling or scenario.coupling,
        plant=_merged(scenario.plant, plant),
        controller=_merged(scenario.controller, controller),
        parameters={**scenario.parameters, **merged},
    )


def _from_here(text: str) -> str:
    """A part named on the command line, relative to the working directory."""
    file, colon, name = text.rpartition(":")
    has_class = colon and file.endswith(".py")
    return f"{os.path.realpath(file)}:{name}" if has_class else os.path.realpath(text)


def _merged(section: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Merge both; an override of `kp` replaces the section's `kp[3]`, too."""
    kept = {k: v for k, v in section.items() if k.partition("[")[0] not in overrides}
    return kept | dict(overrides)


# Values by key.


def _is_setting(key: str) -> bool:
    """Return whether a key belongs to the scenario, not to an FMU."""
    return key in TOP or key.startswith(_SECTIONS)


def split_settings(assignments: Sequence[str]) -> tuple[dict[str, ParameterValue], list[str]]:
    """Split the texts of `--set` into the scenario's settings and those of the FMUs."""
    settings: dict[str, ParameterValue] = {}
    others = []
    for text in assignments:
        key, equals, value = (part.strip() for part in text.partition("="))
        if equals and value and _is_setting(key):
            settings[key] = literal(value, f"--set {text!r}: ")
        else:
            others.append(text)
    return settings, others


def with_values(scenario: Scenario, values: Mapping[str, ParameterValue]) -> Scenario:
    """Return a scenario with some values changed."""
    try:
        return _with_all(scenario, values)
    except InputError as error:
        raise InputError(_blamed(scenario, values, str(error))) from None


def _blamed(scenario: Scenario, values: Mapping[str, ParameterValue], text: str) -> str:
    """Return an error with the key before it without which there would be none."""
    for key in values:
        with suppress(InputError):
            _with_all(scenario, {k: v for k, v in values.items() if k != key})
            own = key.rpartition(".")[2]  # which most messages begin with
            return text if text.startswith(key) else f"{key}: {text.removeprefix(f'{own}: ')}"
    return text


def _with_all(scenario: Scenario, values: Mapping[str, ParameterValue]) -> Scenario:
    """Change all values at once, so that no order of the keys is seen."""
    changes: dict[Steps, Any] = {}
    inputs: dict[str, ParameterValue] = {}
    parameters: dict[str, dict[str, ParameterValue]] = {}
    for key, value in values.items():
        instance, dot, name = key.partition(".")
        if instance == "inputs":
            inputs[name] = value
        elif _is_setting(key):
            changes[_steps(key)] = value
        elif dot:
            parameters.setdefault(instance, {})[name] = value
        else:
            raise _no_such(key)
    if "gains" in values and "controller" in scenario.fmus:
        raise InputError("gains: acts only on the project's own controller; must be left out here")
    if scenario.is_system and any(steps[0] == "table" for steps in changes):
        raise InputError(f"the scenario is a system, which has no {TABLE_FILE}")
    changed: Scenario = _changed(scenario, changes)
    if inputs:
        changed = replace(changed, inputs=_merged(changed.inputs, inputs))
    if "file" in inputs:
        file = (scenario.folder or Path()) / str(inputs["file"])
        changed = replace(changed, input_table=InputTable.read(file))
    return with_options(changed, Options(parameters)) if parameters else changed


def _no_such(key: str) -> InputError:
    valid = (*TOP, "mismatch.preset", "table.rows[1].x", "push[1].force[1]", "success.max_slip",
             "inputs.plant.torque", "plant.block_mass")  # fmt: skip
    return InputError(f"no such key; valid: {', '.join(valid)}{did_you_mean(key, valid)}")


def _steps(key: str) -> Steps:
    steps: list[str | int] = []
    for part in key.split("."):
        match = _STEP.fullmatch(part)
        if match is None:
            raise _no_such(key)
        is_column = steps[:1] == ["table"] and part in _COLUMNS
        steps += _COLUMNS[part] if is_column else [match[1]]
        steps += [int(match[2]) - 1] if match[2] else []
    return tuple(steps)


def _changed(old: Any, changes: Mapping[Steps, Any], name: str = "") -> Any:
    """Return a dataclass or tuple with the values at some places changed, wholes before items."""
    old = changes.get((), old)
    parts: dict[Any, dict[Steps, Any]] = {}
    for steps, value in changes.items():
        if steps:
            parts.setdefault(steps[0], {})[steps[1:]] = value
    if not parts:
        return old
    if is_dataclass(old):
        check_keys("", list(map(str, parts)), field_names(old))
        if isinstance(old, Mismatch):  # items are those of what preset and wholes result in
            old = replace(old, **{n: _whole(n, c.pop(())) for n, c in parts.items() if () in c})
        new = {n: _changed(_field(old, n), c, n) for n, c in parts.items() if c}
        return replace(old, **new)
    items = list(old) if isinstance(old, tuple | list) else []
    for index, inner in parts.items():
        if index not in range(len(items)):
            bound = f"must be 1 to {len(items)}" if items else "the scenario has none"
            number = index + 1 if isinstance(index, int) else index
            raise InputError(f"there is no {name.removesuffix('s')} {number}; {bound}")
        items[index] = _changed(items[index], inner, name)
    return tuple(items)


def _field(old: Any, name: str) -> Any:
    if isinstance(old, Mismatch) and name not in ("preset", "seed"):
        return old.values.get(name, default_of(name))
    return getattr(old, name)


def _whole(name: str | int, value: Any) -> Any:
    """Return the integer part of a seed, so that seeds can be drawn from an interval."""
    is_number = isinstance(value, float) and math.isfinite(value)
    return int(value) if name == "seed" and is_number else value
