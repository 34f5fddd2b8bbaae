"""How arguments and options are written: `option("--out -o DIR")`, and its text in a docstring.

A command's docstring ends with a section `Args` (a module's with `Attributes`), which has the texts
by the names of the options in Python: `out: Folder for the results.`
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from inspect import cleandoc
from typing import Any

import typer
from typer.models import ParameterInfo

_ENTRY = re.compile(r"^ {4}(\w+): (.+(?:\n {5,}.+)*)", re.M | re.A)


def option(form: str, default: Any = None, **more: Any) -> Any:
    """Return an option of this form, such as `--out -o DIR`."""
    names = [name for name in form.split() if name.startswith("-")]
    metavar = " ".join(word for word in form.split() if word not in names) or None
    return typer.Option(default, *names, metavar=metavar, **more)


def flag(name: str) -> Any:
    """Return an option without a value, which is off unless it is given."""
    return option(name, False)


def argument(metavar: str, default: Any = ..., **more: Any) -> Any:
    """Return an argument; without a default, it is required."""
    return typer.Argument(default, metavar=metavar, **more)


def scenario_argument(default: Any = ...) -> Any:
    """Return an argument that takes a scenario; the shell completes the shipped ones."""

    def shipped() -> list[str]:
        from ..task.scenario import shipped_scenarios  # noqa: PLC0415 - slow, and no help needs it

        return list(shipped_scenarios())

    return argument("SCENARIO", default, autocompletion=shipped)


def described(values: Mapping[str, Any], docstring: str | None) -> str:
    """Give the options among values their texts, and return the docstring without these.

    Raises:
        TypeError: An option has no text, or a text belongs to no option that has none yet.
    """
    before, *listed = re.split(r"\n(?:Args|Attributes):\n", cleandoc(docstring or ""))
    texts = dict(_ENTRY.findall("".join(listed)))
    infos = {name: each for name, each in values.items() if isinstance(each, ParameterInfo)}
    untold = {name for name, info in infos.items() if info.help is None}
    if wrong := untold ^ texts.keys():
        raise TypeError(f"{', '.join(wrong)}: must be an option with one text in {before!r}")
    for name in untold:
        infos[name].help = " ".join(texts[name].split())
    return before.rstrip()
