"""A run's verdict, as it is shown."""

from __future__ import annotations

from rich.table import Table

from ..running.summary import Criterion, Summary
from .console import table


def verdict_table(summary: Summary) -> Table:
    """Return a table with one row per criterion."""
    made = table(("criterion", "measured", "required", "verdict"), right=("measured", "required"))
    for criterion in summary.criteria:
        made.add_row(
            criterion.name,
            quantity(criterion.value, criterion.unit),
            _bound(criterion),
            "[green]ok[/green]" if criterion.ok else "[bold red]missed[/bold red]",
        )
    return made


def outcome_lines(summary: Summary, *, realtime: bool) -> list[tuple[str, str]]:
    """Return the lines under the table, each with its style."""
    lines = [_verdict_line(summary), (_speed_line(summary), "")]
    if realtime:
        timing = summary.timing
        lines.append(
            (
                f"Real time: {timing['overruns']} of {timing['steps']} steps were late, the latest "
                f"by {timing['worst_lateness_s'] * 1e3:.1f} ms",
                "",
            )
        )
    return lines


def _verdict_line(summary: Summary) -> tuple[str, str]:
    missed = missed_criteria(summary)
    if missed:
        return f"Success condition missed: {missed}", "bold red"
    if not summary.criteria:
        return "Done; the scenario has no success condition", "bold"
    return f"Success: all {len(summary.criteria)} criteria hold", "bold green"


def missed_criteria(summary: Summary) -> str:
    """Return what was missed and by how much, such as `tracking_rms 1.3 mm, required <= 0.1 mm`."""
    return "; ".join(
        f"{c.name} {quantity(c.value, c.unit)}, required {_bound(c)}"
        for c in summary.criteria
        if not c.ok
    )


def _speed_line(summary: Summary) -> str:
    timing, tracking = summary.timing, summary.tracking
    factor = timing.get("real_time_factor")
    speed = f" in {timing['wall_s']:.2f} s ({factor:.1f} x real time)" if factor else ""
    return (
        f"{timing['simulated_s']:g} s simulated{speed}; tracking RMS "
        f"{tracking['rms_mm']:.4g} mm, max {tracking['max_mm']:.4g} mm"
    )


def _bound(criterion: Criterion) -> str:
    sign = ">=" if criterion.name.startswith("min_") else "<="
    return f"{sign} {quantity(criterion.bound, criterion.unit)}"


def quantity(value: float | None, unit: str) -> str:
    """Return a value with its unit; lengths in mm."""
    if value is None:
        return "not measured"
    return f"{value * 1e3:.4g} mm" if unit == "m" else f"{value:.4g} {unit}"
