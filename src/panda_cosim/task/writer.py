"""Writes a scenario's two files, so that reading them gives an equal scenario, and new ones."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike
from pydantic import TypeAdapter

from ..fmus.atomic import check_replaceable, write_whole
from ..fmus.errors import InputError, refuse
from .files import csv_text, write_all
from .scenario import KEYS, SCENARIO_FILE, TABLE_FILE, Scenario, shipped_scenarios
from .trajectory import COMMANDS, POSTURE_COMMANDS

TEMPLATE: Final = Path(__file__).parent / "template"  # files of a new scenario
_SCENARIO: Final = TypeAdapter(Scenario)
INPUTS_FILE: Final = "inputs.csv"
_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,199}", re.A)


@dataclass(frozen=True)
class Addition:
    """What an option adds to a new scenario; writer.toml says what the fields are."""

    files: Sequence[str]
    settings: str = ""
    fmus: str = ""
    end: str = ""


ADDITIONS: Final = {name: Addition(**row) for name, row in _TABLES.items()}


def make_scenario(
    folder: Path, parts: Collection[str] = (), copied: str | None = None
) -> list[Path]:
    """Make the files of a new scenario, which can be run without changes, and return them."""
    # The folder's name becomes the scenario's. `parts` of `ADDITIONS` are added to the
    # template, or a sweep to the shipped scenario that is copied, without its reference.
    check_name(folder)
    sources = _template(parts) if copied is None else _shipped(copied)
    contents = {folder / name: text for name, text in sources.items()}
    for name in (name for part in parts for name in ADDITIONS[part].files):
        contents[folder / name] = (TEMPLATE / name).read_text(encoding="utf-8")
    write_all(contents)
    return list(contents)


def check_name(folder: Path) -> None:
    """Refuse a folder's name that cannot be a scenario's."""
    if not _NAME.fullmatch(folder.name):
        must = "must be at most 200 letters, digits, _ . and -, and not begin with a sign"
        refuse("scenario name", folder.name, must)


def _template(parts: Collection[str]) -> dict[str, str]:
    """Return settings that name the parts, and the table unless a client moves the arm, by file."""
    added = [each for name, each in ADDITIONS.items() if name in parts]
    file = next((each.settings for each in added if each.settings), SCENARIO_FILE)
    settings, table = ((TEMPLATE / name).read_text(encoding="utf-8") for name in (file, TABLE_FILE))
    if "franka" in parts:
        return {SCENARIO_FILE: settings}
    head, fmus = "[fmus]\n", "".join(each.fmus for each in added)
    if fmus and head not in settings:
        settings = f"{settings}\n{head}"
    settings = settings.replace(head, head + fmus) + "".join(each.end for each in added)
    return {SCENARIO_FILE: settings, TABLE_FILE: table}


def _shipped(name: str) -> dict[str, str]:
    """Return the text files of a shipped scenario; a reference is of its own results alone."""
    shipped = shipped_scenarios()
    if name not in shipped:
        refuse("--from", name, f"must be a shipped scenario: {', '.join(shipped)}", shipped)
    paths = [path for path in sorted(shipped[name].iterdir()) if path.is_file()]
    return {p.name: p.read_text(encoding="utf-8") for p in paths if p.suffix != ".parquet"}


def write_scenario(scenario: Scenario, folder: Path) -> None:
    """Write a scenario's folder."""
    # Files that it was read from are copied, with their comments, if they still describe it.
    written = {folder / SCENARIO_FILE: settings_text(scenario)}
    if scenario.table is not None:
        written[folder / TABLE_FILE] = scenario.table.text
    if scenario.input_table.columns:
        written[folder / INPUTS_FILE] = scenario.input_table.text
    write_all(_original(scenario, folder) or written)


def _original(scenario: Scenario, folder: Path) -> dict[Path, str] | None:
    if scenario.folder is None:
        return None
    with suppress(InputError, OSError, ValueError):  # changed or removed since
        if Scenario.read(scenario.folder) == scenario:
            names = (SCENARIO_FILE, TABLE_FILE, *filter(None, [scenario.inputs.get("file")]))
            files = ((folder / str(name), scenario.folder / str(name)) for name in names)
            return {new: old.read_bytes().decode("utf-8") for new, old in files if old.exists()}
    return None


def settings_text(scenario: Scenario) -> str:
    """Return the text of scenario.toml: the keys that differ from their defaults."""
    given = _SCENARIO.dump_python(scenario, by_alias=True, exclude_defaults=True, include={*KEYS})
    given["inputs"] = {name: each for name, each in scenario.inputs.items() if name != "file"}
    if scenario.input_table.columns:
        given["inputs"]["file"] = INPUTS_FILE
    return "\n".join(_section(given)) + "\n"


def _section(values: Mapping[str, Any], *path: str) -> Iterator[str]:
    """Yield the lines of a section: its plain values, then those of the sections in it."""
    inner = {name: each for name, each in values.items() if _has_sections(each)}
    yield from _lines({name: each for name, each in values.items() if name not in inner})
    for name, each in inner.items():
        head = ".".join((*path, _key(name)))
        if isinstance(each, tuple):
            for item in each:
                yield from ("", f"[[{head}]]", *_lines(item))
        elif each or path:  # an FMU that is named with no values is named again
            yield from ("", f"[{head}]", *_section(each, *path, _key(name)))


def _has_sections(value: object) -> bool:
    """Whether a value, or each item of it, has keys."""
    return isinstance(value[0] if value and isinstance(value, tuple) else value, Mapping)


def _lines(values: Mapping[str, object]) -> Iterator[str]:
    return (f"{_key(name)} = {_literal(value)}" for name, value in values.items())


def _key(name: str) -> str:
    return name if name.isidentifier() and name.isascii() else _literal(name)


def _literal(value: object) -> str:
    """Return a value as TOML; a float's repr keeps its bits."""
    if isinstance(value, bool | str):  # one printable line, where JSON's escapes are TOML's
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_literal, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(_lines(value))} }}"
    return repr(value)


def write_input_csv(
    path: Path, times: ArrayLike, commands: ArrayLike, *, overwrite: bool = False
) -> None:
    """Write commands (n, 14 or 28) at times (n,) [s] as an input file of `fmpy simulate`."""
    check_replaceable(path, overwrite=overwrite)
    names = ("time", *(*COMMANDS, *POSTURE_COMMANDS)[: np.shape(commands)[1]])
    rows = np.column_stack([times, commands]).tolist()
    write_whole(path, csv_text([names, *rows]))
