"""Runs a row of a sweep again: to show it in 3D beside the unvaried scenario, or as a scenario."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from ...fmus.atomic import cache_folder, temporary_folder
from ...fmus.errors import InputError
from ...result.judging.summary import SUMMARY_FILE
from ...result.view.page import VIEW_FILE, shown_run, write_view
from ...run.execution import run_scenario
from ...run.folder import SCENARIO_FOLDER, refuse_existing
from ...task.scenario import Scenario
from ..compare.causes import models_of
from ..compare.reference import REFERENCE_FILE, Reference
from .store import Store


def scenario_of(store: Store, index: int) -> tuple[int, Scenario, Scenario]:
    """Return which scenario a row is of, and that scenario as swept, unvaried and varied."""
    content = store.content
    row = store.row(index)
    number = list(content.nominal).index(row["scenario"])
    nominal = store.kept(number)
    return number, nominal, nominal.changed({key: row[key] for key in content.keys})


def show_row(folder: str | Path, index: int) -> Path:
    """Run a row of a sweep and its unvaried scenario, unless done before, for a 3D view."""
    store = Store(folder)
    number, nominal, changed = scenario_of(store, index)
    place = store.folder / "shown"
    row_folder = store.run_folder(index)
    if not (row_folder / SUMMARY_FILE).exists():
        row_folder = _run(changed, place / f"{index:07d}")
    row = shown_run(row_folder, name=f"row {index}")
    nominal_folder = _run(nominal, place / f"nominal-{number}")
    unvaried = shown_run(nominal_folder, name=f"{nominal.name} unvaried")
    return write_view([row, unvaried], place / f"{index:07d}" / VIEW_FILE)


def _run(scenario: Scenario, folder: Path) -> Path:
    if not (folder / SUMMARY_FILE).exists():
        shutil.rmtree(folder, ignore_errors=True)  # leftovers of a killed call
        run_scenario(scenario, folder)
    return folder


def promote_row(
    folder: str | Path, index: int, new: str | Path, *, known_limit: bool = False
) -> list[Path]:
    """Make a scenario of a row in a new folder; return its files."""
    # A row with success gets a reference. One without fails in `regress`, by its criteria, until it
    # is mended; a known limit expects the failure instead, and has a reference of it.
    store, new = Store(folder), Path(new)
    _, _, changed = scenario_of(store, index)
    refuse_existing(new)
    row = store.row(index)
    if row["status"] == "unmeasured":
        raise InputError(f"row {index}: {row['error']}; must have a verdict")
    purpose = f"Row {index} of a sweep of {row['scenario']}"
    promoted = replace(changed, name=new.resolve().name, purpose=purpose)
    if known_limit:
        if row["status"] != "missed":
            place = f"--expect failure: row {index}: status {row['status']}"
            raise InputError(f"{place}; must be missed")
        reason = f"found by a sweep: {row['missed']} is missed"
        promoted = replace(promoted, expect="failure", expect_reason=reason)
    with temporary_folder(cache_folder()) as scratch:
        run = run_scenario(promoted, scratch / "run")
        # With the files of its own FMUs.
        shutil.copytree(run.folder / SCENARIO_FOLDER, new, dirs_exist_ok=True)
        if run.summary.as_expected:
            models = models_of(promoted, run.recording)
            reference = Reference.of(run.recording, run.summary, promoted.regression, models)
            reference.write(new / REFERENCE_FILE, run.recording)
    return sorted(new.iterdir())
