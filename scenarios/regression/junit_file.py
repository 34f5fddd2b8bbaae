"""A JUnit XML file: test cases for CI servers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as ET

from ...fmus.atomic import MARK, replacing


@dataclass(frozen=True)
class Case:
    """One test case.

    Attributes:
        name: Name of the scenario.
        seconds: Wall time [s].
        problem: A `failure` (ran, but not as expected), an `error` (did not run), or None.
        kind: Kind of problem.
        message: The problem in one line.
        details: The problem in full.
    """

    name: str
    seconds: float
    problem: Literal["failure", "error"] | None = None
    kind: str = ""
    message: str = ""
    details: str = ""


def write_cases(suite_name: str, cases: Sequence[Case], path: Path) -> None:
    """Write a suite of test cases.

    Raises:
        InputError: The file cannot be written.
    """
    suite = ET.Element(
        "testsuite",
        name=suite_name,
        tests=str(len(cases)),
        failures=str(sum(case.problem == "failure" for case in cases)),
        errors=str(sum(case.problem == "error" for case in cases)),
        skipped="0",
        time=f"{sum(case.seconds for case in cases):.3f}",
    )
    suite.extend(map(_element, cases))
    root = ET.Element("testsuites")
    root.extend([ET.Comment(MARK), suite])
    ET.indent(root)
    with replacing(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _element(case: Case) -> ET.Element:
    attributes = {
        "classname": "scenarios",
        "name": _valid(case.name),
        "time": f"{case.seconds:.3f}",
    }
    element = ET.Element("testcase", attributes)
    if case.problem is not None:
        known = {"type": _valid(case.kind), "message": _valid(case.message)}
        problem = ET.SubElement(element, case.problem, known)
        problem.text = _valid(case.details)
    return element


def _valid(text: str) -> str:
    """Replace characters that XML 1.0 cannot hold."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)
