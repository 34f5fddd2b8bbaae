"""Makes reference recordings from runs, and describes the changes."""

from __future__ import annotations

from ...fmus.errors import InputError
from ..recording import Recording
from .compare import describe
from .metrics import compare_metrics
from .reference import Reference
from .runner import Outcome

SHOWN = 5  # metrics listed
NOTICED = 1e-3  # relative change from which a metric is listed


def candidate(outcome: Outcome) -> Reference:
    """Make a reference from a run.

    Raises:
        InputError: The run failed, or cannot be a reference.
    """
    if outcome.verdict == "failed":
        raise InputError(f"the run failed, so it cannot become a reference: {outcome.error}")
    recording = Recording.open(outcome.run)
    return Reference.of(recording, outcome.summary, outcome.tolerances)


def changes(outcome: Outcome, new: Reference) -> list[str]:
    """Describe the changes of a new reference, one per line; none: nothing changes.

    Args:
        outcome: Outcome of the run behind the new reference.
        new: The new reference.
    """
    path = outcome.reference_path
    if not path.is_file():
        return ["is new"]
    try:
        old = Reference.read(path)
    except InputError as error:
        return [f"replaces a reference that cannot be used: {error}"]
    if old.digests == new.digests and old.quanta == new.quanta:
        return []
    lines = [p.text for p in outcome.comparison.problems] if outcome.comparison else []
    if outcome.comparison and not lines:
        worst = outcome.comparison.worst
        near = f"; furthest: {describe(worst)}" if worst is not None and worst.share > 0 else ""
        lines = [f"stays within all tolerances{near}"]
    if old.quanta != new.quanta:
        lines.append("is rounded anew, as its tolerances have changed")
    metrics = compare_metrics(old.summary, new.summary)
    moved = sorted((m for m in metrics if m.relative > NOTICED), key=lambda m: -m.relative)
    lines += [f"{m.name}: {_number(m.before)} -> {_number(m.now)}" for m in moved[:SHOWN]]
    if len(moved) > SHOWN:
        lines.append(f"and {len(moved) - SHOWN} more metrics")
    return lines


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g}"


__all__ = ["candidate", "changes"]
