"""The folder of a run: who gets it, and the scenario kept in it."""

from __future__ import annotations

import itertools
import shutil
import time
import zipfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from ..fmus.atomic import write_whole, writing
from ..fmus.errors import InputError
from ..task.files import MODEL_FILE, safe_name
from ..task.scenario import Scenario
from ..task.writer import write_scenario
from .system.assembly import Assembly, assemble
from .system.parts import Part, part_path

RUNS = Path("runs")
SCENARIO_FOLDER = "scenario"


@contextmanager
def claimed_folder(
    out: str | Path | None, name: str, *, is_another: bool = False
) -> Iterator[Path]:
    """Yield the folder of a run; a new one that nothing was written to goes again."""
    if out is not None and not is_another:
        refuse_existing(Path(out))
        yield Path(out)
        return
    folder = default_folder(name) if out is None else new_folder(Path(out))
    try:
        yield folder
    finally:
        with suppress(OSError):  # it holds the run
            folder.rmdir()


def default_folder(name: str) -> Path:
    """Make a new folder for a run of a scenario."""
    return new_folder(RUNS / f"{safe_name(name)}-{time.strftime('%Y%m%d-%H%M%S')}")


def new_folder(path: Path) -> Path:
    """Make a folder of this name; where there is one, with a number behind it."""
    folder, numbers = path, itertools.count(2)
    while True:
        with writing(folder), suppress(FileExistsError):
            folder.mkdir(parents=True)
            return folder
        folder = path.with_name(f"{path.name}-{next(numbers)}")


def refuse_existing(folder: Path) -> None:
    """Refuse a folder that is not empty; nothing is overwritten."""
    with writing(folder):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder}: already exists; must be a new or an empty folder")


# The scenario, with the files of its own FMUs.


def keep_scenario(scenario: Scenario, assembly: Assembly, folder: Path) -> None:
    """Write the scenario with the files of its FMUs and client, so that it can be run again."""
    if scenario.has_own_parts:
        scenario = with_files(scenario, assembly, folder)
    write_scenario(scenario, folder)


def with_files(scenario: Scenario, assembly: Assembly, folder: Path) -> Scenario:
    """Put the files of FMUs and client into a folder; models as the FMUs built from them."""
    folder.mkdir(parents=True, exist_ok=True)
    write_files(folder, _client_files(scenario))
    if model := _drawn(scenario, assembly):
        write_files(folder, {MODEL_FILE: model})
    if scenario.system:
        path, _ = part_path(scenario, scenario.system)
        shutil.copy2(path, folder / path.name)
        return replace(scenario, system=path.name)
    parts = {part.name: part for part in assembly.parts}
    kept: dict[str, str] = {}
    for name, text in scenario.fmus.items():
        is_ours = parts[name].own
        kept[name] = text if is_ours else _keep(scenario, parts[name], folder, kept.values())
    still = any(part.is_model and part.name not in kept for part in assembly.parts)
    return replace(scenario, fmus=kept, mujoco=scenario.mujoco if still else "")


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, by path."""
    for name, content in files.items():
        write_whole(folder / name, content)


def _drawn(scenario: Scenario, assembly: Assembly) -> bytes:
    """Return the plant's model, for pictures, unless it is ours."""
    if not scenario.system and "plant" not in scenario.fmus:
        return b""
    # The installed MuJoCo, which draws, has to read it.
    here = assemble(replace(scenario, mujoco="")) if scenario.mujoco else assembly
    plant = here.system.fmus.get("plant")
    return model_in(plant) if plant else b""


def _keep(scenario: Scenario, part: Part, folder: Path, taken: Collection[str]) -> str:
    """Put the file of a part into a folder, and return what [fmus] says of it there."""
    path, class_name = part_path(scenario, scenario.fmus[part.name])
    if path.suffix == ".py":
        from ..fmus.sources.law import law_code  # noqa: PLC0415 - few have one

        write_files(folder, law_code(path))
        return f"{path.name}:{class_name}"
    file = f"{path.stem}.fmu"
    kept = f"{part.name}_{file}" if file in taken else file
    shutil.copy2(part.make(), folder / kept)
    return kept


def _client_files(scenario: Scenario) -> dict[str, bytes]:
    """Return the files that a client names, and the modules beside them that they import."""
    files: dict[str, bytes] = {}
    own = scenario.folder or Path()
    for path in map(Path, scenario.client.command) if scenario.client else ():
        if path.is_absolute() or ".." in path.parts or not (own / path).is_file():
            continue
        code = {path.name: (own / path).read_bytes()}
        if path.suffix == ".py":
            from ..fmus.sources.python_fmu import code_of  # noqa: PLC0415 - few have a client

            code = code_of(own / path, (own / path).parent)
        files |= {str(path.parent / name): content for name, content in code.items()}
    return files


def model_in(fmu: Path) -> bytes:
    """Return the MuJoCo model in an FMU; nothing, unless it has one."""
    with zipfile.ZipFile(fmu) as archive:
        models = [name for name in archive.namelist() if name.endswith(".mjb")]
        return archive.read(models[0]) if len(models) == 1 else b""
