"""JUnit XML for CI servers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from xml.etree import ElementTree as ET

from ...fmus.atomic import MARK, replacing
from ...result.judging.criterion import line
from .wording import instant, measure, multiple

if TYPE_CHECKING:
    from .outcome import Outcome  # `run` writes JUnit, too, without the suite


@dataclass(frozen=True)
class Case:
    """One test case."""

    name: str
    seconds: float  # wall time
    # Whether it did not run as expected, or did not run, and what kind of it; None: it is good.
    fault: tuple[Literal["failure", "error", "skipped"], str] | None = None
    message: str = ""  # the fault in one line
    details: str = ""
    properties: Sequence[tuple[str, str]] = ()  # names, which may recur, and values


def write_junit(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write one test case per scenario: a difference is a failure, anything else wrong an error."""
    from .requirements import of_outcome  # noqa: PLC0415 - as above

    cases = []
    for each in outcomes:
        fault = each.meaning.fault and (each.meaning.fault, each.verdict)
        stated = [("requirement", f"{it.requirement}: {it.verdict}") for it in of_outcome(each)]
        judged = [(f"criterion {c.name}", line(c)) for c in each.criteria]
        lines = (each.reason, details(each), [*stated, *judged])
        cases.append(Case(each.name, each.seconds, fault, *lines))
    write_cases("panda-cosim regress", cases, path)


def details(outcome: Outcome) -> str:
    """Return a line for each criterion, problem and signal outside its tube."""
    compared = outcome.comparison
    deviations = [
        f"{d.name}: {multiple(d.share)} times its {measure(d.tolerance, d.unit)}; "
        f"worst at {instant(d.time)} s, {d.outside} ticks outside"
        for d in (compared.deviations if compared else ())
        if not d.ok
    ]
    return "\n".join([*map(line, outcome.criteria), *outcome.problems, *deviations])


def write_cases(suite_name: str, cases: Sequence[Case], path: Path) -> None:
    """Write a suite of test cases."""
    kinds = Counter(case.fault[0] for case in cases if case.fault)
    counts = {"failures": kinds["failure"], "errors": kinds["error"], "skipped": kinds["skipped"]}
    root = ET.Element("testsuites")
    root.append(ET.Comment(MARK))
    told = {"name": suite_name, "tests": len(cases), **counts}
    told["time"] = f"{sum(case.seconds for case in cases):.3f}"
    suite = ET.SubElement(root, "testsuite", {key: str(value) for key, value in told.items()})
    for case in cases:
        name, seconds = _valid(case.name), f"{case.seconds:.3f}"
        element = ET.SubElement(suite, "testcase", classname="scenarios", name=name, time=seconds)
        if case.properties:
            listed = ET.SubElement(element, "properties")
        for key, value in case.properties:
            ET.SubElement(listed, "property", name=_valid(key), value=_valid(value))
        if case.fault is not None:
            tag, kind = case.fault
            shown = {"type": _valid(kind), "message": _valid(case.message)}
            ET.SubElement(element, tag, shown).text = _valid(case.details)
    ET.indent(root)
    with replacing(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _valid(text: str) -> str:
    """Replace characters that XML 1.0 cannot hold."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)
