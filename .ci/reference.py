"""What pages of docs/ take from the code: `python .ci/reference.py` renews it in the repository.

Where a page says `<!-- made: NAME -->`, the function NAME puts what the code says. What ends with
`<!-- end: NAME -->` also stands in the repository, where a test compares it.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import panda_cosim
from panda_cosim.cli.app import load
from panda_cosim.cli.commands import COMMANDS, ELSEWHERE
from panda_cosim.cli.commands.info import variables_markdown
from panda_cosim.fmus.interface.franka import FRANKA
from panda_cosim.fmus.interface.sensors import SENSORS
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.result.judging.definitions import DEFINITIONS
from panda_cosim.task.rules import AT_TOP, OF_ARM, OF_HAND, OF_MODELS, RULES

DOCS = Path(__file__).parents[1] / "docs"
MADE: Final = re.compile(r"<!-- made: (\w+) -->(?:.*?(<!-- end: \1 -->))?", re.S)
WIDTH: Final = 80  # of a call on one line
SECTIONS: Final = re.compile(r"^(Args|Attributes|Returns|Raises):\n", re.M)


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
    found = map(", ".join, (OF_ARM, OF_HAND, OF_MODELS, [key for _, key in AT_TOP]))
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
        for name, it in {**INTERFACES, "sensors": SENSORS, "franka": FRANKA}.items()
    )


def python() -> str:
    """Describe the public names, from their docstrings, with links between them."""
    public = {name: getattr(panda_cosim, name) for name in panda_cosim.__all__ if name[0] != "_"}
    rows = [(_linked(f"`{name}`", public), _first(each)) for name, each in public.items()]
    parts = [_described(name, each, public) for name, each in public.items()]
    return "\n\n".join([table(["name", "what it is"], rows), *parts])


def _first(value: object) -> str:
    return (inspect.getdoc(value) or "").partition("\n")[0]


def _described(name: str, value: Any, public: Mapping[str, object]) -> str:
    """Describe a function, or a class with its public members, those that it inherits, too."""
    title = name if inspect.isclass(value) else f"Function {name}"  # `sweep` makes a `Sweep`
    parts = [f"## {title}", *_entry(name, value, public)]
    for member, each in _members(value) if inspect.isclass(value) else ():
        parts += [f"### {name}.{member}", *_entry(f"{name}.{member}", each, public)]
    return "\n\n".join(parts)


def _members(value: type) -> Iterator[tuple[str, Any]]:
    ours = [base for base in value.__mro__ if base.__module__.startswith("panda_cosim")]
    found = {name: each for base in ours for name, each in reversed(vars(base).items())}
    for name in reversed(found):
        each = inspect.getattr_static(value, name)
        is_shown = inspect.isroutine(each) or isinstance(each, (property, cached_property))
        if name[0] != "_" and is_shown and inspect.getdoc(each):
            yield name, each


def _entry(name: str, value: Any, public: Mapping[str, object]) -> Iterator[str]:
    call = value.__func__ if isinstance(value, classmethod) else value
    is_error = inspect.isclass(call) and issubclass(call, Exception)
    if callable(call) and not is_error:
        yield f"```py\n{name}{_signature(call)}\n```"
    text = inspect.getdoc(value) or ""
    before, *rest = SECTIONS.split(text)
    yield _linked(before.strip(), public)
    for title, items in zip(rest[::2], rest[1::2], strict=True):
        yield f"**{title}**\n\n{_linked(_items(items), public)}"


def _signature(call: Callable[..., Any]) -> str:
    """Return names, types and defaults; a class's without types, which are long."""
    signature, is_class = inspect.signature(call), inspect.isclass(call)
    given = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
    if is_class:
        given = [each.replace(annotation=each.empty) for each in given]
    plain = (re.sub(r": '([^']*)'", r": \1", str(each)) for each in given)
    shown = [each.replace("'", '"') for each in plain]
    named = [each.kind is each.KEYWORD_ONLY for each in given]
    if True in named and not any(each.kind is each.VAR_POSITIONAL for each in given):
        shown.insert(named.index(True), "*")
    returned = "" if is_class else signature.return_annotation
    arrow = f" -> {returned}" if isinstance(returned, str) and returned not in ("", "None") else ""
    line = f"({', '.join(shown)}){arrow}"
    wide = ",\n".join(f"    {each}" for each in shown)
    return line if len(line) < WIDTH else f"(\n{wide},\n){arrow}"


def _items(text: str) -> str:
    """Return the entries of a section as a list: `name: text`, or a text alone."""
    lines = inspect.cleandoc(text)
    joined = re.sub(r"\n +", " ", lines).splitlines()
    return "\n".join(re.sub(r"^([\w.]+):", r"- `\1`:", line) for line in joined if line)


def _linked(text: str, public: Mapping[str, object]) -> str:
    """Let public names in a text lead to where they are described."""
    parts = re.split(r"(\n\n {4}.*?(?=\n\n\S|\Z))", text, flags=re.S)  # blocks of code

    def link(match: re.Match[str]) -> str:
        name, _, member = match[1].partition(".")
        is_known = name in public and (not member or hasattr(public[name], member))
        anchor = name.lower() if inspect.isclass(public.get(name)) else f"function-{name}"
        return f"[`{match[1]}`](#{anchor}{member})" if is_known else match[0]

    return "".join(re.sub(r"`(\w+(?:\.\w+)?)`", link, part) if i % 2 == 0 else part
                   for i, part in enumerate(parts))  # fmt: skip


def filled(text: str, makers: Mapping[str, Callable[[], str]]) -> str:
    """Return a page with what its makers say; the others' places stay as they are."""

    def made(match: re.Match[str]) -> str:
        if match[1] not in makers:
            return match[0]
        end = f"\n\n{match[2]}" if match[2] else ""
        return f"<!-- made: {match[1]} -->\n\n{makers[match[1]]()}{end}"

    return MADE.sub(made, text)


MAKERS: Final = {f.__name__: f for f in (commands, definitions, margins, python, rules, variables)}
KEPT: Final = ("commands", "python")  # what stands in the repository


def main() -> None:
    """Renew what stands in the repository, or say with --check which pages are not renewed."""
    old = []
    for page in DOCS.rglob("*.md"):
        before = page.read_text(encoding="utf-8")
        after = filled(before, {name: MAKERS[name] for name in KEPT})
        old += [f"{page}: python .ci/reference.py renews it"] if after != before else []
        if "--check" not in sys.argv:
            page.write_text(after, encoding="utf-8")
    if "--check" in sys.argv:
        sys.exit("\n".join(old) or 0)


if __name__ == "__main__":
    main()
