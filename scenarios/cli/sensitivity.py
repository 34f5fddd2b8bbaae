"""The table of `regress --sensitivity`."""

from __future__ import annotations

from collections.abc import Sequence

from ...fmus.errors import InputError
from ...fmus.packaging.cache import cache_folder
from ...fmus.packaging.scratch import REGRESS, scratch_folder
from ..definition.scenario import Scenario
from ..regression.runner import Unusable
from ..regression.sensitivity import LARGEST, Threshold, parameters, sensitivity
from .console import as_cell, progress, show, show_json, table


def show_sensitivity(chosen: Sequence[Scenario | Unusable], jobs: int, *, json: bool) -> None:
    """Find the changes that a scenario's reference notices, and print them.

    Raises:
        InputError: There is not exactly one scenario, or it has no reference.
    """
    if len(chosen) != 1 or not isinstance(chosen[0], Scenario):
        raise InputError(f"--sensitivity: {len(chosen)} scenarios given; must be one")
    thresholds = _find(chosen[0], jobs)
    if json:
        show_json({"scenario": chosen[0].name, "parameters": thresholds})
        return
    made = table(("parameter", "value", "noticed from", "by*"), right=("value", "noticed from"))
    for each in thresholds:
        change = f"{each.change:+.2%}" if each.change else f"not at {LARGEST:.0%}"
        made.add_row(each.name, _value(each), change, as_cell(each.noticed_by.partition(";")[0]))
    show(made)


def _find(scenario: Scenario, jobs: int) -> list[Threshold]:
    total, done = len(parameters(scenario)), 0
    with (
        scratch_folder(cache_folder(), REGRESS) as folder,
        progress(f"Changing {total} parameters of {scenario.name}") as advance,
    ):

        def tell(_threshold: Threshold) -> None:
            nonlocal done
            done += 1
            advance(done, total)

        advance(0, total)
        return sensitivity(scenario, folder, jobs, tell)


def _value(threshold: Threshold) -> str:
    values = threshold.value if isinstance(threshold.value, tuple) else (threshold.value,)
    distinct = list(dict.fromkeys(f"{value:g}" for value in values))
    return distinct[0] if len(distinct) == 1 else f"{distinct[0]} ..."


__all__ = ["show_sensitivity"]
