"""JUnit XML of a suite, for CI."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from ..files import replacing
from .guards import measure, short
from .runner import Outcome

SUITE = "panda-cosim regress"


def write_junit(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write one test case a scenario: a difference is a failure, the rest that is wrong an error.

    Raises:
        InputError: The file cannot be written.
    """
    failures = sum(outcome.verdict == "differs" for outcome in outcomes)
    errors = sum(outcome.verdict in ("failed", "no reference") for outcome in outcomes)
    suite = ET.Element(
        "testsuite",
        name=SUITE,
        tests=str(len(outcomes)),
        failures=str(failures),
        errors=str(errors),
        skipped="0",
        time=f"{sum(outcome.seconds for outcome in outcomes):.3f}",
    )
    suite.extend(_case(outcome) for outcome in outcomes)
    root = ET.Element("testsuites")
    root.append(suite)
    ET.indent(root)
    with replacing(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _case(outcome: Outcome) -> ET.Element:
    name = outcome.scenario.name
    case = ET.Element("testcase", classname="scenarios", name=name, time=f"{outcome.seconds:.3f}")
    if not outcome.ok:
        kind = "failure" if outcome.verdict == "differs" else "error"
        problem = ET.SubElement(case, kind, type=outcome.verdict, message=_valid(outcome.reason))
        problem.text = _valid(_details(outcome))
    return case


def _details(outcome: Outcome) -> str:
    if outcome.comparison is None:
        return outcome.error
    lines = [problem.text for problem in outcome.comparison.problems]
    for d in outcome.comparison.deviations:
        if not d.ok:
            at = f"worst at {d.time:.3f} s, {d.outside} ticks outside"
            lines.append(
                f"{d.name}: {short(d.share)} times its {measure(d.tolerance, d.unit)}; {at}"
            )
    return "\n".join(lines)


def _valid(text: str) -> str:
    """Replace what XML 1.0 cannot hold."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)


__all__ = ["write_junit"]
