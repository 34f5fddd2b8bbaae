"""Packs a scenario with its own FMUs, as workers share no folder with the sender."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from ...fmus.atomic import cache_folder, temporary_folder
from ...fmus.errors import InputError
from ..definition.scenario import Scenario, load_scenario
from ..definition.writer import settings_text, table_text
from ..running.assembly import assemble
from ..running.fmu_files import with_files
from .definition import Loaded


def pack(loaded: Loaded) -> Loaded:
    """Read the files of a scenario's own FMUs; models are sent as the FMUs built from them.

    A law is sent as Python files: its FMU names the local Python, so each worker builds it.

    Raises:
        InputError: One cannot be used.
    """
    if not loaded.scenario.has_own_parts:
        return loaded
    assembly = assemble(loaded.scenario)
    with temporary_folder(cache_folder()) as folder:
        scenario = with_files(loaded.scenario, assembly, folder)
        files = {path.name: path.read_bytes() for path in folder.iterdir()}
    return replace(loaded, scenario=replace(scenario, folder=None), files=files)


def unpack(loaded: Loaded, folder: Path) -> Scenario:
    """Write the files of a scenario's FMUs into a folder; return the scenario with its paths."""
    if not loaded.files:
        return loaded.scenario
    folder.mkdir()
    for name, content in loaded.files.items():
        (folder / name).write_bytes(content)
    return replace(loaded.scenario, folder=folder)


def identity(packed: Loaded) -> str:
    """Return the SHA-256 of all that a packed scenario consists of, but its name."""
    content = hashlib.sha256(settings_text(packed.scenario).encode())
    content.update(table_text(packed.scenario.table).encode())
    for name, data in sorted(packed.files.items()):
        content.update(f"{name} {len(data)} ".encode() + data)
    return content.hexdigest()


def remark_if_changed(name: str, swept: str, kept: Path) -> str:
    """Say that a scenario is no longer as it was swept; "" if it is.

    Args:
        name: A shipped name, or an absolute folder.
        swept: Its `identity` then.
        kept: Where the sweep keeps what it was.
    """
    try:
        what = (
            "" if identity(pack(Loaded(name, "", load_scenario(name)))) == swept else "has changed"
        )
    except InputError:
        what = "cannot be used any more"
    return what and f"scenario {name}: {what} since the sweep began, which goes by {kept}"


__all__ = ["identity", "pack", "remark_if_changed", "unpack"]
