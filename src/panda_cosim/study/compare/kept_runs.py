"""The runs beside a suite's report, those that differ, in its folder `runs`.

`made-by-regress.json` lists their files: only these are replaced, as everything else there belongs
to the user.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

from ...fmus.atomic import write_whole
from ...fmus.errors import InputError
from .regress import Outcome

MANIFEST_FILE: Final = "made-by-regress.json"


def check_kept_runs(folder: Path, names: Iterable[str]) -> None:
    """Check that no run would replace something that `regress` did not put there."""
    own = {Path(file).parts[0] for file in _kept_files(folder)}
    for place in (folder / name for name in names):
        is_free = not place.exists() or (place.is_dir() and not any(place.iterdir()))
        if not (is_free or place.name in own):
            raise InputError(
                f"{place}: was not made by regress, so it stays; move it, or choose "
                "another folder with --report"
            )


def replace_kept_runs(folder: Path, outcomes: Iterable[Outcome]) -> None:
    """Remove the previous report's runs, and move those that differ now, on the same disk, here."""
    for name in (*_kept_files(folder), MANIFEST_FILE):
        (folder / name).unlink(missing_ok=True)
        with suppress(OSError):  # it holds something else
            for parent in Path(name).parents:
                (folder / parent).rmdir()
    runs = [outcome.run for outcome in outcomes if not outcome.ok]
    files = [(run, file) for run in runs for file in run.rglob("*") if file.is_file()]
    moves = {file: Path(run.name, file.relative_to(run)) for run, file in files}
    if moves:
        listed = [place.as_posix() for place in moves.values()]
        write_whole(folder / MANIFEST_FILE, json.dumps(listed, indent=1))
    for file, place in moves.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        file.replace(folder / place)


def _kept_files(folder: Path) -> list[str]:
    manifest = folder / MANIFEST_FILE
    return json.loads(manifest.read_bytes()) if manifest.is_file() else []
