"""Builds and checks the documentation site: `python .ci/build_site.py [--out site]`.

Pages are in docs/, the menu in zensical.toml; reference.py puts in what the code says.
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
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlsplit

import html5lib
from gallery import gallery
from reference import MAKERS, filled, table

ROOT = Path(__file__).parents[1]


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
        made = {**MAKERS, "history": history, "gallery": partial(gallery, docs)}
        if not with_gallery:
            made["gallery"] = str
        for page in docs.rglob("*.md"):
            page.write_text(filled(page.read_text(encoding="utf-8"), made), encoding="utf-8")
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
