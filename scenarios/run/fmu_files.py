"""The files of a scenario's own FMUs: read for a run, and kept in its folder."""

from __future__ import annotations

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

from ...fmus.master.system import System
from ..files import MODEL_FILE
from ..scenario.scenario import Scenario
from ..scenario.writer import write_scenario
from ..system.assembly import Assembly
from ..system.parts import part_path


def with_files(scenario: Scenario, assembly: Assembly, folder: Path) -> Scenario:
    """Put the files of a scenario's FMUs into a folder; models as the FMUs built from them."""
    folder.mkdir(parents=True, exist_ok=True)
    system = assembly.system
    if scenario.system:
        path, _ = part_path(scenario, scenario.system)
        shutil.copy2(path, folder / path.name)
        _keep_model(system, folder / MODEL_FILE)
        return replace(scenario, system=path.name)
    named = {}
    for part in assembly.parts:
        if part.name not in scenario.fmus:
            continue
        path, class_name = part_path(scenario, scenario.fmus[part.name])
        if path.suffix == ".py":
            from ...fmus.sources.law import law_code  # noqa: PLC0415 - few have one

            for name, content in law_code(path).items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(content)
            named[part.name] = f"{path.name}:{class_name}"
        else:
            made = system.fmus[part.name]
            target = path.name if path.suffix == ".fmu" else f"{path.stem}.fmu"
            if target in named.values():
                target = f"{part.name}_{target}"
            shutil.copy2(made, folder / target)
            named[part.name] = target
    if "plant" in named:
        _keep_model(system, folder / MODEL_FILE)
    return replace(scenario, fmus={name: named[name] for name in scenario.fmus})


def keep_scenario(scenario: Scenario, assembly: Assembly, folder: Path) -> None:
    """Write the scenario with the files of its FMUs, so that it can be run again."""
    if scenario.has_own_parts:
        scenario = with_files(scenario, assembly, folder)
    write_scenario(scenario, folder)


def _keep_model(system: System, path: Path) -> None:
    """Keep the MuJoCo model of the plant's FMU, if it has one, for pictures."""
    if "plant" not in system.fmus:
        return
    with zipfile.ZipFile(system.fmus["plant"]) as archive:
        models = [name for name in archive.namelist() if name.endswith(".mjb")]
        if len(models) == 1:
            path.write_bytes(archive.read(models[0]))
