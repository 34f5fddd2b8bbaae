"""The scenarios of a sweep, packed with the files of their own FMUs, as workers share no folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ...fmus.atomic import cache_folder, temporary_folder
from ...fmus.build.identity import digest
from ...fmus.errors import InputError
from ...run.folder import with_files, write_files
from ...run.system.assembly import assemble
from ...task.scenario import Scenario, load_scenario, shipped_scenarios
from ...task.writer import settings_text
from .definition import Sweep


@dataclass(frozen=True)
class Loaded:
    """A scenario of a sweep."""

    name: str  # as `panda-cosim run` takes it: a shipped name or an absolute folder
    label: str  # its name or, where two share it, the shortest end of its path that is its own
    scenario: Scenario
    files: Mapping[str, bytes] = field(default_factory=dict)  # of its own FMUs, if it is packed


def load_scenarios(sweep: Sweep, kept: Sequence[Path] = ()) -> tuple[Loaded, ...]:
    """Load a sweep's scenarios, from the folders that keep them as swept if there are any."""
    names = scenario_names(sweep.scenario)
    shipped = shipped_scenarios()
    folders = [shipped.get(name, Path(name)).resolve() for name in names]
    if twice := [folder for folder in folders if folders.count(folder) > 1]:
        raise InputError(f"scenario: {twice[0]} is named twice; folders must differ")
    places: Sequence[Path | str] = kept or names
    return tuple(
        Loaded(name, _label(folder, folders), load_scenario(place))
        for name, folder, place in zip(names, folders, places, strict=True)
    )


def scenario_names(given: Sequence[str]) -> list[str]:
    """Return scenarios as `run` takes them anywhere: shipped names, and absolute folders."""
    shipped = shipped_scenarios()
    return [name if name in shipped else str(Path(name).resolve()) for name in given]


def _label(folder: Path, folders: Sequence[Path]) -> str:
    """Return the shortest end of a path that no other of the paths has."""
    ends = (folder.parts[-n:] for n in range(1, len(folder.parts) + 1))
    own = (e for e in ends if sum(other.parts[-len(e) :] == e for other in folders) == 1)
    return str(Path(*next(own)))


def pack(loaded: Loaded) -> Loaded:
    """Read the files of a scenario's own FMUs; models are sent as the FMUs built from them."""
    # A law is sent as Python files: its FMU names the local Python, so each worker builds it.
    if not loaded.scenario.has_own_parts:
        return loaded
    with temporary_folder(cache_folder()) as folder:
        scenario = with_files(loaded.scenario, assemble(loaded.scenario), folder)
        return replace(loaded, scenario=replace(scenario, folder=None), files=read_files(folder))


def unpack(loaded: Loaded, folder: Path) -> Loaded:
    """Write the files of a scenario's FMUs into a folder, where the scenario looks for them."""
    if not loaded.files:
        return loaded
    write_files(folder, loaded.files)
    return replace(loaded, scenario=replace(loaded.scenario, folder=folder), files={})


def identity(packed: Loaded) -> str:
    """Return the SHA-256 of all that a packed scenario consists of, but its name."""
    scenario = packed.scenario
    tables = (table.text for table in (scenario.table, scenario.input_table) if table is not None)
    return digest(settings_text(scenario), *tables, packed.files)


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the contents of all files in a folder, at any depth, by path."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
