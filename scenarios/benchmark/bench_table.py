"""The bench's result as tables for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich import box
from rich.console import Group
from rich.table import Table

from .bench import LABELS, RATIOS

if TYPE_CHECKING:
    from .bench import BenchResult


def tables(result: BenchResult) -> Group:
    """Return all tables of a result, one below the other."""
    machine = ", ".join(f"{key} {value}" for key, value in result.machine.items())
    return Group(_steps(result), _ratios(result), _parts(result), _around(result), machine)


def _table(title: str) -> Table:
    """Return an empty table without a frame, which a narrow terminal would break up."""
    return Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False
    )


def _steps(result: BenchResult) -> Table:
    table = _table(f"Cost of a step of {result.scenario} \\[us]")
    table.add_column("way")
    for name in ("median", "quartiles"):
        table.add_column(name, justify="right")
    for way, spread in result.steps.items():
        table.add_row(LABELS[way], f"{spread.median:.1f}", f"{spread.low:.1f} to {spread.high:.1f}")
    table.caption = f"(c) runs at {result.real_time_factor:.1f} times real time"
    return table


def _ratios(result: BenchResult) -> Table:
    table = _table("Ratios in the same pass")
    table.add_column("ratio")
    for name in ("median", "quartiles", "goal"):
        table.add_column(name, justify="right")
    for name, spread in result.ratios.items():
        quartiles = f"{spread.low:.2f} to {spread.high:.2f}"
        table.add_row(name, f"{spread.median:.2f}", quartiles, RATIOS[name][2])
    return table


def _parts(result: BenchResult) -> Table:
    table = _table("Where the time of (c) goes \\[us]")
    table.add_column("part")
    table.add_column("median", justify="right")
    table.add_column("share", justify="right")
    whole = sum(result.parts.values())
    for part, cost in result.parts.items():
        table.add_row(part, f"{cost:.1f}", f"{100 * cost / whole:.0f} %")
    table.add_section()
    for part, cost in result.objects.items():
        table.add_row(f"{part}, in a plain loop", f"{cost:.1f}", "")
    return table


def _around(result: BenchResult) -> Table:
    table = _table("Around the steps")
    table.add_column("what")
    table.add_column("best of 3", justify="right")
    for what, seconds in result.start_up.items():
        table.add_row(what, f"{seconds:.2f} s")
    if result.frame is not None:
        table.add_row("drawing a frame, 640 x 480", f"{result.frame:.0f} ms")
    return table
