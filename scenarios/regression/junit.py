"""JUnit XML of a suite, for CI servers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from ..judging.criterion import line
from .guards import measure, multiple
from .junit_file import Case, write_cases
from .runner import Outcome

FAILURES = ("differs", "missed")  # ran, but not as expected; anything else wrong is an error


def write_junit(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write one test case per scenario: a difference is a failure, anything else wrong an error.

    Raises:
        InputError: The file cannot be written.
    """
    write_cases("panda-cosim regress", [_case_of(outcome) for outcome in outcomes], path)


def _case_of(outcome: Outcome) -> Case:
    name, seconds = outcome.name, outcome.seconds
    if outcome.ok:
        return Case(name, seconds)
    problem: Literal["failure", "error"] = "failure" if outcome.verdict in FAILURES else "error"
    return Case(name, seconds, problem, outcome.verdict, outcome.reason, _details(outcome))


def _details(outcome: Outcome) -> str:
    criteria = [line(criterion) for criterion in outcome.criteria]
    if outcome.comparison is None:
        return "\n".join([outcome.error, *criteria])
    lines = criteria + [problem.text for problem in outcome.comparison.problems]
    for d in outcome.comparison.deviations:
        if not d.ok:
            at = f"worst at {d.time:.3f} s, {d.outside} ticks outside"
            lines.append(
                f"{d.name}: {multiple(d.share)} times its {measure(d.tolerance, d.unit)}; {at}"
            )
    return "\n".join(lines)


__all__ = ["write_junit"]
