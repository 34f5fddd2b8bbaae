"""Texts from elsewhere stay text: in pages, on the terminal, in JUnit files, in commands."""

from __future__ import annotations

import html
import io
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from browser import Page, browser, find_browser
from panda_cosim.fmus.interface.sensors import SENSORS
from panda_cosim.fmus.messages import printable
from panda_cosim.fmus.packaging.description import Identity
from panda_cosim.fmus.packaging.document import About, documentation
from panda_cosim.scenarios.cli.console import QuietConsole, as_cell, complain, table
from panda_cosim.scenarios.cli.verdict import verdict_table
from panda_cosim.scenarios.judging.criterion import Criterion
from panda_cosim.scenarios.regression.between_runs import compare
from panda_cosim.scenarios.regression.junit_file import Case, write_cases
from panda_cosim.scenarios.sweep.report import write_report
from panda_cosim.scenarios.sweep.store import Store
from regress_support import columns, record
from test_report import HOSTILE

TEXTS = [*HOSTILE, "[bold]x[/red]", "\x1b]0;title\x07\x9b31m", "a\0b", "{{7*7}}`id`$(id);#\n id"]
IN_PAGES = [
    pytest.param("".join(TEXTS), id="all"),
    *(pytest.param(TEXTS[i], id=f"{i}") for i in (0, 4, 5)),
    *(pytest.param(text, id=f"alone-{i}", marks=pytest.mark.long) for i, text in enumerate(TEXTS)),
]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    if find_browser() is None:
        pytest.skip("no Chromium here")
    with browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def shown(page: Page, path: Path, scripts: int) -> None:
    """Open a page; nothing in it runs that is not its own, and it asks nobody."""
    page.errors.clear()
    page.requests.clear()
    page.open(path)
    assert page.value("document.querySelectorAll('script').length") == scripts
    assert page.value("document.querySelectorAll('main img, body > img, iframe').length") == 0
    assert page.value("[...document.all].filter((e) => e.onerror || e.onfocus).length") == 0
    assert page.errors == []  # `stolen` would be an unknown name
    assert all(address.startswith(("file:", "data:", "about:")) for address in page.requests)
    policy = "meta[http-equiv=Content-Security-Policy]"
    assert page.value(f"document.querySelector('{policy}') !== null") is True


def says(page: Page, selector: str, text: str) -> bool:
    """Whether an element says a text."""
    found = page.value(f"document.querySelector({selector!r}).textContent")
    return visible(text) in visible(found)


def visible(text: str) -> str:
    """Leave out white space, and characters that HTML has not."""
    return "".join(text.replace("\0", "").replace("\ufffd", "").split())


def sweep_folder(folder: Path, text: str) -> Path:
    """Write a sweep's folder in which every text is the same one."""
    names = ["index", "margin", "margin.tracking_max", "status", "missed", "error", "command",
             "scenario"]  # fmt: skip
    definition = {"design": "random", "seed": 1, "samples": 2, "scenario": [text],
                  "criterion": "", "goal": "fail"}  # fmt: skip
    origin = {"definition": definition, "vary": {text: {}}, "scenarios": {text: text},
              "fmus": {text: text}, "versions": {text: text}}  # fmt: skip
    content = {"origin": origin, "keys": [text], "columns": names, "nominal": {text: {}}}
    Store(folder).write(content)
    values = {
        "index": [0, 1], text: [0.1, 0.2], "margin": [0.5, -0.5],
        "margin.tracking_max": [0.5, -0.5],
        "scenario": [text] * 2, "status": ["success", "failed"], "missed": [None, text],
        "error": [None, text], "command": [text] * 2,
    }  # fmt: skip
    pq.write_table(pa.table(values), folder / "results" / "part-00000000.parquet")
    return folder


@pytest.mark.parametrize("text", IN_PAGES)
def test_a_sweeps_report_shows_texts(page: Page, text: str, tmp_path: Path) -> None:
    shown(page, write_report(sweep_folder(tmp_path / "sweep", text)), 2)
    assert page.value("window.sweepReport !== undefined")
    assert says(page, "h1", text)
    copied = page.value("document.querySelector('#worst button').dataset.copy")
    assert copied.isprintable()  # pasted into a shell, it does not run at once


def test_commands_and_links_of_a_sweep_hold_any_folder(tmp_path: Path) -> None:
    folder = sweep_folder(tmp_path / "javascript:x';id #%41?", "x")
    (folder / "shown" / "0000001").mkdir(parents=True)
    (folder / "shown" / "0000001" / "view.html").touch()
    text = write_report(folder, tmp_path / "page.html").read_text(encoding="utf-8")
    assert 'href="./javascript%3Ax%27%3Bid%20%23%2541%3F/shown/0000001/view.html"' in text
    row = text.partition("panda-cosim sweep show ")[2].partition('"')[0]
    assert shlex.split(html.unescape(row))[0] == str(folder)


@pytest.mark.parametrize("text", IN_PAGES)
def test_a_comparison_of_runs_shows_texts(page: Page, text: str, tmp_path: Path) -> None:
    for name, mass in (("a", 1.0), ("b", 2.0)):
        values = columns()
        values["controller.dq[2]"] = values["controller.dq[2]"] * mass
        metadata = {"parameters": {text: {text: mass}}, "versions": {text: text}}
        units = {"controller.dq[2]": text}
        record(tmp_path / name, values, units=units, metadata=metadata)
    made = compare(tmp_path / "a", tmp_path / "b")
    path = tmp_path / "compare.html"
    path.write_text(made.to_html(), encoding="utf-8")
    shown(page, path, path.read_text(encoding="utf-8").count("<script"))
    assert says(page, "main", text)


@pytest.mark.parametrize("text", IN_PAGES)
def test_an_fmus_documentation_shows_texts(page: Page, text: str, tmp_path: Path) -> None:
    variables = tuple(replace(v, description=text, unit=text) for v in SENSORS.variables)
    interface = replace(SENSORS, description=text, variables=variables)
    path = tmp_path / "index.html"
    about = About(law=text, needs=(text,))
    path.write_bytes(documentation(interface, Identity(text, 0.001), 2, about))
    shown(page, path, 0)
    assert says(page, "body", text)


@pytest.mark.parametrize("text", TEXTS, ids=range(len(TEXTS)))
def test_a_terminal_gets_text(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    criterion = Criterion(text, 1.0, 2.0, text, ok=True)
    tables = [table((text, f"{text}*")), verdict_table(SimpleNamespace(criteria=[criterion]))]
    tables[0].add_row(as_cell(text), as_cell(text))
    console = QuietConsole(file=io.StringIO(), width=200, highlight=False)
    for made in tables:
        console.print(made)
    console.print(text, markup=False, soft_wrap=True)
    said = console.file.getvalue()
    assert all(c.isprintable() or c == "\n" for c in said)
    assert printable(text)[:20] in said
    complain(text)
    assert all(c.isprintable() or c == "\n" for c in capsys.readouterr().err)


@pytest.mark.parametrize("text", [*TEXTS, "\udcff"], ids=range(len(TEXTS) + 1))
def test_junit_holds_any_text(text: str, tmp_path: Path) -> None:
    write_cases("suite", [Case(text, 1.0, "error", text, text, text)], tmp_path / "junit.xml")
    (case,) = ElementTree.parse(tmp_path / "junit.xml").getroot().iter("testcase")
    assert case.get("name") == "".join(c if c.isprintable() or c == "\n" else "?" for c in text)
