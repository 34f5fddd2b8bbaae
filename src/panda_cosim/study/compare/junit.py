"""JUnit XML for CI servers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self
from xml.etree import ElementTree as ET

from ...fmus.atomic import MARK, replacing
from ...result.judging.criterion import line
from .wording import instant, measure, multiple

if TYPE_CHECKING:
    from ...result.judging.verdict import Verdict
    from .regress import Outcome  # `run` writes JUnit, too, without the suite


@dataclass(frozen=True)
class Case:
    """One test case."""

    name: str
    seconds: float  # wall time
    problem: Literal["failure", "error"] | None = None  # ran, but not as expected; did not run
    kind: str = ""
    message: str = ""  # the problem in one line
    details: str = ""

    @classmethod
    def of(cls, name: str, seconds: float, verdict: Verdict, detail: str) -> Self:
        """Return the case of what came to a verdict; the detail is its message."""
        fault = (*verdict.fault, detail) if verdict.fault else ()
        return cls(name, seconds, *fault)


def write_junit(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write one test case per scenario: a difference is a failure, anything else wrong an error."""
    write_cases("panda-cosim regress", [_case_of(outcome) for outcome in outcomes], path)


def _case_of(outcome: Outcome) -> Case:
    name, seconds = outcome.name, outcome.seconds
    if outcome.ok:
        return Case(name, seconds)
    problem: Literal["failure", "error"] = (
        "failure" if outcome.verdict in ("differs", "missed") else "error"
    )
    return Case(name, seconds, problem, outcome.verdict, outcome.reason, details(outcome))


def details(outcome: Outcome) -> str:
    """Return a line for each criterion, problem and signal outside its tube."""
    criteria = [line(criterion) for criterion in outcome.criteria]
    if outcome.comparison is None:
        return "\n".join([outcome.error, *criteria])
    deviations = [
        f"{d.name}: {multiple(d.share)} times its {measure(d.tolerance, d.unit)}; "
        f"worst at {instant(d.time)} s, {d.outside} ticks outside"
        for d in outcome.comparison.deviations
        if not d.ok
    ]
    return "\n".join([*criteria, *outcome.comparison.problems, *deviations])


def write_cases(suite_name: str, cases: Sequence[Case], path: Path) -> None:
    """Write a suite of test cases."""
    root = ET.Element("testsuites")
    root.append(ET.Comment(MARK))
    suite = ET.SubElement(
        root,
        "testsuite",
        name=suite_name,
        tests=str(len(cases)),
        failures=str(sum(case.problem == "failure" for case in cases)),
        errors=str(sum(case.problem == "error" for case in cases)),
        skipped="0",
        time=f"{sum(case.seconds for case in cases):.3f}",
    )
    for case in cases:
        name, seconds = _valid(case.name), f"{case.seconds:.3f}"
        element = ET.SubElement(suite, "testcase", classname="scenarios", name=name, time=seconds)
        if case.problem is not None:
            kind, message = _valid(case.kind), _valid(case.message)
            problem = ET.SubElement(element, case.problem, type=kind, message=message)
            problem.text = _valid(case.details)
    ET.indent(root)
    with replacing(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _valid(text: str) -> str:
    """Replace characters that XML 1.0 cannot hold."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)
