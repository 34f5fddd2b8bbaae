"""The kept runs of a report, in `DIR/runs`: `regress` replaces only files that it put there.

`made-by-regress.json` lists these files with their modification times. Everything else in
`DIR/runs` belongs to the user and is neither removed nor overwritten.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

from ...fmus.errors import InputError
from ...fmus.replacing import replacing

MANIFEST_FILE: Final = "made-by-regress.json"


class KeptRuns:
    """A report's folder of runs.

    Args:
        folder: `DIR/runs`; need not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._manifest = folder / MANIFEST_FILE

    def check(self, names: Iterable[str]) -> None:
        """Check that no run would replace something that `regress` did not put there.

        Args:
            names: Names of the runs that may be kept.

        Raises:
            InputError: A run's folder is taken, or the list of files cannot be used.
        """
        intact: dict[str, bool] = {}
        for path, modified in self._listed().items():
            name = path.relative_to(self._folder).parts[0]
            intact[name] = intact.get(name, True) and _is_intact(path, modified)
        for name in names:
            place = self._folder / name
            if not intact.get(name) and not _is_free(place):
                raise InputError(
                    f"{place}: was not made by regress, so it stays; must be moved, or "
                    "--report be another folder"
                )

    def replace(self, runs: Iterable[Path]) -> None:
        """Remove the previous report's runs, and move those of this one here.

        Args:
            runs: Folders on the same file system.

        Raises:
            InputError: The folder cannot be written to.
        """
        self._clear()
        files = {
            file: Path(run.name, file.relative_to(run)) for run in runs for file in _files(run)
        }
        if not files:
            return
        listed = {place.as_posix(): file.stat().st_mtime_ns for file, place in files.items()}
        with replacing(self._manifest) as temporary:
            temporary.write_text(json.dumps(listed, indent=1), encoding="utf-8")
        for file, place in files.items():
            target = self._folder / place
            target.parent.mkdir(parents=True, exist_ok=True)
            file.replace(target)

    def _clear(self) -> None:
        """Remove the listed files, and folders that are empty afterwards."""
        for path, modified in self._listed().items():
            if _is_intact(path, modified):
                path.unlink(missing_ok=True)
            with suppress(OSError):
                for parent in path.relative_to(self._folder).parents:
                    (self._folder / parent).rmdir()
        self._manifest.unlink(missing_ok=True)
        with suppress(OSError):
            self._folder.rmdir()

    def _listed(self) -> dict[Path, int]:
        """Return the listed files inside this folder with their modification times [ns]."""
        if not self._manifest.is_file():
            return {}
        try:
            content = json.loads(self._manifest.read_bytes())
            listed = {Path(name): int(modified) for name, modified in content.items()}
        except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
            raise InputError(f"{self._manifest}: cannot be read: {error}") from None
        root = self._folder.resolve()
        return {
            self._folder / path: modified
            for path, modified in listed.items()
            if len(path.parts) > 1
            and ".." not in path.parts
            and (self._folder / path).parent.resolve().is_relative_to(root)
        }


def _is_intact(path: Path, modified: int) -> bool:
    """Return whether a file is unchanged or gone."""
    try:
        return path.lstat().st_mtime_ns == modified
    except FileNotFoundError:
        return True


def _is_free(place: Path) -> bool:
    if place.is_symlink() or place.is_file():
        return False
    return not place.exists() or not any(place.iterdir())


def _files(run: Path) -> list[Path]:
    return [path for path in sorted(run.rglob("*")) if path.is_file()]


__all__ = ["KeptRuns"]
