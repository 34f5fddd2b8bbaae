"""Which criteria a page judges by itself: those over a whole run that its rows give in one pass."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import Final

from ...result.judging.definitions import DEFINITIONS
from ...run.session import Session
from ...task.criteria import Signal, SignalCriterion
from ...task.tolerances import signal_of

FOLDS: Final = ("max", "min", "rms", "final")  # reductions that engine/judge.ts has
AWAY: Final[Signal] = ("norm", ("plant.hand_xpos", "controller.pos_cmd"))
# Keys of [success] that are such a criterion, too.
OF_SUCCESS: Final[dict[str, tuple[Signal, str]]] = {
    "tracking_rms": (AWAY, "rms"),
    "tracking_max": (AWAY, "max"),
    "max_unwanted_force": ("plant.unwanted_contact_force", "max"),
}


def criteria_of(session: Session) -> Iterator[Mapping[str, object]]:
    """Yield all criteria, as `CriterionData` in engine/judge.ts; of most, the name alone."""
    success, columns = session.scenario.success, list(session.numbers())
    signals = [*success.signal]
    for name, bound in vars(success).items():
        if name in OF_SUCCESS and bound is not None:
            signals.append(SignalCriterion(*OF_SUCCESS[name], below=bound, name=name))
        elif f"success.{name}" in DEFINITIONS and bound is not None:
            yield {"name": name}
    for body in success.body:
        yield from ({"name": name} for name in body.labels.values())
    for each in signals:
        for direction, bound in each.bounds.items():
            known = {"name": each.labels[direction], "direction": direction, "bound": bound}
            yield known | _measure(each, columns)


def _measure(criterion: SignalCriterion, columns: Sequence[str]) -> dict[str, object]:
    """Return what a page measures for a criterion; nothing if that is not simple."""
    parts = [[i for i, column in enumerate(columns) if name in (column, signal_of(column))]
             for name in criterion.names]  # fmt: skip
    is_length = criterion.signal[0] == "norm"
    is_simple = criterion.reduce in FOLDS and all(parts) and (is_length or len(parts[0]) == 1)
    if not is_simple or (criterion.from_, criterion.to) != ("start", "end"):
        return {}
    columns_of = list(zip_longest(*parts))  # of one, and of what is subtracted from it
    return {"columns": columns_of, "isLength": is_length, "reduce": criterion.reduce}
