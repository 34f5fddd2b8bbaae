"""Builds and checks the documentation site: `python .ci/build_site.py [--out site]`.

Pages are in docs/, the menu in zensical.toml. Where a page says `<!-- made: NAME -->`, the function
NAME puts what the code says.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urldefrag, urlsplit

import html5lib
from gallery import gallery

import panda_cosim
from panda_cosim.cli.app import load
from panda_cosim.cli.commands import COMMANDS, ELSEWHERE
from panda_cosim.cli.commands.info import variables_markdown
from panda_cosim.fmus.interface.sensors import SENSORS
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.result.judging.definitions import DEFINITIONS
from panda_cosim.task.rules import AT_TOP, OF_ARM, OF_MODELS, RULES

ROOT = Path(__file__).parents[1]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def commands() -> str:
    """Describe every command with its arguments and options, from its help."""
    order = [*COMMANDS]
    names = sorted({*COMMANDS, *ELSEWHERE}, key=lambda name: (order.index(name.split()[0]), name))
    return "\n\n".join(map(_command, names))


def _command(name: str) -> str:
    command = load(name)
    options = table(["option", "meaning", "default"], [*map(_option, command.params)])
    return f"## {name}\n\n{command.help}\n\n{options}"


def _option(parameter: Any) -> tuple[str, ...]:
    words = ", ".join(f"`{word}`" for word in (*parameter.opts, *parameter.secondary_opts))
    if parameter.param_type_name == "argument":
        words = f"`{parameter.metavar or parameter.name}`"
    elif parameter.metavar:
        words += f" {parameter.metavar}"
    default = parameter.default
    value = "" if default is None or default is False else "on" if default is True else str(default)
    cells = (words, parameter.help or "", value)
    return tuple(re.sub(r"\s+", " ", cell.replace("|", "\\|")) for cell in cells)


def definitions() -> str:
    """What each number of a run's summary is, and what each criterion bounds."""
    numbers = [
        (f"`{key}`", d.what, d.window.replace("all rows", ""),
         ", ".join(f"`{name}`" for name in d.signals), d.unmeasured)
        for key, d in DEFINITIONS.items() if not key.startswith(("success.", "analysis."))
    ]  # fmt: skip
    criteria = [
        (f"`{d.key.removeprefix('success.')}`", f"`{d.metric}`", d.unit)
        for d in DEFINITIONS.values()
        if d.metric
    ]
    return "\n\n".join((
        table(["key", "what it is", "rows", "signals", "null if"], numbers),
        table(["criterion", "bounds", "unit"], criteria),
    ))  # fmt: skip


def rules() -> str:
    """Return what keys of a scenario exclude or need each other."""
    found = iter((", ".join(OF_ARM), ", ".join(OF_MODELS), ", ".join(key for _, key in AT_TOP)))
    rows = []
    for text in RULES:
        said = re.sub(r" value \{0\.[^}]*\};?", "", text)
        key, _, rule = re.sub(r"\{1\}", lambda _: next(found), said).partition(": ")
        rows.append((f"`{key}`", rule))
    return table(["key", "rule"], rows)


def margins() -> str:
    """What each number of an analysis is."""
    rows = [
        (f"`{key.removeprefix('analysis.')}`", d.what, d.unmeasured)
        for key, d in DEFINITIONS.items()
        if key.startswith("analysis.")
    ]
    return table(["key", "what it is", "null if"], rows)


def variables() -> str:
    """Tables of the FMUs' variables."""
    return "\n\n".join(
        f"## {it.model}\n\nInstance `{name}`. {it.description}.\n\n{variables_markdown(it)}"
        for name, it in {**INTERFACES, "sensors": SENSORS}.items()
    )


def python() -> str:
    """Public names, for mkdocstrings."""
    modules = panda_cosim._MODULES
    names = (name for name in panda_cosim.__all__ if not name.startswith("_"))
    return "\n\n".join(f"::: panda_cosim.{modules[name]}.{name}" for name in names)


def history() -> str:
    """Return the lines of the nightly `bench`, the newest first."""
    texts = (ROOT / "docs" / "bench.jsonl").read_text(encoding="utf-8").splitlines()
    lines = [json.loads(text) for text in texts[::-1]]
    ratios = list(lines[0]["ratios"])
    return table(
        ["date", "commit", "machine", *ratios],
        [
            (line["date"][:10], line["commit"], f"{line['machine']['cores']} cores of "
             f"{line['machine']['processor']}", *(f"{line['ratios'][name]:.2f}" for name in ratios))
            for line in lines
        ],
    )  # fmt: skip


def overview() -> str:
    """Return the text of llms.txt: what the project is, and each page with its title."""
    project = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]
    lines = [f"# {project['site_name']}", f"> {project['site_description']}"]
    for part in project["nav"]:
        for title, pages in part.items():
            lines += [f"## {title}"] if isinstance(pages, list) else []
            listed = pages if isinstance(pages, list) else [part]
            links = [f"- [{name}]({page[:-3]}.html)" for it in listed for name, page in it.items()]
            lines.append("\n".join(links))
    return "\n\n".join(lines) + "\n"


def build(out: Path, *, with_gallery: bool) -> None:
    """Fill in the pages, build the site and check it."""
    with tempfile.TemporaryDirectory() as name:
        work, docs = Path(name), Path(name, "docs")
        shutil.copytree(ROOT / "docs", docs)
        (work / "src").symlink_to(ROOT / "src")
        made = {
            f.__name__: f
            for f in (commands, definitions, history, margins, python, rules, variables)
        }
        made["gallery"] = partial(gallery, docs) if with_gallery else str
        for page in docs.rglob("*.md"):
            text = page.read_text(encoding="utf-8")
            filled = re.sub(r"<!-- made: (\w+) -->", lambda match: made[match[1]](), text)
            page.write_text(filled, encoding="utf-8")
        shown = re.findall(r"(gallery/\w+)\.(?:html|md)", (docs / "gallery.md").read_text())
        pages = ["gallery.md", *(f"{page}.md" for page in shown)]
        menu = (ROOT / "zensical.toml").read_text(encoding="utf-8")
        menu = menu.replace('"gallery.md"', json.dumps(pages))
        (work / "zensical.toml").write_text(menu, encoding="utf-8")
        subprocess.run(
            [sys.executable, "-m", "zensical", "build", "--clean", "--strict"], cwd=work, check=True
        )
        shutil.rmtree(out, ignore_errors=True)
        shutil.move(work / "site", out)
        (out / "llms.txt").write_text(overview(), encoding="utf-8")
    if problems := [it for it in check(out) if with_gallery or "gallery/" not in it]:
        raise SystemExit("\n".join(problems))
    print(f"{out}/index.html")


def check(site: Path) -> Iterator[str]:
    """Yield what is wrong: HTML that is no HTML5, and links that lead nowhere or to other hosts."""
    anchors: dict[Path, set[str]] = {}
    links: list[tuple[Path, str, str]] = []
    for path in site.rglob("*.html"):
        parser = html5lib.HTMLParser(namespaceHTMLElements=False)
        tree = parser.parse(path.read_bytes())
        yield from (f"{path}: {line}: {code}" for (line, _), code, _ in parser.errors)
        identifiers = [element.get("id") for element in tree.iter() if element.get("id")]
        anchors[path] = set(identifiers)
        yield from (f"{path}: two ids {name}" for name, n in Counter(identifiers).items() if n > 1)
        links += [
            (path, element.tag, element.get(key))
            for element in tree.iter()
            for key in ("href", "src")
            if element.get(key)
        ]
    links += [(site / "llms.txt", "a", link) for link in re.findall(r"\]\((.*?)\)", overview())]
    for path, tag, link in links:
        url, anchor = urldefrag(link)
        parts = urlsplit(url)
        if parts.scheme or parts.netloc:
            if tag != "a" and parts.scheme != "data":
                yield f"{path}: <{tag}> needs the network: {link}"
            continue
        folder = site if parts.path.startswith("/") else path.parent
        target = (folder / unquote(parts.path).lstrip("/")).resolve() if parts.path else path
        if not target.is_file():
            yield f"{path}: no such file: {link}"
        elif anchor and target in anchors and unquote(anchor) not in anchors[target]:
            yield f"{path}: no such place: {link}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "site")
    parser.add_argument(
        "--no-gallery", action="store_true", help="leave out what has to be simulated"
    )
    options = parser.parse_args()
    build(options.out.resolve(), with_gallery=not options.no_gallery)
