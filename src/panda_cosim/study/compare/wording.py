"""How reports, pages and tables write numbers, instants and shares, and name signals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Final

from ...fmus.interface.tables import INTERFACES
from ...task.tolerances import signal_of

DASH: Final = "\u2013"  # en dash for an empty cell
MILLISECOND: Final = 1e-9  # [s] of rounding about one


def signal_names(columns: Iterable[str], most: int = 5) -> str:
    """List the signals of columns in one line, or the first of them."""
    signals = list(dict.fromkeys(map(signal_of, columns)))
    more = f" and {len(signals) - most} more" if len(signals) > most else ""
    return ", ".join(signals[:most]) + more


def numbers(values: Sequence[object]) -> list[str]:
    """Format numbers with four digits, or with as many as it takes to tell them apart."""
    for digits in range(4, 18):
        texts = [number(value, digits) for value in values]
        written = zip(values, texts, strict=True)
        if all(a == b or s != t for (a, s), (b, t) in combinations(written, 2)):
            break
    return texts


def number(value: object, digits: int) -> str:
    """Format a number with so many digits; return anything else unchanged."""
    if value is None:
        return DASH
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return f"{value:.{digits}g}"


def unit_of(key: str) -> str:
    """Return the unit of a parameter of our own FMUs; of another key, and of 1, ""."""
    instance, _, name = key.partition(".")
    interface = INTERFACES.get(instance)
    scalars = interface.scalars() if interface is not None else ()
    unit = next((s.unit for s in scalars if name in (s.name, s.variable.name)), "")
    return "" if unit == "1" else unit


def measure(value: float, unit: str) -> str:
    """Format a number with three digits and its unit, if any."""
    return short(value) if unit in ("", "1") else f"{short(value)} {unit}"


def multiple(share: float) -> str:
    """Format a share of a tolerance with three digits, or with what tells it from 1."""
    text = short(share)
    return numbers((1.0, share))[1] if text == "1" else text


def precise(value: float) -> str:
    """Format a time with all digits that its tick can have, without those of rounding."""
    return f"{value:.12g}"


def instant(value: float) -> str:
    """Format a time to the millisecond, or with all digits of a tick between these."""
    text = f"{value:.3f}"
    return text if abs(float(text) - value) < MILLISECOND else precise(value)


def short(value: float) -> str:
    """Format a number with three digits."""
    rounded = float(f"{value:.3g}")
    return f"{rounded:,.0f}" if 1e3 <= abs(rounded) < 1e7 else f"{rounded:g}"
