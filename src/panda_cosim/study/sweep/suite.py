"""Sweeps in a suite of `regress`: sweep.toml beside a scenario, judged by its success rate."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from ...fmus.errors import CosimError, InputError
from ...result.judging.criterion import miss_text
from ...run.execution import Progress
from ...task.scenario import SCENARIO_FILE
from ..compare.outcome import Member, Outcome, Verdict
from .definition import Sweep
from .report import write_report
from .sweeping import sweep

FILE: Final = "sweep.toml"


@dataclass(frozen=True)
class SuiteSweep:
    """A sweep of a suite, which must require a success rate; an unusable one fails alone."""

    file: Path
    purpose: str = field(default="success rate of a sweep", init=False)

    @property
    def name(self) -> str:
        """Name in reports, and of the folder of its results."""
        return f"{self.file.resolve().parent.name} (sweep)"

    def judge(self, folder: Path, jobs: int, progress: Progress | None = None) -> Outcome:
        """Run the sweep into a folder, and judge its success rate."""
        began, rate = time.perf_counter(), None
        verdict: Verdict = "failed"
        try:
            definition = Sweep.read(self.file)
            if not definition.min_success:
                raise InputError(f"{self.file}: min_success is missing; must be above 0 in a suite")
            rate = sweep(definition, folder, jobs=jobs, progress=progress).gate
            assert rate is not None  # as one is required
            write_report(folder)
            verdict, problem = ("holds", "") if rate.ok else ("missed", miss_text(rate))
        except CosimError as error:
            problem = str(error)
        seconds = time.perf_counter() - began
        criteria = () if rate is None else (rate,)
        return Outcome(self, verdict, folder, seconds, error=problem, criteria=criteria)


def find_sweeps(scenarios: Iterable[Member]) -> list[SuiteSweep]:
    """Return the sweeps in the folders of a suite's scenarios."""
    files = (each.folder / FILE for each in scenarios if each.folder is not None)
    return [SuiteSweep(file) for file in files if file.is_file()]


def stray_sweeps(folder: Path) -> list[str]:
    """Say of each sweep in a suite that is beside no scenario that it is not run."""
    stray = [f for f in sorted(folder.rglob(FILE)) if not (f.parent / SCENARIO_FILE).is_file()]
    return [f"{file}: has no {SCENARIO_FILE} beside it, so that it is not run" for file in stray]
