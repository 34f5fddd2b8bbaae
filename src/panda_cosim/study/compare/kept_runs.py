"""The runs beside a suite's report, those that differ, in its folder `runs`.

`made-by-regress.json` lists their files: only these are replaced, as everything else there belongs
to the user.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

from ...fmus.atomic import write_whole
from ...fmus.errors import InputError
from .outcome import Outcome

MANIFEST_FILE: Final = "made-by-regress.json"


def check_kept_runs(folder: Path, names: Iterable[str]) -> None:
    """Check that no run would replace something that `regress` did not put there."""
    own = [folder / file for file in _kept_files(folder)]
    for place in (folder / name for name in names):
        is_own = any(file.is_relative_to(place) for file in own)
        if any(place.glob("*")) and not is_own:
            advice = "move it, or choose another folder with --report"
            raise InputError(f"{place}: was not made by regress, so it stays; {advice}")


def replace_kept_runs(folder: Path, outcomes: Iterable[Outcome]) -> None:
    """Remove the previous report's runs, and move those that differ now, on the same disk, here."""
    for name in (*_kept_files(folder), MANIFEST_FILE):
        (folder / name).unlink(missing_ok=True)
        with suppress(OSError):  # it holds something else
            os.removedirs((folder / name).parent)
    moves = {
        file: Path(outcome.name, file.relative_to(outcome.run)).as_posix()
        for outcome in outcomes if not outcome.ok
        for file in outcome.run.rglob("*") if file.is_file()
    }  # fmt: skip
    if moves:
        write_whole(folder / MANIFEST_FILE, json.dumps([*moves.values()], indent=1))
    for file, place in moves.items():
        os.renames(file, folder / place)


def _kept_files(folder: Path) -> list[str]:
    manifest = folder / MANIFEST_FILE
    return json.loads(manifest.read_bytes()) if manifest.is_file() else []
