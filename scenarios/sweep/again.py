"""Runs a row of a sweep again: to show it in 3D beside the unvaried scenario, or as a scenario."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...fmus.atomic import cache_folder, replacing, temporary_folder
from ...fmus.errors import InputError
from ..compare.reference import REFERENCE_FILE, Reference
from ..run.folder import SCENARIO_FOLDER, SUMMARY_FILE, refuse_existing
from ..run.options import with_values
from ..run.run import run_scenario
from ..scenario.scenario import Scenario, load_scenario
from ..view.export import VIEW_FILE, shown_run, write_view
from .store import Store


def scenario_of(store: Store, index: int) -> tuple[int, Scenario, Scenario]:
    """Return which scenario a row is of, and that scenario as swept, unvaried and varied."""
    content = store.content
    row = store.row(index)
    number = list(content["nominal"]).index(row["scenario"])
    name = list(content["origin"]["scenarios"])[number]
    nominal = load_scenario(store.kept_scenario(number, name))
    return number, nominal, with_values(nominal, {key: row[key] for key in content["keys"]})


def show_row(folder: str | Path, index: int) -> Path:
    """Run a row of a sweep's folder and its unvaried scenario, unless done before, for a 3D view.

    The page is `shown/INDEX/view.html` in the sweep's folder. A row that failed in the sweep fails
    again; its recording is kept.
    """
    store = Store(folder)
    number, nominal, changed = scenario_of(store, index)
    place = store.folder / "shown"
    row_folder = store.run_folder(index)
    if not (row_folder / SUMMARY_FILE).exists():
        row_folder = _run(changed, place / f"{index:07d}")
    nominal_folder = _run(nominal, place / f"nominal-{number}")
    runs = [
        shown_run(row_folder, name=f"row {index}"),
        shown_run(nominal_folder, name=f"{nominal.name} unvaried"),
    ]
    return write_view(runs, place / f"{index:07d}" / VIEW_FILE)


def _run(scenario: Scenario, folder: Path) -> Path:
    if not (folder / SUMMARY_FILE).exists():
        shutil.rmtree(folder, ignore_errors=True)  # leftovers of a killed call
        run_scenario(scenario, folder)
    return folder


def promote_row(
    folder: str | Path, index: int, new: str | Path, *, known_limit: bool = False
) -> list[Path]:
    """Make a scenario of a row in a new folder; return its files.

    A row with success gets a reference. One without fails in `regress`, by its criteria, until it
    is mended; a known limit expects the failure instead, and has a reference of it.
    """
    store, new = Store(folder), Path(new)
    _, _, changed = scenario_of(store, index)
    refuse_existing(new)
    row = store.row(index)
    promoted = replace(changed, **_keys(row, known_limit), name=new.resolve().name)
    with temporary_folder(cache_folder()) as scratch:
        run = run_scenario(promoted, scratch / "run")
        kept = run.folder / SCENARIO_FOLDER  # with the files of its own FMUs
        shutil.copytree(kept, new, dirs_exist_ok=True)
        if run.summary.as_expected:
            reference = Reference.of(run.recording, run.summary.to_dict(), promoted.regression)
            with replacing(new / REFERENCE_FILE) as path:
                reference.write(path)
    return sorted(new.iterdir())


def _keys(row: Mapping[str, Any], known_limit: bool) -> dict[str, Any]:
    """Return the key `purpose` and, for a known limit, those that expect the failure."""
    index, status = row["index"], row["status"]
    if status == "unmeasured":
        raise InputError(f"row {index}: {row['error']}; must have a verdict")
    keys: dict[str, Any] = {"purpose": f"Row {index} of a sweep of {row['scenario']}"}
    if known_limit:
        if status != "missed":
            raise InputError(f"--expect failure: row {index}: status {status}; must be missed")
        reason = f"found by a sweep: {row['missed']} is missed"
        keys |= {"expect": "failure", "expect_reason": reason}
    return keys
