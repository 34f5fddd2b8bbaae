"""What a run can come to, in whatever reads it; `verdicts` is the table of all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Verdict:
    """What a run can come to, and what each reader makes of it."""

    word: str  # in summary.json and pages
    level: Literal["good", "plain", "bad"]  # its colour; only a bad one fails
    exit_code: int  # of `run`; the number of a signal is added
    status: str  # of a row of a sweep
    suite: Literal["holds", "missed", "failed"]  # in `regress`, without a reference
    headline: str  # of `run`, with `detail`, and `why` a failure is expected
    problem: Literal["failure", "error"] | None = None  # in JUnit
    kind: str = ""  # of the problem

    @property
    def fault(self) -> tuple[Literal["failure", "error"], str] | None:
        """Problem and kind in JUnit; None: it is none."""
        return (self.problem, self.kind) if self.problem else None
