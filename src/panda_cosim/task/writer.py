"""Writes a scenario's two files, so that reading them gives an equal scenario, and new ones."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from ..fmus.atomic import check_replaceable, replacing
from ..fmus.errors import InputError, did_you_mean, excerpt
from .criteria import toml_keys
from .files import csv_text, write_all
from .scenario import KEYS, SCENARIO_FILE, TABLE_FILE, Scenario, shipped_scenarios
from .trajectory import COMMANDS, POSTURE_COMMANDS

TEMPLATE: Final = Path(__file__).parent / "template"  # files of a new scenario
INPUTS_FILE: Final = "inputs.csv"
FROM_TEMPLATE: Final = {  # files of the template that an option of `new` adds
    "law": ("my_law.py",),
    "plant": ("my_scene.xml", "my_scene.toml"),
    "slave": ("my_slave.py",),
    "sweep": ("sweep.toml",),
}
_FMUS: Final = {  # lines of the section [fmus]
    "plant": 'plant = "my_scene.xml"  # a scene of its own; my_scene.toml says what its FMU has\n',
    "slave": 'gust = "my_slave.py:Gust"  # a slave for PythonFMU\n',
}
_GUST: Final = '\n[connect]\n"plant.push_force[2]" = "convert(gust.force)"\n'

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,199}", re.A)
# Keys that are written if they say something.
_RARE = ("system", "step", "tolerance", "order", "timing", "timing_share", "route", "mujoco",
         "preflight", "input_scale")  # fmt: skip


def make_scenario(
    folder: Path, parts: Collection[str] = (), copied: str | None = None
) -> list[Path]:
    """Make the files of a new scenario, which can be run without changes, and return them."""
    # The folder's name becomes the scenario's. `parts` of `FROM_TEMPLATE` are added to the
    # template, or a sweep to the shipped scenario that is copied, without its reference.
    check_name(folder)
    sources = _template(parts) if copied is None else _shipped(copied)
    contents = {folder / name: text for name, text in sources.items()}
    for name in (name for part in parts for name in FROM_TEMPLATE[part]):
        contents[folder / name] = (TEMPLATE / name).read_text(encoding="utf-8")
    write_all(contents)
    return list(contents)


def check_name(folder: Path) -> None:
    """Refuse a folder's name that cannot be a scenario's."""
    if not _NAME.fullmatch(folder.name):
        raise InputError(
            f"scenario name {excerpt(folder.name)}: must be at most 200 letters, digits, _ . and "
            "-, and not begin with a sign"
        )


def _template(parts: Collection[str]) -> dict[str, str]:
    """Return settings that name the parts, and the table, by file."""
    file = "scenario_with_law.toml" if "law" in parts else SCENARIO_FILE
    settings, table = ((TEMPLATE / name).read_text(encoding="utf-8") for name in (file, TABLE_FILE))
    for part in (part for part in _FMUS if part in parts):
        head = "[fmus]\n"
        settings = settings if head in settings else f"{settings}\n{head}"
        settings = settings.replace(head, head + _FMUS[part])
    settings += _GUST if "slave" in parts else ""
    return {SCENARIO_FILE: settings, TABLE_FILE: table}


def _shipped(name: str) -> dict[str, str]:
    """Return the text files of a shipped scenario; a reference is of its own results alone."""
    shipped = shipped_scenarios()
    if name not in shipped:
        raise InputError(
            f"--from {excerpt(name)}: no shipped scenario; valid: {', '.join(shipped)}"
            f"{did_you_mean(name, shipped)}"
        )
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
    try:
        if Scenario.read(scenario.folder) != scenario:
            return None
        names = filter(None, (SCENARIO_FILE, TABLE_FILE, str(scenario.inputs.get("file", ""))))
        files = ((folder / name, scenario.folder / name) for name in names)
        return {new: old.read_bytes().decode("utf-8") for new, old in files if old.exists()}
    except (InputError, OSError, ValueError):  # changed or removed since
        return None


def settings_text(scenario: Scenario) -> str:
    """Return the text of scenario.toml."""
    values = {name: getattr(scenario, name) for name in KEYS}
    top = {n: v for n, v in values.items() if n == "order" or isinstance(v, bool | str | float)}
    for name in _RARE:
        if top[name] == getattr(Scenario, name):
            del top[name]
    success, tolerances = asdict(scenario.success), scenario.regression
    del success["signal"], success["body"]
    file = {"file": INPUTS_FILE} if scenario.input_table.columns else {}
    inputs = {**{n: v for n, v in scenario.inputs.items() if n != "file"}, **file}
    sections: list[tuple[str, Mapping[str, Any]]] = [
        *((f"[{name}]", values[name]) for name in ("fmus", "connect", "steps") if values[name]),
        *([("[inputs]", inputs)] if inputs else []),
        *((f"[parameters.{name}]", own) for name, own in scenario.parameters.items()),
        ("[plant]", scenario.plant),
        ("[controller]", scenario.controller),
        ("[mismatch]", scenario.mismatch.given),
        ("[success]", success),
        *(("[[success.body]]", asdict(each)) for each in scenario.success.body),
        *(("[[success.signal]]", toml_keys(each)) for each in scenario.success.signal),
        ("[regression]", {"time": tolerances.time, "scale": tolerances.scale, **tolerances.values}),
        *(("[[push]]", asdict(push)) for push in scenario.push),
    ]
    lines = [*_lines(top)]
    for head, content in sections:
        lines += ["", head, *_lines(content)]
    return "\n".join(lines) + "\n"


def _lines(values: Mapping[str, Any]) -> Iterator[str]:
    for name, value in values.items():
        if value is not None:
            key = name if name.isidentifier() and name.isascii() else _literal(name)
            yield f"{key} = {_literal(value)}"


def _literal(value: Any) -> str:
    """Return a value as TOML; a float's repr keeps its bits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):  # one printable line, where JSON's escapes are TOML's
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
    with replacing(path) as partial:
        partial.write_text(csv_text([names, *rows]), encoding="utf-8")
