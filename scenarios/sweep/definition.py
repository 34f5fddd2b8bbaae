"""A sweep's definition: from a TOML file, Python or `--vary`."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Final, Self

from pydantic import BeforeValidator, PlainValidator

from ...fmus.errors import InputError
from ...fmus.interface.parameters import literal
from ...fmus.messages import excerpt
from ..fields import Choice, Line, check_keys, checked, field_names
from ..files import read_text
from ..scenario.scenario import shipped_scenarios
from .distribution import Distribution, read_distribution

DESIGNS: Final = ("grid", "random", "latin-hypercube", "sobol", "list", "search")
GOALS: Final = ("fail", "best")
MAX_SAMPLES: Final = 10_000_000
SHIPPED_FOLDER: Final = Path(__file__).parent / "library"
_MAX_BYTES = 65_536
_KEEP = re.compile(r"none|failures|all|worst:[1-9]\d{0,4}")


def _whole(low: int, high: int) -> PlainValidator:
    def check(value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ValueError(f"value {excerpt(value)}; must be a whole number, {low} to {high}")
        return value

    return PlainValidator(check)


def _names(value: object) -> tuple[str, ...]:
    names = [value] if isinstance(value, str | Path) else value
    if not isinstance(names, list | tuple) or not names:
        raise ValueError(f"value {excerpt(value)}; must be a scenario's name or folder, or several")
    if len({str(name) for name in names}) != len(names):
        raise ValueError(f"value {excerpt(value)}; names must differ")
    return tuple(Line()(str(name)) for name in names)


def _vary(value: object) -> dict[str, Distribution]:
    if not isinstance(value, Mapping):
        raise ValueError('must be sections [vary."KEY"]')
    varied = {}
    for key, section in sorted(value.items()):  # whose order in the file means nothing
        try:
            is_read = isinstance(section, Distribution)
            varied[str(key)] = section if is_read else read_distribution(section)
        except (ValueError, InputError) as error:
            is_nested = isinstance(section, Mapping) and any(
                isinstance(each, Mapping) for each in section.values()
            )
            problem = "a key with dots or brackets needs quotes" if is_nested else error
            raise ValueError(f"{key}: {problem}") from None
    return varied


def _keep(value: object) -> str:
    if isinstance(value, str) and _KEEP.fullmatch(value):
        return value
    raise ValueError(f"value {excerpt(value)}; must be none, failures, worst:20 or all")


def _path(value: object) -> Path | None:
    return None if value is None else Path(Line()(str(value)))


@checked
class Sweep:
    """Which values vary, how they are drawn, and which recordings are kept.

    Raises:
        InputError: A value cannot be used; the message names key, value and bound.
    """

    scenario: Annotated[tuple[str, ...], PlainValidator(_names)]
    vary: Annotated[Mapping[str, Distribution], PlainValidator(_vary)] = field(default_factory=dict)
    design: Annotated[str, Choice(DESIGNS)] = "sobol"
    samples: Annotated[int, _whole(0, MAX_SAMPLES)] = 0
    seed: Annotated[int, _whole(0, 2**32 - 1)] = 0
    keep: Annotated[str, PlainValidator(_keep)] = "none"
    file: Annotated[Path | None, BeforeValidator(_path)] = None  # CSV of design "list"
    goal: Annotated[str, Choice(GOALS)] = "fail"  # of a search
    criterion: Annotated[str, Line()] = ""  # whose margin is searched; "": the smallest

    def __post_init__(self) -> None:
        """Check what concerns several keys."""
        if (self.design == "list") != (self.file is not None):
            raise ValueError('file: goes with design = "list", which needs it')
        if self.design == "list" and self.vary:
            raise ValueError(
                'vary: cannot be combined with design = "list"; the file has the values'
            )
        if self.design != "list" and not self.vary:
            raise ValueError('vary: nothing is varied; must have sections [vary."KEY"]')
        if self.design in ("grid", "list") and self.samples:
            raise ValueError(f'samples: cannot be combined with design = "{self.design}"')
        if self.design not in ("grid", "list") and self.samples < 1:
            raise ValueError(
                f'samples: value {self.samples}; must be at least 1 for "{self.design}"'
            )
        if self.design != "search" and (self.criterion or self.goal != GOALS[0]):
            raise ValueError('goal and criterion: only go with design = "search"')
        if self.design == "search" and len(self.scenario) > 1:
            raise ValueError("scenario: a search has one")

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a sweep's file; paths in it are relative to its folder.

        Raises:
            InputError: The file cannot be used.
        """
        path = Path(path)
        text = read_text(path, _MAX_BYTES)
        try:
            keys = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: {error}; must be TOML") from None
        try:
            check_keys("", keys, field_names(cls))
            return cls(**_resolved(keys, path.parent))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None


def _resolved(keys: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Make the paths of a file absolute; names of shipped scenarios stay."""
    resolved = dict(keys)
    if isinstance(file := keys.get("file"), str):
        resolved["file"] = os.path.realpath(folder / file)
    names = keys.get("scenario")
    if isinstance(names, str | list):
        shipped = shipped_scenarios()
        resolved["scenario"] = [
            str((folder / name).resolve())
            if isinstance(name, str) and name not in shipped and (folder / name).is_dir()
            else name
            for name in ([names] if isinstance(names, str) else names)
        ]
    return resolved


def shipped_sweeps() -> dict[str, Path]:
    """Return the files of the shipped sweeps by name."""
    return {path.stem: path for path in sorted(SHIPPED_FOLDER.glob("*.toml"))}


def load_sweep(name_or_file: str | Path) -> Sweep:
    """Load a shipped sweep by name, or any from its file."""
    shipped = shipped_sweeps()
    if isinstance(name_or_file, str) and name_or_file in shipped:
        return Sweep.read(shipped[name_or_file])
    if not Path(name_or_file).is_file():
        raise InputError(
            f"sweep {excerpt(str(name_or_file))}: no file of that name; must be a sweep's TOML "
            f"file, one of {', '.join(shipped)}, or a scenario with --vary KEY=LOW:HIGH:STEPS"
        )
    return Sweep.read(name_or_file)


def sweep_of(scenario: str, vary: Sequence[str]) -> Sweep:
    """Return the grid that `SCENARIO --vary KEY=LOW:HIGH:STEPS` means; also `KEY=1,2,3`."""
    varied: dict[str, dict[str, Any]] = {}
    for text in vary:
        key, values = _parse_vary(text)
        if key in varied:
            raise InputError(f"--vary {excerpt(text)}: {key} is varied twice; must be given once")
        varied[key] = values
    return Sweep(scenario=(scenario,), vary=varied, design="grid")  # type: ignore[arg-type]


def _parse_vary(text: str) -> tuple[str, dict[str, Any]]:
    key, _, values = text.partition("=")
    parts = values.split(":")
    if re.fullmatch(r"\s*[\d.]+\s*(-|\.\.)\s*[\d.]+\s*", values):  # a range in another notation
        parts = []
    try:
        if len(parts) == 3:
            ends = [float(part) for part in parts[:2]]
            return key.strip(), {"uniform": ends, "steps": int(parts[2])}
    except ValueError:
        parts = []
    if not key.strip() or len(parts) != 1 or not parts[0].strip():
        raise InputError(
            f"--vary {excerpt(text)}: must be KEY=LOW:HIGH:STEPS or KEY=V1,V2,..., such as "
            "plant.block_mass=0.05:2:100"
        )
    return key.strip(), {"values": [literal(part.strip()) for part in parts[0].split(",")]}
