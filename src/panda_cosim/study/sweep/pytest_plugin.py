"""Turns a sweep.toml beside a scenario into a test of its success rate; see the other plugin."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from ..compare.pytest_plugin import SCENARIO_FILE, JudgedItem, is_chosen

if TYPE_CHECKING:
    from ..compare.outcome import Outcome

SWEEP_FILE = "sweep.toml"


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> SweepFile | None:
    """Make a test of a sweep beside a scenario in one of the folders."""
    if file_path.name != SWEEP_FILE or not is_chosen(file_path, parent.config):
        return None
    if not (file_path.parent / SCENARIO_FILE).is_file():
        text = f"{file_path}: has no {SCENARIO_FILE} beside it, so that it is not run"
        warnings.warn(pytest.PytestCollectionWarning(text), stacklevel=1)
        return None
    return SweepFile.from_parent(parent, path=file_path)


class SweepFile(pytest.File):
    """A sweep in a scenario's folder."""

    def collect(self) -> Iterator[SweepItem]:
        """Yield the one test."""
        yield SweepItem.from_parent(self, name=f"{self.path.parent.name} (sweep)")


class SweepItem(JudgedItem):
    """A sweep that must reach its success rate."""

    def outcome(self) -> Outcome:
        """Run the sweep, on as many processes as scenarios run side by side."""
        from ...fmus.atomic import (  # noqa: PLC0415 - only where there is a sweep
            cache_folder,
            temporary_folder,
        )
        from .suite import SuiteSweep  # noqa: PLC0415 - see above

        with temporary_folder(cache_folder()) as folder:
            jobs = self.config.getoption("--panda-jobs")
            return SuiteSweep(self.path).judge(folder / self.name, jobs)
