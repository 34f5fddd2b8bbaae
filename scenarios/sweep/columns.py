"""What the columns of a sweep's table mean, and the figures of its report.

Columns `summary.*`, `event.*` and `margin.CRITERION` are numbers of each run, which
`judging.definitions` defines.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from ..judging.definitions import DEFINITIONS, Definition

SAMPLE_ONLY: Final = "the rows are no random samples (grid, list, search)"
UNFINISHED: Final = "rows are missing"

D = Definition
_ROWS: Final = (
    # Columns of the table
    D("index", "number of the row, from 0"),
    D("scenario", "the scenario that was run"),
    D("status", "`success`: the verdict is as expected; `missed`: a criterion was; `unexpected`: "
      "all criteria hold, though a failure is expected; without a verdict and a margin, "
      "`unmeasured`: a criterion could not be measured, `failed`: the simulation did, `timeout`: "
      "it was stopped by the time limit"),
    D("missed", "the first criterion that was missed", unmeasured="none was"),
    D("error", "why the row has no verdict", unmeasured="it has one"),
    D("margin", DEFINITIONS["margin"].what, unit="1", better="higher",
      unmeasured="the run did not finish, or a criterion could not be measured"),
    D("processor", "model of the processor that ran the row"),
    D("command", "repeats the row, bit for bit on the same kind of processor"),
    D("recording_sha256", "hash of all numbers of the recording", unmeasured="it did not finish"),
    D("wall_s", "time that the row took on its machine", unit="s", better="lower"),
    # Figures of the report
    D("report.rows", "rows of the table"),
    D("report.success", "rows with the expected verdict, and their share of all rows of the "
      "table; all others are failures, those without a verdict among them", unit="%",
      better="higher"),
    D("report.interval", "bounds of the probability of success, 95 % confidence, by Clopper and "
      "Pearson; exact for random samples, on the safe side for Sobol and Latin hypercube",
      unit="%", unmeasured=f"{SAMPLE_ONLY}, or {UNFINISHED}"),
    D("report.status", "rows with this status; each counts as a failure"),
    D("report.limits", "successes during which the largest share of any limit of the robot was "
      "above 1", better="lower", unmeasured="no limit was measured"),
    D("report.first_missed", "rows that finished, by the first criterion that they missed"),
    D("report.region", "values that select these rows, and no others: found by up to 3 cuts, each "
      "of the value that separates failures best (Gini impurity)"),
    D("report.region_share", "failures in the region, as a share of all failures", unit="%"),
    D("report.region_failures", "failures in the region, of all its rows"),
    D("report.bars", "rows without success, as a share of all rows with that value or within that "
      "range"),
    D("report.correlation", "Spearman's rank correlation of a value with the margin, with bounds "
      "of 95 % confidence by Bonett and Wright; it shows monotonic effects only. For words, the "
      "square root of the share of the margin ranks' variance that lies between words (Kruskal "
      "and Wallis; without sign and bounds). Rows without a margin rank lowest",
      unmeasured=f"{SAMPLE_ONLY}, or they are fewer than 10; no bounds if {UNFINISHED}"),
    D("report.cells", "rows without success, as a share of all rows in the cell"),
    D("report.worst", "rows with the smallest margins; before them, those that have none"),
)  # fmt: skip

COLUMNS: Final[Mapping[str, D]] = MappingProxyType({row.key: row for row in _ROWS})


def definition(column: str) -> D:
    """Return what a column of the table, or a figure of the report, means."""
    group, _, rest = column.partition(".")
    if group == "margin" and rest:
        bounded = DEFINITIONS.get(f"success.{rest}")
        of = f": {bounded.what}" if bounded else ""
        return D(column, f"margin of {rest}{of}", unit="1", better="higher",
                 unmeasured=COLUMNS["margin"].unmeasured)  # fmt: skip
    place = {"summary": rest.partition("[")[0], "event": f"events.{rest}"}.get(group)
    return DEFINITIONS[place] if place else COLUMNS[column]


def tooltip(column: str) -> str:
    """Return a definition in a line."""
    row = definition(column)
    missing = f" Not given if {row.unmeasured}." if row.unmeasured else ""
    return f"{row.what[:1].upper()}{row.what[1:]}.{missing}"
