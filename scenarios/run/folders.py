"""The folder of a run: its default name, and what it may hold before the run."""

from __future__ import annotations

import itertools
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ...fmus.atomic import TEMPORARY
from ...fmus.errors import InputError
from ..files import safe_name
from ..recording import Recording
from ..recording.storage import PARQUET_FILE, PARTIAL_FILE, STREAM_FILE, is_being_written

RUNS = Path("runs")
SUMMARY_FILE = "summary.json"
SCENARIO_FOLDER = "scenario"
# Files that a run writes before it ends.
_LEFT = {STREAM_FILE, PARQUET_FILE, PARTIAL_FILE, SUMMARY_FILE, SCENARIO_FOLDER}


@contextmanager
def claimed_folder(out: str | Path | None, name: str, *, retry: bool = False) -> Iterator[Path]:
    """Yield the folder of a run."""
    if out is not None:
        folder = Path(out)
        if retry:
            clear_unfinished(folder)
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
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            continue
        except OSError as error:
            raise InputError(f"{folder}: cannot be written to: {error.strerror}") from error
    raise AssertionError("unreachable")


def refuse_existing(folder: Path) -> None:
    """Refuse a folder that is not empty (nothing is overwritten) or cannot be made."""
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder}: already exists; must be a new or an empty folder")
        there = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
        if not there.is_dir():
            raise InputError(f"{folder}: cannot be written to: {there} is not a folder")
        if not os.access(there, os.W_OK):
            raise InputError(f"{folder}: cannot be written to: no write permission for {there}")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to: {error.strerror}") from error


def clear_unfinished(folder: Path) -> None:
    """Remove the files of a killed or failed run, so that it can be repeated."""
    names = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    if not names or not all(n in _LEFT or n.startswith(TEMPORARY) for n in names):
        return  # empty, or not a run's folder: `refuse_existing` decides
    if (folder / STREAM_FILE).exists() and is_being_written(folder / STREAM_FILE):
        raise InputError(f"{folder}: a run in progress is writing there; must be another folder")
    if SUMMARY_FILE in names and _is_complete(folder):
        raise InputError(f"{folder}: contains a complete run; must be a new or an empty folder")
    for name in names:
        if name == SCENARIO_FOLDER:
            shutil.rmtree(folder / name)
        else:
            (folder / name).unlink()


def _is_complete(folder: Path) -> bool:
    try:
        return Recording.open(folder).complete
    except InputError:  # none is there, or a damaged one
        return False
