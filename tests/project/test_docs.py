"""README and site: each block is run from its page, and each page says for whom it is.

A block in sh or Python is run, another one is written to the file that is named in the line before,
and `<!-- not run: WHY -->` before a block says why not. `# exit code 3` at a line's end is what it
must end with, `Ctrl-C` how. Lines of a block of text must be in what the block before has printed.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from ast import literal_eval
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from bounded import ran
from panda_cosim import Scenario, Success, load_scenario
from panda_cosim.cli.app import load
from panda_cosim.cli.commands import COMMANDS, ELSEWHERE
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.scene import load_scene
from panda_cosim.task.table import COLUMNS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
MOST_LINES = 400
UNTIL_CTRL_C = 30.0  # [s]
LIMIT = 1200.0  # [s] for a command
CLOSE = 0.05  # share by which a printed number may differ: another processor rounds differently
BLOCK = re.compile(
    r"(?:^<!-- not run: (?P<why>.+?) -->\n\n?)?(?:^`(?P<file>[\w./-]+)`[^\n]*\n\n)?"
    r"^```(?P<kind>\w+)\n(?P<text>.*?)^```",
    re.M | re.S,
)


@dataclass(frozen=True)
class Block:
    """A block of a page."""

    kind: str
    text: str
    file: str
    why: str  # it is not run


def written(page: Path) -> str:
    """Return a page's text without what is made of the code."""
    made = re.compile(r"<!-- made: (\w+) -->.*?<!-- end: \1 -->", re.S)
    return made.sub("", page.read_text(encoding="utf-8"))


def blocks(page: Path) -> list[Block]:
    return [
        Block(it["kind"], it["text"], it["file"] or "", it["why"] or "")
        for it in BLOCK.finditer(written(page))
    ]


def is_run(block: Block) -> bool:
    return block.kind in ("sh", "python") and not block.why


def lines_of(block: Block) -> list[str]:
    if block.kind == "python":
        return [f"python {block.file or '-'}"]
    return [line for line in re.sub(r"\n  ", " ", block.text).splitlines() if line]


def walk(page: Path, folder: Path) -> None:
    """Do in a folder what a page says."""
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "BROWSER": "true",
    }
    printed = ""
    for block in blocks(page):
        if block.file:
            (folder / block.file).parent.mkdir(parents=True, exist_ok=True)
            (folder / block.file).write_text(block.text, encoding="utf-8")
        if block.kind == "text" and not block.why:
            assert_printed(block.text, printed)
        if is_run(block):
            printed = ""
            for line in lines_of(block):
                printed += run(line, block.text if line == "python -" else "", folder, environment)


def run(line: str, entered: str, folder: Path, environment: dict[str, str]) -> str:
    """Run a line, and return what it prints."""
    ended = "Ctrl-C" in line
    expected = re.search(r"exit code (\d)$", line)
    with subprocess.Popen(
        ["sh", "-c", f"exec {line}" if ended else line],
        cwd=folder, env=environment, text=True, start_new_session=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as process:  # fmt: skip
        try:
            printed, _ = process.communicate(entered, UNTIL_CTRL_C if ended else LIMIT)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGINT if ended else signal.SIGKILL)
            printed, _ = process.communicate(timeout=LIMIT)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    codes = (0, 130) if ended else (int(expected[1]) if expected else 0,)
    assert process.returncode in codes, f"{line}: exit code {process.returncode}\n{printed}"
    return printed


def assert_printed(text: str, printed: str) -> None:
    for line in text.splitlines():
        if line != "..." and set(line) - set("─ "):
            assert any(alike(line, other) for other in printed.splitlines()), (line, printed)


def alike(line: str, other: str) -> bool:
    """Whether two lines have the same words, and numbers that are close."""
    pairs = list(zip(line.split(), other.split(), strict=False))
    return len(line.split()) == len(other.split()) and all(
        one == two or (number(one) is not None and number(one) == pytest.approx(number(two), CLOSE))
        for one, two in pairs
    )


def number(word: str) -> float | None:
    try:
        return float(word.rstrip("%,"))
    except ValueError:
        return None


@pytest.mark.long
@pytest.mark.parametrize(
    "page", [page for page in PAGES if any(map(is_run, blocks(page)))], ids=lambda page: page.stem
)
def test_a_page_runs_as_it_is_written(page, tmp_path):
    walk(page, tmp_path)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_each_block_is_run_or_says_why_not(page):
    assert written(page).count("\n```") == 2 * len(blocks(page))
    assert all(is_run(it) or it.file or it.why or it.kind == "text" for it in blocks(page))


def commands(page: Path) -> Iterator[list[str]]:
    """Words of every command of ours, in blocks and between backticks."""
    text = page.read_text(encoding="utf-8")
    spans = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.S))
    lines = [line for it in blocks(page) if it.kind == "sh" for line in lines_of(it)]
    for line in [*spans, *lines]:
        for part in line.split("#")[0].split("&&"):
            words = part.replace("\\|", "|").split()
            if words and words[0].endswith("panda-cosim"):
                yield words[1:]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_written_command_and_option_exists(page):
    for name, *words in filter(None, commands(page)):
        if name.startswith("-") or name == "COMMAND":
            continue
        assert name in COMMANDS, name
        names = [name, *(each for each in ELSEWHERE if each.split()[0] == name)]
        options = {o for it in names for p in load(it).params for o in (*p.opts, *p.secondary_opts)}
        assert {w for w in words if w.startswith("--")} <= {*options, "--help"}, (name, words)


@pytest.mark.parametrize("page", PAGES[1:], ids=lambda page: page.stem)
def test_a_page_says_for_whom_it_is_and_is_short(page):
    lines = written(page).splitlines()
    assert len(lines) <= MOST_LINES
    title = next(number for number, line in enumerate(lines) if line.startswith("# "))
    assert lines[title + 2].startswith("For ")


def test_what_pages_take_from_the_code_is_what_it_says():
    done = ran([sys.executable, str(ROOT / ".ci" / "reference.py"), "--check"])
    assert done.returncode == 0, done.stdout


def test_every_page_is_in_the_menu():
    menu = (ROOT / "zensical.toml").read_text(encoding="utf-8")
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    assert pages == set(re.findall(r'"([\w/-]+\.md)"', menu))


# README, reference and notebook say what is so: commands, scenario files, links.


SCENARIO = DOCS / "reference" / "scenario.md"


def test_the_example_scenario_can_be_read(tmp_path):
    for kind, file in (("toml", "scenario.toml"), ("csv", "trajectory.csv")):
        text = next(block.text for block in blocks(SCENARIO) if block.kind == kind)
        (tmp_path / file).write_text(text, encoding="utf-8")
    scenario = Scenario.read(tmp_path)
    assert scenario.success.min_lift == 0.15
    assert len(scenario.success.signal) == 1


def test_every_key_and_column_of_a_scenario_is_named():
    keys = {entry.name for entry in (*fields(Scenario), *fields(Success))}
    text = " ".join(page.read_text(encoding="utf-8") for page in SCENARIO.parent.glob("*.md"))
    missing = {key for key in keys if not re.search(rf"\b{key}\b", text)}
    assert missing <= {"name", "table", "input_table", "folder"}  # none is in a scenario's file
    table = SCENARIO.read_text(encoding="utf-8").partition("| column | meaning |")[2]
    assert all(f"`{column}`" in table for column in COLUMNS)


def headings(text: str) -> set[str]:
    """Anchors of a page's headings."""
    found = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in found}


@pytest.mark.parametrize("name", ["README.md", "SECURITY.md", "CONTRIBUTING.md"])
def test_every_link_leads_somewhere(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    for target, _, anchor in re.findall(r"\]\((?!https?://)([^)#]*)(#([^)]+))?\)", text):
        assert not target or (ROOT / target).exists(), target
        if anchor and (not target or target.endswith(".md")):
            page = (ROOT / target).read_text(encoding="utf-8") if target else text
            assert anchor in headings(page), f"{target}#{anchor}"


# The examples run as they stand: four ways to use the project, from own parts to a kept result.


EXAMPLES = ROOT / "scenarios" / "examples"
EXAMPLE_LIMIT = 500.0  # [s]


@pytest.fixture(autouse=True)
def activated(monkeypatch):
    """Find programs as in an activated environment."""
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)


def executed(name: str, folder: Path) -> dict[str, dict[str, str]]:
    """Run a notebook; by each cell's last line, what it shows and prints, by kind."""
    pytest.importorskip("pandas")
    notebook = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    place = {"metadata": {"path": folder}}
    NotebookClient(notebook, timeout=EXAMPLE_LIMIT, resources=place).execute()
    shown: dict[str, dict[str, str]] = {}
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            told = shown.setdefault(cell.source.splitlines()[-1], {})
            told["text/plain"] = told.get("text/plain", "") + output.get("text", "")
            told |= output.get("data", {})
    return shown


@pytest.mark.long
def test_the_notebook_runs_and_shows_what_it_says(tmp_path):
    shown = executed("first_steps", tmp_path)
    for last in ("run", "run.view(height=480)", "compared"):
        assert "text/html" in shown[last]
    assert "image/png" in shown["run.plot()"]
    tables = [data.get("text/plain", "") for data in shown.values()]
    # With the scenario's gain; with half of it the hand lags.
    assert any("success" in table and "missed" in table for table in tables)


@pytest.mark.long
def test_a_law_of_ones_own_is_analysed_and_kept_by_a_test(tmp_path):
    said = executed("own_law", tmp_path)
    assert "2 passed" in said["!{sys.executable} -m pytest -q test_my_task.py"]["text/plain"]
    margins = said["analysis.margins.disk_margin, stiff.margins.disk_margin"]["text/plain"]
    usual, stiff = literal_eval(margins)
    assert 0 < stiff < usual <= 2
    assert (tmp_path / "my_task" / "reference.parquet").exists()


@pytest.mark.long
def test_an_lqr_of_the_measured_plant_has_margins_that_runs_confirm(tmp_path):
    pytest.importorskip("slycot")
    shown = executed("lqr", tmp_path)
    assert shown["run.summary.success"]["text/plain"] == "True"
    assert float(shown["float(abs(plant.poles()).max())"]["text/plain"]) > 1.0  # gravity
    held = shown["analysis.margins.delay_margin_ms, {each.verdict for each in analysis.confirmed}"]
    delay, verdicts = literal_eval(held["text/plain"])
    assert delay > 4.0
    assert verdicts == {"confirmed"}
    assert "text/html" in shown["analysis"]
    assert "image/png" in shown["analysis.plot(impedance=before)"]


# By script, what it prints, in this order.
SCRIPTS = {
    "foreign_arm": ["elbow_arrives", "1 of 1 scenarios match"],
    "nightly": ["6 passed", "6 of 6 scenarios and sweeps pass", "6 of 6 scenarios match"],
    "paper_figure": ["fig.pdf", "kp_8.mat"],
    "wall": ["geom wall: the finger pads pass through it", "unwanted contacts have up to",
             "it runs, but has the", "it can run (rehearsed in memory)", "Success: "],
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_runs_and_says_what_it_shows(name, tmp_path):
    pytest.importorskip("gymnasium")
    said = ran(["sh", EXAMPLES / f"{name}.sh", tmp_path / "new"], timeout=EXAMPLE_LIMIT).stdout
    assert re.search(".*".join(map(re.escape, SCRIPTS[name])), said, re.S), said


def test_the_reference_says_where_the_scenes_objects_are():
    model = load_scene(PlantParameters())
    table = model.geom("table")
    text = SCENARIO.read_text(encoding="utf-8")
    described = PLANT.variable("scene").description
    for geom in (table, model.geom("obj_geom")):
        size = " x ".join(f"{2 * half:g}" for half in geom.size)
        assert f"{size} m" in text
        assert f"{size} m" in described
    place = model.body("work_space").pos
    assert f"around ({place[0]:g}, {place[1]:g}) m" in described
    ends = zip("xy", place, table.size, strict=False)
    spans = [f"{axis} {at - half:g} to {at + half:g}" for axis, at, half in ends]
    assert f"{', '.join(spans)}, top at z = {2 * table.size[2]:g} m" in text
    at = ", ".join(f"{c:g}" for c in model.body("obj").pos)
    assert f"{model.body('obj').mass[0]:g} kg | centre at ({at}) m" in text


@pytest.mark.long
def test_a_scene_with_a_wall_is_pushed_by_hand_and_kept(tmp_path):
    executed("wall", tmp_path)
    (drawn,) = (tmp_path / "runs").glob("*/video.mp4")
    assert json.loads((drawn.parent / "summary.json").read_text())["as_expected"]
    kept = load_scenario(tmp_path / "pushed")
    (push,) = kept.push
    assert (push.start, push.duration, push.force) == (0.5, 0.2, (0.0, 30.0, 0.0))
    shutil.rmtree(tmp_path / "runs")
