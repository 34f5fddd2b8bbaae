"""The history of a suite over nights: a line of JSON for each case of each `regress`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from shutil import which
from typing import Final, NamedTuple

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_json

from ...fmus.build.identity import code_digest, digest
from ...fmus.errors import refuse
from ...fmus.processes import run
from ...run.folder import SCENARIO_FOLDER
from ...run.output import versions
from ...task.files import read_text
from ...task.scenario import Scenario
from ..work import processor
from .outcome import MEANINGS, Outcome, Verdict

DIGITS: Final = 12  # hexadecimal ones of a digest
MARKS: Final = {"good": "✓", "warn": "?", "bad": "✗"}  # of verdicts, by level


class Night(NamedTuple):
    """What one case came to: a line of a history."""

    scenario: str
    date: str  # local time with its zone, ISO 8601
    commit: str  # of the working directory; "": it is in no repository
    verdict: Verdict
    share: float | None  # of its tube that the worst signal took; None: nothing was compared
    recording: str  # digest of all values; "": there is none
    made: str  # digest of code, versions, machine, scenario and reference; "": of a sweep

    @property
    def mark(self) -> str:
        """A character for its verdict."""
        return MARKS[MEANINGS[self.verdict].level]


def read_history(path: Path | None) -> list[Night]:
    """Read a history; one that does not exist is empty."""
    nights, known = [], TypeAdapter(Night)
    lines = read_text(path, 10**9).splitlines() if path and path.exists() else []
    for number, line in enumerate(lines, 1):
        try:
            nights.append(known.validate_json(line))
        except ValidationError:
            refuse(f"{path}: line {number}", line, "must be one that regress --history wrote")
    return nights


def with_history(
    outcomes: Sequence[Outcome], path: Path, past: Sequence[Night], options: str
) -> list[Outcome]:
    """Write a history with one night more; return the outcomes with all nights of their own."""
    git = ["git", "rev-parse", "--short", "HEAD"]
    stamp = time.strftime("%Y-%m-%dT%H:%M:%S%z"), run(git).stdout.strip() if which(git[0]) else ""
    known = [*past, *(_night(each, stamp, options) for each in outcomes)]
    lines = (to_json(night._asdict(), inf_nan_mode="null") + b"\n" for night in known)
    path.write_bytes(b"".join(lines))
    return [replace(o, nights=tuple(n for n in known if n.scenario == o.name)) for o in outcomes]


def _night(outcome: Outcome, stamp: tuple[str, str], options: str) -> Night:
    share, made = outcome.worst.share if outcome.worst else None, ""
    if isinstance(outcome.scenario, Scenario):
        kept = sorted((outcome.run / SCENARIO_FOLDER).rglob("*"))
        files = (file.read_bytes() for file in (*kept, outcome.reference_path) if file.is_file())
        made = digest(code_digest(()), repr(versions()), processor(), options, *files)[:DIGITS]
    return Night(outcome.name, *stamp, outcome.verdict, share, outcome.recording[:DIGITS], made)
