"""What each number of a run means: the rows of definitions.toml, and those of checks.toml.

Help, tooltips and the site's tables are made of these rows; `tests/result/test_definitions.py`
computes the numbers again from them alone.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from ...assets.checks import CHECKS, SIGNALS, Check

WINDOWS: Final = {"start": "the first row", "end": "the last row"}


@dataclass(frozen=True)
class Definition:
    """What one number means; definitions.toml says what the fields are."""

    # In summary.json, such as `block.slip_mm`; `success.` and the key of a criterion; `analysis.`.
    key: str
    what: str
    signals: tuple[str, ...] = ()
    window: str = "all rows"
    unit: str = ""
    better: Literal["lower", "higher", ""] = ""
    unmeasured: str = ""
    metric: str = ""

    @property
    def text(self) -> str:
        """The definition in one line, with the rows that count."""
        return self.what if self.window == "all rows" else f"{self.what}; {self.window}"


def _share(key: str, check: Check) -> Definition:
    recommended = "" if check.necessary else " (recommended)"
    what = f"{check.what}: largest share of {check.limit}{recommended}"
    signals = tuple(SIGNALS["joint" if key.startswith("elbow") else check.interface])
    window = WINDOWS.get(key.partition("_")[0], "all rows")
    return Definition(f"preflight.{key}_share", what, signals, window, "1", "lower")


def _read() -> dict[str, Definition]:
    """Read the table; a criterion is what its metric is, but for its unit."""
    rows: dict[str, Definition] = {}
    text = Path(__file__).with_name("definitions.toml").read_text(encoding="utf-8")
    for key, entries in tomllib.loads(text).items():
        if key == "preflight.findings":  # of these checks
            shares = (_share(name, check) for name, check in CHECKS.items())
            rows |= {share.key: share for share in shares}
        bounded = rows.get(entries.get("metric", ""))
        fields = {**(vars(bounded) if bounded else {}), "key": key, **entries}
        rows[key] = Definition(**fields | {"signals": tuple(fields.get("signals", ()))})
    return rows


DEFINITIONS: Final[Mapping[str, Definition]] = _read()
