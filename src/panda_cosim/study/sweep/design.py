"""The values of each row, which depend only on the definition and the row's index, or a search.

A search is for the worst or best margin: Optuna proposes rows and gets their results. The table is
its memory: when it resumes, Optuna gets all existing rows. The rows are not a sample of any
distribution, so their counts are not probabilities.
"""

from __future__ import annotations

import itertools
import math
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import scipy  # its modules are loaded as they are used, which takes time

from ...assets.fields import Array
from ...fmus.errors import InputError, located
from ...fmus.extras import needing
from ...fmus.interface.parameters import ParameterValue, literal
from ...run.inputs import CHUNK
from ...run.prepare import prepare
from ...run.start import start_values
from ...task.fields import field_names
from ...task.files import parse_csv, read_text
from ...task.scenario import Scenario
from .definition import MAX_SAMPLES, Distribution, Sweep
from .packed import Loaded
from .row import Done, Row, Task, margin_column
from .store import Store

Columns = Mapping[str, Array | Sequence[Any]]  # by key, each (count,): numbers, or a list
Values = dict[str, ParameterValue]
_MAX_BYTES = 1 << 30  # of a list
COMPARED: Final = 50  # rows in which a key without effect is looked for
# Fields of a scenario that act through start values and inputs alone.
RESOLVED: Final = ("table", "scene", "robot", "gains", "interpolation", "timing", "timing_share",
                   "route", "align", "plant", "controller", "mismatch", "push", "inputs",
                   "input_table", "parameters")  # fmt: skip
FIRST: Final = 10  # rows of a search that are drawn at random
_EDGE = 1e-12  # keeps probabilities off 0 and 1, where the normal quantile is infinite


class Design:
    """The values of all rows of a sweep.

    Attributes:
        columns: Values by key; of a search only the ends, as its points follow later.
        count: Number of rows of one scenario; those of several come one after the other.
    """

    def __init__(self, sweep: Sweep) -> None:
        self.columns = _columns(sweep)
        self.count = sweep.samples or len(next(iter(self.columns.values())))
        self._scenarios = len(sweep.scenario)

    def __len__(self) -> int:
        """Return the number of rows of all scenarios."""
        return self.count * self._scenarios

    def values(self, index: int) -> Values:
        """Return the values of a row by key, as plain numbers, switches or text."""
        row = {key: column[index % len(column)] for key, column in self.columns.items()}
        return {k: v if isinstance(v, bool | str) else float(v) for k, v in row.items()}

    def scenario(self, index: int) -> int:
        """Return which scenario a row belongs to."""
        return index // self.count


def _columns(sweep: Sweep) -> Columns:
    if sweep.file is not None:
        return _read_list(sweep.file)
    if sweep.design == "search":
        return {key: each.extremes() for key, each in sweep.vary.items()}
    if sweep.design == "grid":
        axes = [distribution.grid() for distribution in sweep.vary.values()]
        if (size := math.prod(map(len, axes))) > MAX_SAMPLES:
            raise InputError(f"the grid has {size} points; must be at most {MAX_SAMPLES}")
        return dict(zip(sweep.vary, zip(*itertools.product(*axes), strict=True), strict=True))
    u = _probabilities(sweep)
    return {key: each.quantiles(u[:, i]) for i, (key, each) in enumerate(sweep.vary.items())}


def _probabilities(sweep: Sweep) -> Array:
    """Draw points in the unit cube (n, keys)."""
    rng, dimensions = np.random.default_rng(sweep.seed), len(sweep.vary)
    if sweep.design == "random":
        u = rng.random((sweep.samples, dimensions))
    else:
        kinds = {"latin-hypercube": scipy.stats.qmc.LatinHypercube, "sobol": scipy.stats.qmc.Sobol}
        with warnings.catch_warnings():  # any number is allowed; a power of 2 covers the cube best
            warnings.simplefilter("ignore", UserWarning)
            u = kinds[sweep.design](dimensions, rng=rng).random(sweep.samples)
    return np.clip(u, _EDGE, 1.0 - _EDGE)


def _read_list(path: Path) -> dict[str, Sequence[Any]]:
    """Read a CSV with the keys in its header; their order means nothing."""
    text = read_text(path, _MAX_BYTES)
    with located(path):
        table = parse_csv(text)
        if not table.rows:
            raise InputError("has no rows; must have at least one below the names")
    rows = ([literal(cell.strip()) for cell in cells] for cells in table.rows.values())
    return dict(sorted(zip(table.names, zip(*rows, strict=True), strict=True)))


def check_keys(keys: Iterable[str]) -> None:
    """Check that no key sets what another one sets."""
    there: dict[str, str] = {}
    for key in sorted(keys, key=len):
        spelled = re.sub(r"\[0+(?=\d)", "[", key)  # [03] is [3]
        other = there.get(spelled, there.get(re.sub(r"\[\d+\]$", "", spelled)))
        if other is not None:
            raise InputError(f"vary: {other} and {key} set the same value; must be one of them")
        there[spelled] = key


def check_design(sweep: Sweep, columns: Columns, scenarios: Sequence[Loaded]) -> None:
    """Check that each key exists and takes its smallest and largest value, each by itself."""
    check_keys(columns)
    ends = {key: each.ends() for key, each in sweep.vary.items() if each.ends()}
    for loaded in scenarios:
        for key, column in {**columns, **ends}.items():  # the numbers of the file, if it has them
            for value in _extremes(column):
                with located(f"vary: scenario {loaded.label}"):
                    start_values(loaded.scenario.changed({key: value}))


def keys_without_effect(design: Design, scenarios: Sequence[Loaded]) -> list[str]:
    """Return the keys that change no start value, input or criterion in the rows compared."""
    # A key may act only beside certain values of others, as a seed does beside a preset.
    count = max(map(len, design.columns.values()))
    compared = np.random.default_rng(0).permutation(count)[:COMPARED].tolist()
    pairs = list(itertools.product(map(design.values, compared), scenarios))
    return [
        key
        for key, column in design.columns.items()
        if len(values := _extremes(column)) > 1
        and not any(_acts(key, values, row, loaded.scenario) for row, loaded in pairs)
    ]


def _acts(key: str, values: Sequence[Any], row: Values, scenario: Scenario) -> bool:
    """Tell whether a row becomes another run as one of its values goes from end to end."""
    try:
        first, *others = (scenario.changed({**row, key: value}) for value in values)
        return any(_differ(first, other) for other in others)
    except InputError:  # it decides whether the row can run
        return True


def _differ(one: Scenario, other: Scenario) -> bool:
    """Tell whether two scenarios differ in start values, inputs, or anything else."""
    others = {*field_names(Scenario), "asked"}.difference(RESOLVED)
    if any(getattr(one, name) != getattr(other, name) for name in others):
        return True
    runs = prepare(one), prepare(other)
    first, second = (run.inputs() for run in runs)
    if runs[0].values != runs[1].values or first.shape != second.shape:
        return True
    chunks = (slice(k, k + CHUNK) for k in range(0, first.shape[0], CHUNK))
    return any(not np.array_equal(first[chunk], second[chunk]) for chunk in chunks)


def _extremes(column: Array | Sequence[Any]) -> list[ParameterValue]:
    """Return the words of a column, or its smallest and its largest number."""
    if all(isinstance(value, str | bool) for value in column):
        return list(dict.fromkeys(column))
    if any(isinstance(value, str | bool) for value in column):
        raise InputError("vary: values of a key must be all numbers, all switches or all text")
    return list(dict.fromkeys((float(min(column)), float(max(column)))))


class Search:
    """A search, with the rows so far."""

    def __init__(self, sweep: Sweep, store: Store) -> None:
        self._margin = margin_column(sweep.criterion, store.content.columns)
        with needing("optuna", "search", 'design "search"'):
            import optuna  # noqa: PLC0415 - an extra
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._axes = {key: _axis(optuna, each) for key, each in sweep.vary.items()}
        self._trials: dict[int, Any] = {}
        known = store.table().to_pylist() if store.parts() else []
        first = max((row["index"] for row in known), default=-1) + 1
        self._indices = range(first, first + sweep.samples - len(known))
        seed = sweep.seed + first
        sampler = optuna.samplers.TPESampler(n_startup_trials=FIRST, seed=seed, constant_liar=True)
        self._study = optuna.create_study(
            direction="minimize" if sweep.goal == "fail" else "maximize", sampler=sampler
        )
        for row in known:
            params, value = {key: row[key] for key in self._axes}, self._objective(row)
            trial = optuna.trial.create_trial(params=params, distributions=self._axes, value=value)
            self._study.add_trial(trial)

    def tasks(self) -> Iterator[Task]:
        """Yield Optuna's proposals until all samples are used."""
        for index in self._indices:
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
