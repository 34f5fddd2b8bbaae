"""Texts from elsewhere stay text: in pages, on the terminal, in JUnit files, in commands."""

import html
import io
import json
import re
import shlex
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit
from xml.etree import ElementTree

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.text import Text

from browser import Page
from crafted_texts import HEBREW, HIDDEN, HOSTILE, ODD
from live_support import READY
from panda_cosim import Recording, Run, RunComparison, Scenario, TableRow, TrajectoryTable, compare
from panda_cosim.cli.console import QuietConsole, complain, table
from panda_cosim.cli.outcome import verdict_table
from panda_cosim.fmus.build.description import Layout, documentation, members
from panda_cosim.fmus.build.native import NativeFmu
from panda_cosim.fmus.errors import TEXT_LENGTH, legible, printable
from panda_cosim.fmus.interface.sensors import SENSORS
from panda_cosim.result.judging.criterion import Criterion
from panda_cosim.result.judging.summary import SUMMARY_FILE, Summary
from panda_cosim.result.view.model import describe
from panda_cosim.result.view.page import Inline, live_page
from panda_cosim.study.compare.against_reference import compare_with_reference
from panda_cosim.study.compare.junit import Case, write_cases
from panda_cosim.study.compare.outcome import Outcome
from panda_cosim.study.compare.reference import Reference
from panda_cosim.study.compare.report import write_report as write_suite
from panda_cosim.study.live.server import LiveServer
from panda_cosim.study.sweep.report import write_report
from panda_cosim.study.sweep.row import command as row_command
from panda_cosim.study.sweep.store import Store
from panda_cosim.task.tolerances import Tolerances
from regress_support import CONTENT, SUMMARY, columns, record
from view_support import MODEL

TEXT = "".join((
    *HOSTILE[:-1], "[bold]x[/red]", "\x1b]0;title\x07\x9b31m", "a\0b\rc", "{{7*7}}`id`$(id);#\n id",
    "\u2066\u05e9\u05dc\u05d5\u05dd\u2067", HOSTILE[-1],
))  # fmt: skip
TABLE = TrajectoryTable(tuple(TableRow(t, "home", (0.0, 0.0, 0.0), 0.08) for t in (0.0, 1.0)))
CODE_RAN = """[...document.querySelectorAll("[data-code]")].every(
    ({ dataset: { code } }) => window[`Panda${code[0].toUpperCase()}${code.slice(1)}`])"""
STOLEN = "<script>window.stolen = 1</script><img src=x onerror='window.stolen = 1'>"


def shown(page: Page, path: Path, scripts: int) -> None:
    """Open a page; nothing in it runs that is not its own, and it asks nobody."""
    page.open(path)
    page.wait(CODE_RAN)
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
    content = {"origin": origin, "keys": [text], "columns": names, "rows": 2,
               "nominal": {text: dict.fromkeys(names)}, "without_effect": [text]}  # fmt: skip
    Store(folder).write(content)
    values = {
        "index": [0, 1], text: [0.1, 0.2], "margin": [0.5, -0.5],
        "margin.tracking_max": [0.5, -0.5],
        "scenario": [text] * 2, "status": ["success", "failed"], "missed": [None, text],
        "error": [None, text], "command": [text] * 2,
    }  # fmt: skip
    pq.write_table(pa.table(values), folder / "results" / "part-00000000.parquet")
    return folder


def test_commands_and_links_of_a_sweep_hold_any_folder_and_scenario(tmp_path):
    folder = sweep_folder(tmp_path / "javascript:x';id #%41?", "x")
    (folder / "shown" / "0000001").mkdir(parents=True)
    (folder / "shown" / "0000001" / "view.html").touch()
    text = write_report(folder, tmp_path / "page.html").read_text(encoding="utf-8")
    data = json.loads(text.partition('data-view="&quot;sweep&quot;">')[2].partition("</script>")[0])
    link = "./javascript%3Ax%27%3Bid%20%23%2541%3F/shown/0000001/view.html"
    assert data["views"] == {"1": link}
    assert shlex.split(data["show"])[-1] == str(folder)
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


def documented(text: str) -> bytes:
    """Return the documentation of an FMU in which every text is the same one."""
    variables = tuple(replace(v, description=text, unit=text) for v in SENSORS.variables)
    interface = replace(SENSORS, description=text, variables=variables)
    return documentation(NativeFmu(interface, "python", text), Layout(), (text,))


def reported(folder: Path, text: str) -> bytes:
    """Return a report in which every text that users can choose is the same one."""
    units = {"controller.dq[2]": text}
    tolerances = Tolerances(values={"controller.dq": 3e-7})
    scenario = Scenario("x", TABLE, 0.4, folder=folder, regression=tolerances)
    object.__setattr__(scenario, "purpose", text)  # a scenario file refuses some of these
    before = record(folder / "before", columns(), units=units)
    reference = Reference.of(before, SUMMARY, tolerances)
    reference.write(folder / "reference.parquet", before)
    values = columns()
    values["controller.dq[2]"][150:250] += 1e-4
    metadata = {"versions": {text: text}, "parameters": {text: {text: text}}}
    record(folder / "now", values, units=units, metadata=metadata)
    (folder / "now" / SUMMARY_FILE).write_text(json.dumps({**CONTENT, "limits": {text: 1.0}}))
    now = Recording.open(folder / "now")
    compared = compare_with_reference(now, SUMMARY, reference, tolerances)
    differs = Outcome(scenario, "differs", folder / "now", 1.0, compared)
    named = copy(scenario)
    object.__setattr__(named, "name", text)  # as a folder may be called
    failed = Outcome(named, "failed", folder / "none", 1.0, error=text)
    write_suite([differs, failed], folder / "report.html", {text: 1.0})
    return (folder / "report.html").read_bytes()


# How each page is made, and where in it the text stands; the view has a test of its own.
PAGES: dict[str, tuple[Callable[[Path, str], bytes], str]] = {
    "sweep": (lambda folder, text: write_report(sweep_folder(folder, text)).read_bytes(), "h1"),
    "comparison": (lambda folder, text: compared(folder, text).to_html().encode(), "main"),
    "documentation": (lambda _, text: documented(text), "body"),
    "report": (reported, ".purpose"),
}


@pytest.mark.parametrize("kind", PAGES)
def test_texts_in_a_page_stay_text(page, tmp_path, kind):
    make, selector = PAGES[kind]
    path = tmp_path / "page.html"
    path.write_bytes(make(tmp_path / "x", TEXT))
    shown(page, path, make(tmp_path / "y", "x").count(b"<script"))
    assert says(page, selector, TEXT)
    if kind == "sweep":
        copied = page.value("document.querySelector('#worst [data-copy]').dataset.copy")
        assert copied.isprintable()  # pasted into a shell, it does not run at once
    # Nor does a script run that got in all the same.
    pierced = re.sub("(<body[^>]*>)", rf"\1{STOLEN}", path.read_text(encoding="utf-8"))
    path.write_text(pierced, encoding="utf-8")
    page.open(path)
    assert page.value("document.querySelectorAll('img').length") == 1
    assert page.value("window.stolen") is None


def test_an_fmus_description_is_xml_whatever_names_a_model_has():
    text = "body 'a\x1b[31m\0\x9b' of <b>"  # MuJoCo reads such names from MJCF
    variables = tuple(replace(v, description=text) for v in SENSORS.variables)
    interface = replace(SENSORS, description=text, variables=variables)
    for fmi in (2, 3):
        written = members(NativeFmu(interface, "python", text), Layout(fmi))
        made = ElementTree.fromstring(written["modelDescription.xml"])
        assert made.get("description") == r"body 'a\x1b[31m\x00\x9b' of <b>"


def in_notebook(page: Page, folder: Path, frame: str) -> None:
    """Show a frame in a page that stands for a notebook."""
    path = folder / "notebook.html"
    path.write_text(f"<!DOCTYPE html><body>{frame}", encoding="utf-8")
    page.open(path)


def test_a_frame_keeps_scripts_from_the_notebook(page, tmp_path):
    own = "<script>window.ran = 1; parent.stolen = 1</script>"
    in_notebook(page, tmp_path, Inline(own, 100)._repr_html_())
    with page.in_frame():
        assert page.value("window.ran") == 1  # or the frame would be of no use
    assert page.value("window.stolen") is None
    frame = compared(tmp_path, "x")._repr_html_()
    body = '<body class="page-differences">'
    assert html.escape(body) in frame
    spoiled = frame.replace(html.escape(body), html.escape(f"{body}{STOLEN}"))
    in_notebook(page, tmp_path, spoiled)
    with page.in_frame():
        assert page.value("document.querySelectorAll('img').length") == 1
        assert page.value("window.stolen") is None


def test_a_notebook_shows_a_runs_texts(page, tmp_path):
    criteria = (Criterion(TEXT, 1.0, 2.0, TEXT), Criterion(TEXT, None, 1.0, ""))
    summary = Summary(criteria=criteria, scenario=TEXT, reason=TEXT, complete=False)
    in_notebook(page, tmp_path, Run(tmp_path, summary)._repr_html_())
    tags = "[...new Set([...document.body.querySelectorAll('*')].map((e) => e.tagName))].sort()"
    assert page.value(tags) == ["P", "TABLE", "TBODY", "TD", "TH", "TR"]
    assert page.value(HIDDEN) is False
    assert says(page, "p", TEXT)
    assert page.errors == []


def test_a_terminal_gets_text(capsys):
    criterion = Criterion(TEXT, 1.0, 2.0, TEXT)
    plain = table((TEXT, f"{TEXT}*"), [[TEXT, Text(TEXT)]], title=TEXT)
    tables = [plain, verdict_table(SimpleNamespace(criteria=[criterion]))]
    console = QuietConsole(file=io.StringIO(), width=200, highlight=False)
    for each in tables:
        console.print(each)
    console.print(TEXT, markup=False, soft_wrap=True)
    complain(TEXT)
    shown_text = console.file.getvalue() + capsys.readouterr().err
    assert all(c.isprintable() or c == "\n" for c in shown_text)
    assert printable(TEXT)[:20] in shown_text


def test_junit_holds_any_text(tmp_path):
    text = TEXT + "\udcff"
    write_cases("suite", [Case(text, 1.0, ("error", text), text, text)], tmp_path / "junit.xml")
    (case,) = ElementTree.parse(tmp_path / "junit.xml").getroot().iter("testcase")
    assert case.get("name") == "".join(c if c.isprintable() or c == "\n" else "?" for c in text)


# The live page.

TUNABLES = {f"{ODD}.p": 1.0, f"{ODD}.on": True, f"{ODD}.kind": ODD}
PLAN = {
    "time": [0.0, 1.0],
    "points": [0.3, 0.0, 0.5, 0.4, 0.0, 0.5],
    "waypoints": [{"time": 0.5, "label": ODD, "place": [0.3, 0.0, 0.5]}],
}


def described() -> dict[str, Any]:
    """What the page is told of a run, with a text wherever one can be."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    qpos = [f"plant.qpos[{i + 1}]" for i in range(model.nq)]
    columns = ["time", *qpos, ODD]
    about = {"title": ODD, "purpose": ODD, "facts": [ODD], "notes": [ODD], "criteria": [],
             "verdict": {"state": "plain", "words": ODD}, "limits": [], "moments": [],
             "waypoints": [], "curves": [{"title": ODD, "columns": [ODD]}]}  # fmt: skip
    kinds = zip(TUNABLES, ("Real", "Boolean", "Enumeration"), ([], [], [ODD]), strict=True)
    return {
        "name": ODD, "about": about, "model": describe(model), "columns": columns,
        "signals": [{"name": ODD, "columns": [ODD], "units": [ODD], "unit": ODD, "words": ODD}],
        "roles": {"qpos": qpos}, "bounds": {}, "duration": 1.0,
        "row": [0.0, *model.qpos0.tolist(), 0.0],
        "tunables": [{"name": name, "unit": ODD, "words": ODD, "minimum": None, "maximum": None,
                      "kind": kind, "choices": choices} for name, kind, choices in kinds],
        "couplings": [ODD], "pushes": [], "plan": PLAN,
    }  # fmt: skip


def test_texts_in_the_live_page_stay_text(page):
    status = {"run": 1, "playing": False, "over": False, "speed": 1.0, "coupling": ODD,
              "values": TUNABLES, "behind": 1.5, "folder": ODD, "message": HEBREW}  # fmt: skip
    simulation = SimpleNamespace(
        history=(np.zeros(16),),
        status=lambda: status,
        plan=lambda: PLAN,
        ask=lambda _command, refuse: refuse(ODD),
    )
    server = LiveServer(simulation, live_page(ODD, described()))  # type: ignore[arg-type]
    with server.serving():
        page.visit(server.address, 820, 560)
        page.wait(READY)
        page.wait("document.querySelector('.pv-says').textContent.includes('1.5 s behind')")
        page.click(".pv-tick-on")
        page.wait("document.querySelector('.pv-says').textContent.includes('onerror')")
        page.click(".pv-tab:last-child")
        for part in (".pv-header", ".pv-parameters", ".pv-says", ".pv-place", ".pv-chart"):
            text = page.value(f"document.querySelector('{part}').textContent")
            assert "onerror=window.ran=1" in text, part
        assert page.value(HIDDEN) is False
        assert page.value(r"/[\p{Cc}\p{Cf}]/u.test(document.title)") is False
        assert page.value("document.querySelectorAll('img, iframe').length") == 0
        assert page.value("window.ran") is None
        assert page.errors == []
        host = urlsplit(server.address).netloc
        assert {urlsplit(address).netloc for address in page.requests} <= {host, ""}
        root = "document.documentElement"
        assert page.value(f"[{root}.scrollWidth, {root}.scrollHeight]") == [820, 560]
        assert page.value("document.querySelector('.pv-stage').clientHeight") >= 0.25 * 560
