"""Packs a scenario with its own FMUs, as workers share no folder with the sender."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from ...fmus.packaging.build import build
from ...fmus.packaging.cache import cache_folder
from ...fmus.packaging.scratch import SWEEP, scratch_folder
from ..definition.scenario import Scenario
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
    with scratch_folder(cache_folder(), SWEEP) as folder:
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


def digests(scenarios: tuple[Loaded, ...]) -> dict[str, str]:
    """Return the SHA-256 of each FMU of a sweep: the project's own, then those of the scenarios."""
    found = dict(build())
    for each in scenarios:
        if each.scenario.has_own_parts or each.scenario.mismatch.has_sensors:
            system = assemble(each.scenario).system
            found |= {f"{each.scenario.name}.{name}": path for name, path in system.fmus.items()}
    return {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in found.items()}


__all__ = ["digests", "pack", "unpack"]
