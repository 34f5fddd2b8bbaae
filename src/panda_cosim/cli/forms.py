"""How arguments and options are written: `option("--out -o DIR", "Folder for the results.")`."""

from __future__ import annotations

from typing import Any

import typer


def option(form: str, words: str, default: Any = None, **more: Any) -> Any:
    """Return an option of this form, such as `--out -o DIR`, with its help."""
    names = [name for name in form.split() if name.startswith("-")]
    metavar = " ".join(word for word in form.split() if word not in names) or None
    return typer.Option(default, *names, metavar=metavar, help=words, **more)


def flag(name: str, words: str) -> Any:
    """Return an option without a value, which is off unless it is given."""
    return option(name, words, False)


def argument(metavar: str, words: str, default: Any = ..., **more: Any) -> Any:
    """Return an argument with its help; without a default, it is required."""
    return typer.Argument(default, metavar=metavar, help=words, **more)


def scenario_argument(words: str, default: Any = ...) -> Any:
    """Return an argument that takes a scenario; the shell completes the shipped ones."""

    def shipped() -> list[str]:
        from ..task.scenario import shipped_scenarios  # noqa: PLC0415 - slow, and no help needs it

        return list(shipped_scenarios())

    return argument("SCENARIO", words, default, autocompletion=shipped)
