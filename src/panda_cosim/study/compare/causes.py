"""What a run was made with: a red one names what has changed there before its signals.

That is its settings, parameters and versions, the bounds of its criteria, and of each MuJoCo model
the compiled fields that its author writes, by element: `plant: body ball mass`. What no field tells
is in a hash.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from ...fmus.build.engines import made_with
from ...fmus.build.identity import mujoco_version
from ...plant.parameters import PlantParameters
from ...result.judging.summary import Summary
from ...result.recording import Recording
from ...run.folder import model_in
from ...run.system.assembly import assemble
from ...task.scenario import Scenario
from ...task.tolerances import flattened, signal_of
from .differences import Row, differing
from .reference import TUBES
from .wording import unit_of

Elements = dict[str, float]  # by element, field and number; "hash": of all that is compiled
Look = Callable[[Any, str], dict[str, Any]]  # at a compiled model of an instance

TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
ENGINE: Final = "versions.mujoco"  # comes before models, which it compiles
ROUNDING: Final = 1e-9  # relative; less is rounding where another engine compiles a model
SHOWN: Final = 4  # causes in a line
GIVEN: Final = ("success.", "parameters.")  # begin the names of bounds and parameters
UNASKED: Final = "max_engine_warnings"  # is judged with the bound 0 also where none is stated
# The order in which they are named; FMUs last, as their hashes change with any of their files.
_PARTS: Final = ("parameters", "models", "", "versions", "fmus")


def elements(model: Any, _: str = "") -> Elements:
    """Return the fields of a compiled model (`mujoco.MjModel`) of some instance."""
    import mujoco  # noqa: PLC0415 - slow to import; needed where runs differ

    compiled = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, compiled)
    found: Elements = {"hash": float(int(hashlib.sha256(compiled.tobytes()).hexdigest()[:12], 16))}
    for option in TABLES["options"]:
        found |= _numbered(f"option {option}", getattr(model.opt, option))
    for kind, fields in TABLES["fields"].items():
        for number in range(getattr(model, TABLES["counts"][kind])):
            element = getattr(model, kind)(number)
            for field in fields:
                values = getattr(element, field, ())
                found |= _numbered(f"{kind} {element.name or number} {field}", values)
    return found


def _numbered(name: str, values: Any) -> Elements:
    """Return values by name, with numbers from 1 if there are several."""
    listed = np.ravel(values).astype(float).tolist()
    names = [f"{name}[{number}]" for number in range(1, len(listed) + 1)]
    return dict(zip([name] if len(listed) == 1 else names, listed, strict=True))


def models_of(scenario: Scenario, recording: Recording, look: Look = elements) -> dict[str, Any]:
    """Return what is seen in the models of a scenario's FMUs, by instance, with its MuJoCo."""
    from ...result.view.page import plant_parameters  # noqa: PLC0415 - as above

    fmus, own = assemble(scenario).system.fmus, None
    if not scenario.system and "plant" not in scenario.fmus:
        given = plant_parameters(recording.metadata)  # of which the block is a parameter
        own = PlantParameters(scene=given.scene, robot=given.robot)
    make = partial(_compiled, look, {name: model_in(fmu) for name, fmu in fmus.items()}, own)
    return dict(json.loads(made_with(scenario.mujoco or mujoco_version(), make)))


def _compiled(look: Look, contents: Mapping[str, bytes], own: PlantParameters | None) -> bytes:
    """Return what is seen in the models of FMUs, and of our own plant, as JSON."""
    from ...fmus.sources.model_fmu import load_binary  # noqa: PLC0415 - as above
    from ...plant.scene import load_scene  # noqa: PLC0415

    models = {name: load_binary(content, name) for name, content in contents.items() if content}
    models |= {"plant": load_scene(own)} if own else {}
    return json.dumps({name: look(model, name) for name, model in models.items()}).encode()


def changed_bounds(before: Summary, now: Summary) -> list[Row]:
    """Return the criteria whose bounds differ, or which only one of two runs is judged by."""
    stated = [[it for it in s.criteria if it.bound or it.name != UNASKED] for s in (before, now)]
    units = {it.name: it.unit for each in stated for it in each if it.unit != "1"}
    rows = differing([{it.name: it.bound for it in each} for each in stated])
    return [Row(f"success.{row.name}", row.values, units.get(row.name, "")) for row in rows]


def changed(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[Row]:
    """Return what two runs were made with differently, as it is to be named.

    `before` and `now` are tables of settings, with tables `parameters`, `models`, `versions` and
    `fmus`. A model's hash is told only where no field of it differs, nor the version of MuJoCo; of
    another version, rounding is left out.
    """
    rows = differing([dict(flattened(before)), dict(flattened(now))])
    engine = any(row.name == ENGINE for row in rows)
    rows = [row for row in rows if not (engine and _is_rounding(row))]
    split = {row.name: _split(row.name) for row in rows}
    models = {instance for part, instance, _ in split.values() if part == "models"}
    fields = {at for part, at, rest in split.values() if part == "models" and rest != "hash"}

    def is_cause(name: str) -> bool:
        part, instance, rest = split[name]
        if part == "fmus":
            return rest == "sha256" and instance not in models
        if part == "models" and rest == "hash":
            return not engine and instance not in fields
        return name not in ("scenario", TUBES)  # the scenario's name

    def rank(row: Row) -> float:
        return 0.5 if row.name == ENGINE else _PARTS.index(split[row.name][0])

    return sorted((row for row in rows if is_cause(row.name)), key=rank)


def _is_rounding(row: Row) -> bool:
    """Whether a model's field is as another engine rounds it, or is only in one of them."""
    is_model = row.name.startswith("models.")
    return is_model and (None in row.values or row.relative <= ROUNDING)


def _split(name: str) -> tuple[str, str, str]:
    """Return the part of a setting, or "", the instance, and what it is there."""
    part, _, rest = name.partition(".")
    if part not in _PARTS:
        part, rest = "", name
    instance, _, rest = rest.partition(".")
    return part, instance, rest


def named(rows: Sequence[Row], most: int = SHOWN) -> str:
    """Name changes in one line: `plant.block_mass 0.18 -> 0.21 kg, ...`."""
    first = {signal_of(row.name): row for row in reversed(rows)}  # of each field's numbers
    words = list(_words([row for row in rows if first[signal_of(row.name)] is row]))
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(words[:most]) + more


def _words(rows: Sequence[Row]) -> Iterator[str]:
    for row in rows:
        part, instance, rest = _split(row.name)
        name = f"{instance}.{rest}".rstrip(".")
        unit = row.unit or unit_of(name)
        if part == "models":
            field = signal_of(rest).rpartition(" ")[2]
            name, unit = f"{instance}: {rest}", TABLES["units"].get(field, "")
        if part == "models" and rest == "hash":
            yield f"{instance}: other fields of its compiled model"
        elif part == "fmus":
            yield f"the code or files of FMU {instance!r}"
        elif None in row.values:
            yield f"{name} {' -> '.join(row.cells[1:])}"
        else:
            yield f"{replace(row, name=name)} {unit}".rstrip()
