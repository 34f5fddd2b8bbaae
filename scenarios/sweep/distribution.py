"""Distributions of varied values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri  # of the normal distribution; scipy.stats loads for a second

from ...fmus.messages import excerpt
from ..fields import Quantity, check_keys

Array = NDArray[np.float64]

KINDS: Final = ("uniform", "normal", "log-uniform", "values")
MAX_STEPS: Final = 1_000_000
_MORE: Final = ("limits", "steps")
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
            return self._normal(u)
        picked = np.minimum((u * len(self.values)).astype(int), len(self.values) - 1)
        return [self.values[i] for i in picked]

    def _normal(self, u: Array) -> Array:
        mean, deviation = self.numbers
        if self.limits is not None:
            low, high = ndtr((np.array(self.limits) - mean) / deviation)
            u = low + (high - low) * u
        drawn: Array = mean + deviation * ndtri(u)
        return drawn if self.limits is None else np.clip(drawn, *self.limits)

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
    if not isinstance(section, Mapping):
        raise ValueError(f"value {excerpt(section)}; must be a section with one of {_list(KINDS)}")
    check_keys("", section, (*KINDS, *_MORE))
    kinds = [key for key in KINDS if key in section]
    if len(kinds) != 1:
        raise ValueError(f"has {_list(kinds) or 'none'}; must have exactly one of {_list(KINDS)}")
    kind = kinds[0]
    if kind == "values":
        return Distribution(kind, values=_values(section[kind]))
    numbers, steps = _pair(kind, section[kind]), section.get("steps", _STEPS)
    if isinstance(steps, bool) or not isinstance(steps, int) or not 2 <= steps <= MAX_STEPS:
        raise ValueError(f"steps: value {excerpt(steps)}; must be 2 to {MAX_STEPS}")
    if "limits" not in section:
        return Distribution(kind, numbers, steps=steps)
    if kind != "normal":
        raise ValueError(f"limits: goes with normal only, not with {kind}")
    limits = _pair("limits", section["limits"])
    low, high = ndtr((np.array(limits) - numbers[0]) / numbers[1])
    if not high - low > 1e-9:
        raise ValueError(f"limits: hold a share of {high - low:.1g} of the distribution")
    return Distribution(kind, numbers, (), limits, steps)


def _values(section: object) -> tuple[float | bool | str, ...]:
    if not isinstance(section, list | tuple) or not section:
        raise ValueError(f"values: value {excerpt(section)}; must be a list of at least one value")
    return tuple(v if isinstance(v, bool | str) else _number("values", v) for v in section)


def _pair(kind: str, value: object) -> tuple[float, float]:
    what = "mean and standard deviation" if kind == "normal" else "both ends, the lower first"
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError(f"{kind}: value {excerpt(value)}; must be {what}")
    first, second = (_number(kind, item) for item in value)
    if kind == "normal" and second <= 0.0:
        raise ValueError(f"normal: standard deviation {second!r}; must be above 0")
    if kind != "normal" and not first < second:
        raise ValueError(f"{kind}: value {excerpt(value)}; must be {what}")
    if kind == "log-uniform" and first <= 0.0:
        raise ValueError(f"log-uniform: value {first!r}; must be above 0")
    return first, second


def _number(key: str, value: object) -> float:
    try:
        return Quantity(-math.inf, math.inf)(value)
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from None


def _list(names: Sequence[str]) -> str:
    return ", ".join(names)
