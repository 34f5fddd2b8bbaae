"""The page around runs: data, code and style in one HTML file that asks nobody for anything.

Data are JSON in script elements of a type that no browser runs, and the page's code puts what it
finds there into the document as text. A content security policy allows the page's two scripts by
their digests and no request, so that nothing else would run if a text got through as HTML.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib.resources import files
from string import Template
from typing import Any, Final

from .columns import pack

TEMPLATE: Final = "template.html"
LOADER: Final = """
(async () => {
  const code = document.getElementById("view-code").textContent;
  const bytes = Uint8Array.from(atob(code), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const script = document.createElement("script");
  script.textContent = await new Response(stream).text();
  document.head.append(script);
  dispatchEvent(new Event("view-ready"));
})();
"""


@dataclass(frozen=True)
class Contents:
    """What a page holds.

    Attributes:
        title: Of the page.
        runs: Names of the runs that are shown first; the second is the ghost of the first.
        documents: All runs, as `run.describe` returns them.
        models: Their models by key, as `model.describe` returns them.
    """

    title: str
    runs: Sequence[str]
    documents: Sequence[Mapping[str, Any]] = ()
    models: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def page(contents: Contents) -> str:
    """Return the page as HTML."""
    data = data_elements(contents) + show_element({"runs": list(contents.runs)})
    return _filled(contents.title, data)


def live_page(title: str, run: Mapping[str, Any]) -> str:
    """Return the page of a simulation that goes on; it speaks to its own server alone.

    Args:
        title: Of the page.
        run: What the page's code takes for a live run (`LiveData` in live/source.ts).
    """
    return _filled(title, _data("live", run), "; connect-src 'self'")


def _filled(title: str, data: str, policy: str = "") -> str:
    # What is put into a place is not looked at again.
    return Template(_part(TEMPLATE)).substitute(
        title=escape(title),
        scripts=" ".join(script_sources()),
        more=policy,
        style=style(),
        data=data,
        code=code_elements(),
    )


def data_elements(contents: Contents) -> str:
    """Return the elements that hold runs and models; the page's code reads each when it has to."""
    models = [_data(f"model:{key}", model) for key, model in contents.models.items()]
    return "\n".join(models + [_data(f"run:{run['name']}", run) for run in contents.documents])


def show_element(shown: Mapping[str, Any]) -> str:
    """Return the element that says what is shown when the page is opened.

    Args:
        shown: `runs`: names; `at`: instant [s]; `part`: whether it is a part of a larger page.
    """
    return _data("show", shown)


def code_elements() -> str:
    """Return the elements that hold the page's code, deflated, and start it."""
    code = f'<script type="text/plain" id="view-code">{_packed_code()}</script>'
    return f"{code}\n<script>{LOADER}</script>"


def style() -> str:
    """Return the style sheet of a viewer."""
    return _part("view.css")


def script_sources() -> list[str]:
    """Return the sources of a content security policy under which the code runs."""
    digests = (hashlib.sha256(text.encode()).digest() for text in (LOADER, _part("view.js")))
    return [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]


def _data(name: str, value: Any) -> str:
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    safe = text.replace("<", "\\u003c").replace("\u2028", "\\u2028")
    return f'<script type="application/json" data-view="{escape(name)}">{safe}</script>'


@cache
def _part(name: str) -> str:
    return files(__package__).joinpath("page", name).read_text(encoding="utf-8")


@cache
def _packed_code() -> str:
    return pack(_part("view.js").encode())


__all__ = [
    "Contents",
    "code_elements",
    "data_elements",
    "live_page",
    "page",
    "script_sources",
    "show_element",
    "style",
]
