"""A search for the worst or best margin: Optuna proposes rows and gets their results.

The table is the search's memory: when it resumes, Optuna gets all existing rows. The rows are not a
sample of any distribution, so their counts are not probabilities.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

from ...fmus.errors import InputError
from .definition import Distribution, Sweep
from .row import Done, Row, Task, margin_column
from .store import Store

FIRST: Final = 10  # rows drawn at random before the search proper


class Search:
    """A search, with the rows so far."""

    def __init__(self, sweep: Sweep, store: Store) -> None:
        self._margin = margin_column(sweep.criterion, store.content["columns"])
        try:
            import optuna  # noqa: PLC0415 - an extra
        except ModuleNotFoundError as error:
            raise InputError(
                f"design \"search\": {error}; pip install 'panda-cosim[search]'"
            ) from None
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._axes = {key: _axis(optuna, each) for key, each in sweep.vary.items()}
        self._trials: dict[int, Any] = {}
        known = store.table().to_pylist() if store.parts() else []
        self._next = max((row["index"] for row in known), default=-1) + 1
        self._left = sweep.samples - len(known)
        sampler = optuna.samplers.TPESampler(
            n_startup_trials=FIRST, seed=sweep.seed + self._next, constant_liar=True
        )
        self._study = optuna.create_study(
            direction="minimize" if sweep.goal == "fail" else "maximize", sampler=sampler
        )
        for row in known:
            params = {key: row[key] for key in self._axes}
            self._study.add_trial(
                optuna.trial.create_trial(
                    params=params, distributions=self._axes, value=self._objective(row)
                )
            )

    def tasks(self) -> Iterator[Task]:
        """Yield Optuna's proposals until all samples are used."""
        for index in range(self._next, self._next + self._left):
            trial = self._trials[index] = self._study.ask(self._axes)
            yield Task(index, 0, {key: trial.params[key] for key in self._axes})

    def tell(self, done: Done) -> None:
        """Give Optuna the result of a row."""
        self._study.tell(self._trials.pop(done.task.index), self._objective(done.row))

    def _objective(self, row: Row) -> float:
        margin = row.get(self._margin)
        return -math.inf if margin is None else float(margin)  # not finished or not measured


def _axis(optuna: Any, distribution: Distribution) -> Any:
    """Return a range, or choices, of Optuna's."""
    if distribution.values:
        return optuna.distributions.CategoricalDistribution(distribution.values)
    low, high = (float(end) for end in distribution.extremes())
    return optuna.distributions.FloatDistribution(low, high, log=distribution.kind == "log-uniform")
