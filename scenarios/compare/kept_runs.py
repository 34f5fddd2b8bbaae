"""The kept runs of a report, in `DIR/runs`: `regress` replaces only files that it put there.

`made-by-regress.json` lists them. Everything else in `DIR/runs` belongs to the user and is neither
removed nor overwritten.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

from ...fmus.atomic import replacing
from ...fmus.errors import InputError

MANIFEST_FILE: Final = "made-by-regress.json"


def check_kept_runs(folder: Path, names: Iterable[str]) -> None:
    """Check that no run would replace something that `regress` did not put there."""
    made = {file.relative_to(folder).parts[0] for file in _made(folder)}
    for place in (folder / name for name in names):
        is_free = not place.exists() or (place.is_dir() and not any(place.iterdir()))
        if place.is_symlink() or not (is_free or place.name in made):
            raise InputError(
                f"{place}: was not made by regress, so it stays; must be moved, or "
                "--report be another folder"
            )


def replace_kept_runs(folder: Path, runs: Iterable[Path]) -> None:
    """Remove the previous report's runs, and move those of this one, on the same disk, here."""
    for file in _made(folder):
        file.unlink(missing_ok=True)
        with suppress(OSError):  # it holds something else
            for parent in file.relative_to(folder).parents:
                (folder / parent).rmdir()
    (folder / MANIFEST_FILE).unlink(missing_ok=True)
    with suppress(OSError):  # likewise
        folder.rmdir()
    moves = {
        file: Path(run.name, file.relative_to(run))
        for run in runs
        for file in run.rglob("*")
        if file.is_file()
    }
    if moves:
        with replacing(folder / MANIFEST_FILE) as temporary:
            listed = [place.as_posix() for place in moves.values()]
            temporary.write_text(json.dumps(listed, indent=1), encoding="utf-8")
    for file, place in moves.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        file.replace(folder / place)


def _made(folder: Path) -> list[Path]:
    """The listed files that are inside this folder."""
    manifest = folder / MANIFEST_FILE
    if not manifest.is_file():
        return []
    try:
        listed = [Path(name) for name in json.loads(manifest.read_bytes())]
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise InputError(f"{manifest}: cannot be read: {error}") from None
    root = folder.resolve()
    return [
        folder / path
        for path in listed
        if len(path.parts) > 1
        and ".." not in path.parts
        and (folder / path).parent.resolve().is_relative_to(root)
    ]
