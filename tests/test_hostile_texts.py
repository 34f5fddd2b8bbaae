"""Texts from elsewhere stay text: in pages, on the terminal, in JUnit files, in commands."""

from __future__ import annotations

import html
import io
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from browser import Page
from crafted_texts import HIDDEN, HOSTILE
from forked import command
from panda_cosim.fmus.build.description import Identity, model_description
from panda_cosim.fmus.build.document import documentation
from panda_cosim.fmus.interface.sensors import SENSORS
from panda_cosim.fmus.messages import TEXT_LENGTH, legible, printable
from panda_cosim.scenarios.cli.console import QuietConsole, as_cell, complain, table
from panda_cosim.scenarios.cli.outcome import verdict_table
from panda_cosim.scenarios.compare.between_runs import RunComparison, compare
from panda_cosim.scenarios.compare.junit import Case, write_cases
from panda_cosim.scenarios.judging.criterion import Criterion
from panda_cosim.scenarios.run.result import Run
from panda_cosim.scenarios.sweep.report import write_report
from panda_cosim.scenarios.sweep.row import command as row_command
from panda_cosim.scenarios.sweep.store import Store
from panda_cosim.scenarios.view.page import Inline
from regress_support import columns, record

*SHORT, LONG = HOSTILE
TEXTS = [
    *SHORT, "[bold]x[/red]", "\x1b]0;title\x07\x9b31m", "a\0b\rc", "{{7*7}}`id`$(id);#\n id",
    "\u2066\u05e9\u05dc\u05d5\u05dd\u2067", LONG,
]  # fmt: skip
IN_PAGES = [
    pytest.param("".join(TEXTS), id="all"),
    *(pytest.param(TEXTS[i], id=f"{i}") for i in (4, 5, 9)),
    *(pytest.param(text, id=f"alone-{i}", marks=pytest.mark.long) for i, text in enumerate(TEXTS)),
]


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
    assert page.value("document.documentElement.scrollWidth") <= 1280
    assert page.value(HIDDEN) is False  # nothing turns our own words around
    policy = "meta[http-equiv=Content-Security-Policy]"
    assert page.value(f"document.querySelector('{policy}') !== null") is True


def says(page: Page, selector: str, text: str) -> bool:
    """Whether an element says a text, or its beginning."""
    found = page.value(f"document.querySelector({selector!r}).textContent")
    begin = legible(text)[: TEXT_LENGTH - 100]  # words of the page's own may stand before it
    return "".join(begin.split()) in "".join(found.split())  # HTML joins white space


def sweep_folder(folder: Path, text: str) -> Path:
    """Write a sweep's folder in which every text is the same one."""
    names = ["index", "margin", "margin.tracking_max", "status", "missed", "error", "command",
             "scenario"]  # fmt: skip
    definition = {"design": "random", "seed": 1, "samples": 2, "scenario": [text],
                  "criterion": "", "goal": "fail"}  # fmt: skip
    origin = {"definition": definition, "vary": {text: {}}, "scenarios": {text: text},
              "fmus": {text: text}, "versions": {text: text}}  # fmt: skip
    content = {"origin": origin, "keys": [text], "columns": names, "nominal": {text: {}},
               "rows": 2, "without_effect": [text]}  # fmt: skip
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


def test_a_rows_command_holds_any_scenario() -> None:
    said = row_command("a b;c", {"plant.scene": "x y"})
    assert shlex.split(said) == ["panda-cosim", "run", "a b;c", "--set", "plant.scene=x y"]


def compared(folder: Path, text: str) -> RunComparison:
    """Compare two runs in which every text is the same one."""
    for name, mass in (("a", 1.0), ("b", 2.0)):
        values = columns()
        values["controller.dq[2]"] = values["controller.dq[2]"] * mass
        metadata = {"parameters": {text: {text: mass}}, "versions": {text: text}}
        units = {"controller.dq[2]": text}
        record(folder / name, values, units=units, metadata=metadata)
    return compare(folder / "a", folder / "b")


@pytest.mark.parametrize("text", IN_PAGES)
def test_a_comparison_of_runs_shows_texts(page: Page, text: str, tmp_path: Path) -> None:
    made = compared(tmp_path, text)
    path = tmp_path / "compare.html"
    path.write_text(made.to_html(), encoding="utf-8")
    shown(page, path, path.read_text(encoding="utf-8").count("<script"))
    assert says(page, "main", text)


@pytest.mark.parametrize("text", IN_PAGES)
def test_an_fmus_documentation_shows_texts(page: Page, text: str, tmp_path: Path) -> None:
    variables = tuple(replace(v, description=text, unit=text) for v in SENSORS.variables)
    interface = replace(SENSORS, description=text, variables=variables)
    path = tmp_path / "index.html"
    path.write_bytes(documentation(interface, Identity(text, "1"), 2, text, (text,)))
    shown(page, path, 0)
    assert says(page, "body", text)


def test_a_folder_whose_name_is_no_text_is_refused_before_anything_runs(tmp_path: Path) -> None:
    odd = tmp_path / "a\udcff\r"
    done = command("run", "--set", "duration=0.01", "--no-video", "--out", odd)
    assert done.returncode == 2
    assert r"a\udcff\r/recording.parquet: is not UTF-8" in done.stderr
    assert not odd.exists()


def test_an_fmus_description_is_xml_whatever_names_a_model_has() -> None:
    text = "body 'a\x1b[31m\0\x9b' of <b>"  # MuJoCo reads such names from MJCF
    variables = tuple(replace(v, description=text) for v in SENSORS.variables)
    interface = replace(SENSORS, description=text, variables=variables)
    for fmi in (2, 3):
        made = ElementTree.fromstring(model_description(interface, Identity("x", 0.001), fmi))
        assert made.get("description") == r"body 'a\x1b[31m\x00\x9b' of <b>"


STOLEN = "<script>window.stolen = 1</script><img src=x onerror='window.stolen = 1'>"


def pages(folder: Path) -> dict[str, str]:
    """Make the pages that have a policy; view and report have tests of their own."""
    interface = documentation(SENSORS, Identity("x", "1"), 2, "x", ())
    return {
        "sweep": write_report(sweep_folder(folder / "sweep", "x")).read_text(encoding="utf-8"),
        "comparison": compared(folder, "x").to_html(),
        "documentation": interface.decode(),
    }


def test_a_script_that_got_into_a_page_would_not_run(page: Page, tmp_path: Path) -> None:
    for name, text in pages(tmp_path).items():
        path = tmp_path / f"{name}.html"
        path.write_text(text.replace("<body>", f"<body>{STOLEN}"), encoding="utf-8")
        page.open(path)
        assert page.value("document.querySelectorAll('img').length") == 1, name
        assert page.value("window.stolen") is None, name


def in_notebook(page: Page, folder: Path, frame: str) -> None:
    """Show a frame in a page that stands for a notebook."""
    path = folder / "notebook.html"
    path.write_text(f"<!DOCTYPE html><body>{frame}", encoding="utf-8")
    page.open(path)


def test_a_frame_keeps_scripts_from_the_notebook(page: Page, tmp_path: Path) -> None:
    own = "<script>window.ran = 1; parent.stolen = 1</script>"
    in_notebook(page, tmp_path, Inline(own, 100)._repr_html_())
    with page.in_frame():
        assert page.value("window.ran") == 1  # or the frame would be of no use
    assert page.value("window.stolen") is None
    frame = compared(tmp_path, "x")._repr_html_()
    assert html.escape("<body>") in frame
    spoiled = frame.replace(html.escape("<body>"), html.escape(f"<body>{STOLEN}"))
    in_notebook(page, tmp_path, spoiled)
    with page.in_frame():
        assert page.value("document.querySelectorAll('img').length") == 1
        assert page.value("window.stolen") is None


def test_a_notebook_shows_a_runs_texts(page: Page, tmp_path: Path) -> None:
    text = "".join(TEXTS)
    criteria = [Criterion(text, 1.0, 2.0, text, ok=True), Criterion(text, None, 1.0, "", ok=False)]
    said = {"scenario": text, "reason": text, "complete": False, "success": False}
    summary = SimpleNamespace(criteria=criteria, **said)
    page.errors.clear()
    in_notebook(page, tmp_path, Run(tmp_path, summary)._repr_html_())
    tags = "[...new Set([...document.body.querySelectorAll('*')].map((e) => e.tagName))].sort()"
    assert page.value(tags) == ["B", "P", "TABLE", "TBODY", "TD", "TH", "TR"]
    assert page.value(HIDDEN) is False
    assert says(page, "b", text)
    assert page.errors == []


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
