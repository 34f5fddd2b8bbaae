"""A sweep's definition, from a TOML file, Python or `--vary`: which values vary, and how."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Self

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time
from pydantic import AfterValidator, PlainValidator

from ...assets.fields import Array
from ...fmus.errors import InputError, excerpt, located, refuse
from ...fmus.interface.parameters import literal
from ...task.fields import (
    Choice,
    Line,
    Quantity,
    Vector,
    Whole,
    check_keys,
    check_rules,
    checked,
    field_names,
)
from ...task.files import read_toml
from ...task.scenario import shipped_scenarios
from ...task.typed import typed

DESIGNS: Final = ("grid", "random", "latin-hypercube", "sobol", "list", "search")
SAMPLED: Final = ("random", "latin-hypercube", "sobol")  # designs whose rows are random samples
GOALS: Final = ("fail", "best")
KINDS: Final = ("uniform", "normal", "log-uniform", "values")
MAX_SAMPLES: Final = 10_000_000
MAX_STEPS: Final = 1_000_000
SHIPPED_FOLDER: Final = (Path(__file__).parents[2] / "scenarios" / "sweeps").resolve()
KEPT: Final = ("none", "failures", "all")
_STEPS: Final = 5  # of a grid where none are given


@dataclass(frozen=True)
class Distribution:
    """A distribution, given by its quantile function."""

    kind: str  # one of `KINDS`
    numbers: tuple[float, float] = (0.0, 0.0)  # both ends; of a normal, mean and deviation
    values: tuple[float | bool | str, ...] = ()  # choices of equal probability
    limits: tuple[float, float] | None = None  # where a normal is truncated; None: not at all
    steps: int = _STEPS  # points of a grid

    def quantiles(self, u: Array) -> Sequence[Any] | Array:
        """Return the values at cumulative probabilities u (n,), each within (0, 1)."""
        first, second = self.numbers
        if self.kind == "uniform":
            return first + (second - first) * u
        if self.kind == "log-uniform":
            return np.asarray(first * (second / first) ** u)
        if self.kind == "normal":
            limits = self.limits or (-math.inf, math.inf)
            low, high = scipy.special.ndtr((np.array(limits) - first) / second)
            drawn: Array = first + second * scipy.special.ndtri(low + (high - low) * u)
            return np.clip(drawn, *limits)
        picked = np.minimum((u * len(self.values)).astype(int), len(self.values) - 1)
        return [self.values[i] for i in picked]

    def ends(self) -> Sequence[Any]:
        """Return both ends of the range, or all choices; of a normal without limits, nothing."""
        if self.kind == "normal":
            return self.limits or ()
        return self.values or self.numbers

    def extremes(self) -> Sequence[Any] | Array:
        """Return both ends of a search's range, or all choices; of a normal, six sigma."""
        return self.ends() or self.quantiles(np.array([1e-9, 1.0 - 1e-9]))

    def grid(self) -> Sequence[Any] | Array:
        """Return the points of a grid: both ends included, or the middles of equal shares."""
        if self.kind == "values":
            return self.values
        if self.kind == "normal":
            return self.quantiles((np.arange(self.steps) + 0.5) / self.steps)
        return self.quantiles(np.linspace(0.0, 1.0, self.steps))


def read_distribution(section: object) -> Distribution:
    """Read a section [vary."key"]; a ValueError names the key in it."""
    if isinstance(section, Distribution):
        return section
    kinds = ", ".join(KINDS)
    if not isinstance(section, Mapping):
        raise ValueError(f"value {excerpt(section)}; must be a section with one of {kinds}")
    if any(isinstance(each, Mapping) for each in section.values()):
        raise ValueError("a key with dots or brackets needs quotes")
    check_keys("", section, (*KINDS, "limits", "steps"))
    named = [key for key in KINDS if key in section]
    if len(named) != 1:
        raise ValueError(f"has {', '.join(named) or 'none'}; must have exactly one of {kinds}")
    (kind,) = named
    if kind == "values":
        return Distribution(kind, values=_choices(section[kind]))
    numbers, limits = _pair(kind, section[kind]), None
    if "limits" in section:
        if kind != "normal":
            raise ValueError(f"limits: only valid with normal, not with {kind}")
        limits = _pair("limits", section["limits"])
    steps = Whole(2, MAX_STEPS).check("steps", section.get("steps", _STEPS))
    return Distribution(kind, numbers, limits=limits, steps=steps)


def _choices(values: object) -> tuple[float | bool | str, ...]:
    if not isinstance(values, list | tuple) or not values:
        raise ValueError(f"values: value {excerpt(values)}; must be a list of at least one value")
    return tuple(v if isinstance(v, bool | str) else Quantity().check("values", v) for v in values)


def _pair(kind: str, value: object) -> tuple[float, float]:
    first, second = Vector(2).check(kind, value)
    place = f"{kind}: value {excerpt(value)}; must be"
    check_rules({
        f"{place} [mean, standard deviation], that above 0": kind == "normal" and second <= 0.0,
        f"{place} [low, high], low below high": kind != "normal" and first >= second,
        f"{place} [low, high], low above 0": kind == "log-uniform" and first <= 0.0,
    })  # fmt: skip
    return first, second


def _names(value: object) -> tuple[str, ...]:
    names = [value] if isinstance(value, str | Path) else value
    if not isinstance(names, list | tuple) or not names:
        raise ValueError(f"value {excerpt(value)}; must be a scenario's name or folder, or several")
    return tuple(Line()(str(name)) for name in names)


@checked
class Sweep:
    """Which values vary, how they are drawn, and which recordings are kept.

    `load_sweep` reads it from a file, `sweep_of` from `--vary`. It says what to run; how, on how
    many processes or which cluster, are arguments of `sweep`.

    Raises:
        InputError: A value cannot be used; the message names key, value and bound.
    """

    scenario: Annotated[tuple[str, ...], PlainValidator(_names)]
    vary: Annotated[
        dict[str, Annotated[Distribution, PlainValidator(read_distribution)]],
        AfterValidator(lambda varied: dict(sorted(varied.items()))),  # their order means nothing
    ] = field(default_factory=dict)
    design: Annotated[str, Choice(DESIGNS)] = "sobol"
    samples: Annotated[int, Whole(0, MAX_SAMPLES)] = 0
    seed: Annotated[int, Whole(0, 2**32 - 1)] = 0
    keep: Annotated[str, Choice(KEPT)] = "none"
    file: Path | None = None  # CSV of design "list"
    goal: Annotated[str, Choice(GOALS)] = "fail"  # of a search
    criterion: Annotated[str, Line()] = ""  # whose margin is searched; "": the smallest
    min_success: Annotated[float, Quantity(0.0, 1.0)] = 0.0  # required success rate; 0: none
    # At which the lower bound of the success rate must reach it; 0: the share of rows itself must.
    confidence: Annotated[float, Quantity(0.0, 1.0)] = 0.0

    def __post_init__(self) -> None:
        """Check what concerns several keys."""
        is_list, is_search = self.design == "list", self.design == "search"
        is_sampled, sampled = self.design in SAMPLED, ", ".join(SAMPLED)
        check_rules({
            'file: required with design = "list", and only then': is_list != bool(self.file),
            'vary: sections required, but not with design = "list"': is_list == bool(self.vary),
            f"samples: required with search, {sampled}, alone":
                (is_search or is_sampled) != bool(self.samples),
            "scenario: a search has one": is_search and len(self.scenario) > 1,
            "min_success: a search has no success rate": is_search and self.min_success,
            "confidence: needs min_success": self.confidence and not self.min_success,
            f"confidence: needs random rows, of {sampled}": self.confidence and not is_sampled,
        })  # fmt: skip

    @classmethod
    @typed
    def read(cls, path: str | Path) -> Self:
        """Read a sweep's file; paths in it are relative to its folder.

        Raises:
            InputError: The file cannot be used.
        """
        path = Path(path)
        keys = read_toml(path)
        with located(path):
            check_keys("", keys, field_names(cls))
            return cls(**_from_folder(keys, path.parent))


def _from_folder(keys: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Read the paths of a file as relative to its folder; names of shipped scenarios stay."""

    def placed(name: Any) -> Any:
        is_folder = isinstance(name, str) and (folder / name).is_dir()
        return str(folder / name) if is_folder and name not in shipped_scenarios() else name

    resolved = dict(keys)
    if isinstance(file := keys.get("file"), str):
        resolved["file"] = folder / file
    if (names := keys.get("scenario")) is not None:
        resolved["scenario"] = [*map(placed, names)] if isinstance(names, list) else placed(names)
    return resolved


def shipped_sweeps() -> dict[str, Path]:
    """Return the files of the shipped sweeps by name."""
    return {path.stem: path for path in sorted(SHIPPED_FOLDER.glob("*.toml"))}


def load_sweep(name_or_file: str | Path) -> Sweep:
    """Load a shipped sweep by name, or any from its file."""
    shipped = shipped_sweeps()
    path = shipped.get(str(name_or_file), Path(name_or_file))
    if not path.is_file():
        must = f"must be a TOML file, one of {', '.join(shipped)}, or a scenario with --vary"
        refuse("sweep", str(name_or_file), f"{must} KEY=LOW:HIGH:STEPS", shipped)
    return Sweep.read(path)


def sweep_of(scenario: str, vary: Sequence[str]) -> Sweep:
    """Return the grid that `SCENARIO --vary KEY=LOW:HIGH:STEPS` means; also `KEY=1,2,3`."""
    varied: Any = dict(map(_parse_vary, vary))
    if len(varied) < len(vary):
        raise InputError("--vary: a key is varied twice; must be given once")
    return Sweep(scenario=(scenario,), vary=varied, design="grid")


def _parse_vary(text: str) -> tuple[str, dict[str, object]]:
    key, _, values = (part.strip() for part in text.partition("="))
    with suppress(ValueError):
        low, high, steps = values.split(":")
        return key, {"uniform": [float(low), float(high)], "steps": int(steps)}
    if not key or not values or ":" in values:
        must = "must be KEY=LOW:HIGH:STEPS or KEY=V1,V2,..., such as plant.block_mass=0.05:2:100"
        refuse("--vary", text, must)
    return key, {"values": [literal(part.strip()) for part in values.split(",")]}
