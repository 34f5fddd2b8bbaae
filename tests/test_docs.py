"""README and site: each block is run from its page, and each page says for whom it is.

A block in sh or Python is run, another one is written to the file that is named in the line before,
and `<!-- not run: WHY -->` before a block says why not. `# exit code 3` at a line's end is what it
must end with, `Ctrl-C` how. Lines of a block of text must be in what the block before has printed.
"""

from __future__ import annotations

import os
import re
import runpy
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from panda_cosim.cli.app import load
from panda_cosim.cli.commands import COMMANDS, ELSEWHERE

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
TUTORIALS = [page for page in PAGES if page.parent.name == "learn"]
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


def blocks(page: Path) -> list[Block]:
    return [
        Block(it["kind"], it["text"], it["file"] or "", it["why"] or "")
        for it in BLOCK.finditer(page.read_text(encoding="utf-8"))
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
    assert page.read_text(encoding="utf-8").count("\n```") == 2 * len(blocks(page))
    assert all(is_run(it) or it.file or it.why or it.kind == "text" for it in blocks(page))


def test_there_are_six_tutorials_with_commands():
    assert len(TUTORIALS) == 6
    assert all(any(map(is_run, blocks(page))) for page in TUTORIALS)


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
    lines = page.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MOST_LINES
    title = next(number for number, line in enumerate(lines) if line.startswith("# "))
    assert lines[title + 2].startswith("For ")


def test_every_page_is_in_the_menu():
    menu = (ROOT / "zensical.toml").read_text(encoding="utf-8")
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    assert pages == set(re.findall(r'"([\w/-]+\.md)"', menu))


def test_the_site_is_checked(tmp_path, monkeypatch):
    pytest.importorskip("html5lib", reason="needs the extra docs")
    monkeypatch.syspath_prepend(ROOT / ".ci")
    check = runpy.run_path(str(ROOT / ".ci" / "build_site.py"))["check"]
    head = "<!DOCTYPE html><title>T</title>"
    page = tmp_path / "a.html"
    page.write_text(f'{head}<p id="top"><a href="b.html#end">b</a> <a href="#top">top</a></p>')
    (tmp_path / "b.html").write_text(f'{head}<h1 id="end">B</h1><a href="https://x.org">x</a>')
    assert not [*check(tmp_path)]
    for fault, message in {
        "<p><b>bold</p>": "unexpected-end-tag",
        '<a href="c.html">c</a>': "no such file: c.html",
        '<a href="b.html#middle">b</a>': "no such place: b.html#middle",
        '<img src="https://x.org/i.png" alt="i">': "needs the network",
        '<i id="top"></i><i id="top"></i>': "two ids top",
    }.items():
        page.write_text(f"{head}{fault}")
        assert any(message in problem for problem in check(tmp_path)), fault


def test_a_page_of_the_gallery_has_a_title():
    report = runpy.run_path(str(ROOT / ".ci" / "gallery.py"))["REPORT"]
    page = report.render(title="T", text="For all", paths=["a.html"], lines=["panda-cosim run"])
    assert page.startswith("---\nhide: [toc]\n---\n\n# T\n\nFor all\n")
