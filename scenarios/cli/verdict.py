"""Text and table of a run's verdict."""

from __future__ import annotations

from collections.abc import Iterator

from rich.table import Table

from ..judging.contacts import Touch
from ..judging.criterion import bound_text, margin_text, missed_text, quantity
from ..judging.limits import exceeded
from ..running.summary import Summary
from .console import as_cell, table

MORE_TIME = "`panda-cosim retime SCENARIO --keep-times`"
REMEDIES = {  # by the kind of limit that held the arm back
    "position": "move the rows before and after it, or turn the hand",
    "velocity": f"give that row more time ({MORE_TIME})",
    "acceleration": f"give that row more time ({MORE_TIME})",
    "jerk": f"give that row more time ({MORE_TIME}), or keep the path away from the stretched arm; "
    "with noisy readings, lower controller.ik_gain",
    "torque": f"give that row more time ({MORE_TIME}), or carry less; with friction, elastic "
    "joints or weak servos, lower controller.kp and controller.ik_gain",
}
SHOWN = 3  # unwanted contacts that are named
NO_VERDICT = "Neither success nor failure, as not all criteria could be measured"
NOT_FAILED = "Success, although a failure is expected"


def verdict_table(summary: Summary) -> Table:
    """Return a table with one row per criterion."""
    right = ("measured", "required", "margin")
    made = table(("criterion*", *right, "verdict"), right=right)
    for criterion in summary.criteria:
        made.add_row(
            as_cell(criterion.name),
            as_cell(criterion.reason or quantity(criterion.value, criterion.unit)),
            as_cell(bound_text(criterion)),
            margin_text(criterion),
            f"[{'green' if criterion.ok else 'bold red'}]{criterion.word}",
        )
    return made


def outcome_lines(summary: Summary, *, realtime: bool) -> list[tuple[str, str]]:
    """Return the lines below the table, each with its style."""
    lines = [_verdict_line(summary), (_speed_line(summary), "")]
    lines += [*_contact_lines(summary), *_limit_lines(summary)]
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
    missed = missed_text(summary.criteria)
    if not all(criterion.measured for criterion in summary.criteria):
        return f"{NO_VERDICT}: {missed}", "bold red"
    if summary.expect == "failure":
        return _expected_failure_line(summary, missed)
    if missed:
        return f"Success condition missed: {missed}", "bold red"
    if not summary.criteria:
        return "Done; the scenario has no success condition", "bold"
    return f"Success: all {len(summary.criteria)} criteria hold", "bold green"


def _expected_failure_line(summary: Summary, missed: str) -> tuple[str, str]:
    if summary.as_expected:
        return f"Failure, as expected ({summary.expect_reason}): {missed}", "bold green"
    return f"{NOT_FAILED} ({summary.expect_reason})", "bold red"


def _limit_lines(summary: Summary) -> Iterator[tuple[str, str]]:
    """Yield the robot limits that were exceeded, and the first one that bound the controller."""
    beyond, contacts = exceeded(summary.limits), summary.contact.get("unwanted")
    if beyond:
        yield f"Beyond the robot's limits: {', '.join(beyond)}", "yellow"
    first = summary.first_limit
    if not first and not contacts and any(limit.startswith("torque rate") for limit in beyond):
        yield (
            f"Torque rate: give the rows more time ({MORE_TIME}) or set bodies down more gently; "
            "with noisy readings, lower controller.ik_gain",
            "yellow",
        )
    if first:
        touched = contacts and contacts[0]["time_s"] <= first["time_s"]
        remedy = "after the contact above" if touched else REMEDIES[first["kind"]]
        yield (
            f"The {first['kind']} limit of joint {first['joint']} first held the arm back at "
            f"t = {first['time_s']:.3f} s: {remedy}",
            "yellow",
        )


def _contact_lines(summary: Summary) -> Iterator[tuple[str, str]]:
    """Name the contacts that nobody wants, which are often the cause of all that follows."""
    contacts = [Touch(**contact) for contact in summary.contact.get("unwanted", [])]
    if contacts:
        more = f"; and {len(contacts) - SHOWN} more pairs" if len(contacts) > SHOWN else ""
        told = "; ".join(map(str, contacts[:SHOWN]))
        yield f"Unwanted contacts: {told}{more}; the path must lead around", "yellow"
    elif peak := summary.contact.get("unwanted_force_N"):
        yield f"Unwanted contacts, with up to {peak:.3g} N", "yellow"


def _speed_line(summary: Summary) -> str:
    timing, tracking = summary.timing, summary.tracking
    factor = timing.get("real_time_factor")
    speed = f" in {timing['wall_s']:.2f} s ({factor:.1f} x real time)" if factor else ""
    simulated = f"{timing['simulated_s']:g} s simulated{speed}"
    if not tracking:
        return simulated
    return f"{simulated}; tracking RMS {tracking['rms_mm']:.4g} mm, max {tracking['max_mm']:.4g} mm"
