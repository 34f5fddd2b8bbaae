"""The folder of a run: who gets it, and the scenario kept in it."""

from __future__ import annotations

import itertools
import os
import shutil
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from ..fmus.atomic import writing
from ..fmus.errors import InputError
from ..task.files import MODEL_FILE, safe_name
from ..task.scenario import Scenario
from ..task.writer import write_scenario
from .system.assembly import Assembly, assemble
from .system.parts import WORDS, part_path

RUNS = Path("runs")
SCENARIO_FOLDER = "scenario"


@contextmanager
def claimed_folder(out: str | Path | None, name: str) -> Iterator[Path]:
    """Yield the folder of a run."""
    if out is not None:
        folder = Path(out)
        refuse_existing(folder)
        yield folder
        return
    folder = default_folder(name)
    try:
        yield folder
    finally:
        with suppress(OSError):  # it holds the run
            folder.rmdir()


def default_folder(name: str) -> Path:
    """Make a new folder for a run of a scenario."""
    stem = f"{safe_name(name)}-{time.strftime('%Y%m%d-%H%M%S')}"
    for count in itertools.count(1):
        folder = RUNS / (stem if count == 1 else f"{stem}-{count}")
        with writing(folder), suppress(FileExistsError):
            folder.mkdir(parents=True)
            return folder
    raise AssertionError("unreachable")


def refuse_existing(folder: Path) -> None:
    """Refuse a folder that is not empty (nothing is overwritten) or cannot be made."""
    with writing(folder):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder}: already exists; must be a new or an empty folder")
        there = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
        if not there.is_dir():
            raise InputError(f"{folder}: cannot be written to: {there} is not a folder")
        if not os.access(there, os.W_OK):
            raise InputError(f"{folder}: cannot be written to: no write permission for {there}")


# The scenario, with the files of its own FMUs.


def keep_scenario(scenario: Scenario, assembly: Assembly, folder: Path) -> None:
    """Write the scenario with the files of its FMUs and client, so that it can be run again."""
    if scenario.has_own_parts:
        scenario = with_files(scenario, assembly, folder)
    write_scenario(scenario, folder)


def with_files(scenario: Scenario, assembly: Assembly, folder: Path) -> Scenario:
    """Put the files of FMUs and client into a folder; models as the FMUs built from them."""
    folder.mkdir(parents=True, exist_ok=True)
    for path, content in _client_files(scenario).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    files = assembly.system.fmus
    if scenario.system or "plant" in scenario.fmus:
        # The installed MuJoCo, which draws, has to read the model.
        drawn = assemble(replace(scenario, mujoco="")) if scenario.mujoco else assembly
        plant = drawn.system.fmus.get("plant")
        if plant and (model := model_in(plant)):  # for pictures
            (folder / MODEL_FILE).write_bytes(model)
    if scenario.system:
        path, _ = part_path(scenario, scenario.system)
        shutil.copy2(path, folder / path.name)
        return replace(scenario, system=path.name)
    kept: dict[str, str] = {}
    for name, text in scenario.fmus.items():
        if text in WORDS:
            kept[name] = text
            continue
        path, class_name = part_path(scenario, text)
        if path.suffix == ".py":
            from ..fmus.sources.law import law_code  # noqa: PLC0415 - few have one

            for file, content in law_code(path).items():
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                (folder / file).write_bytes(content)
            kept[name] = f"{path.name}:{class_name}"
        else:
            file = f"{path.stem}.fmu"
            kept[name] = f"{name}_{file}" if file in kept.values() else file
            shutil.copy2(files[name], folder / kept[name])
    still = any(part.is_model and part.name not in kept for part in assembly.parts)
    return replace(scenario, fmus=kept, mujoco=scenario.mujoco if still else "")


def _client_files(scenario: Scenario) -> dict[Path, bytes]:
    """Return the files that a client names, and the modules beside them that they import."""
    files: dict[Path, bytes] = {}
    own = scenario.folder or Path()
    for path in map(Path, scenario.client.command) if scenario.client else ():
        if path.is_absolute() or ".." in path.parts or not (own / path).is_file():
            continue
        code = {path.name: (own / path).read_bytes()}
        if path.suffix == ".py":
            from ..fmus.sources.python_fmu import code_of  # noqa: PLC0415 - few have a client

            code = code_of(own / path, (own / path).parent, is_packed=False)
        files |= {path.parent / name: content for name, content in code.items()}
    return files


def model_in(fmu: Path) -> bytes:
    """Return the MuJoCo model in an FMU; nothing, unless it has one."""
    with zipfile.ZipFile(fmu) as archive:
        models = [name for name in archive.namelist() if name.endswith(".mjb")]
        return archive.read(models[0]) if len(models) == 1 else b""
