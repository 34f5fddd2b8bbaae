"""What other versions of MuJoCo change in a suite: nothing, the rounding, or the results.

Engines that round differently are never equal to the last bit, and what rounding makes may grow. So
each scenario runs once more with all inputs of its plant times 1 + 1e-14. An engine has changed a
signal where it is further off than `GROWTH` times what this noise has made of the signal so far.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from ...result.recording import Recording
from ...task.scenario import Scenario
from ...task.tolerances import Tolerances
from .outcome import Outcome, Unusable
from .tubes import widths

NOISE: Final = 1.0 + 1e-14
GROWTH: Final = 1000.0
FLOOR: Final = 1e-5  # of a tolerance: less is rounding, also where the noise has no effect yet


def variants(
    scenarios: Iterable[Scenario | Unusable], engines: Sequence[str]
) -> Iterator[Scenario | Unusable]:
    """Yield each scenario as it is and, if there are engines, with noise and with each of them."""
    for scenario in scenarios:
        yield scenario
        if engines and isinstance(scenario, Scenario):
            name = scenario.name
            yield replace(scenario, name=f"{name}-noise", input_scale=NOISE)
            yield from (replace(scenario, name=f"{name}-{e}", mujoco=e) for e in engines)


def engine_rows(
    scenarios: Sequence[Scenario | Unusable], engines: int, outcomes: Iterable[Outcome]
) -> list[list[Outcome]]:
    """Return the outcomes of each scenario: its own engine's, then the others' with differences."""
    rows, remaining = [], iter(outcomes)  # in the order of `variants`
    for scenario in scenarios:
        rows.append([next(remaining)])
        if isinstance(scenario, Scenario):
            own, noisy = rows[-1][0], next(remaining)
            others = (next(remaining) for _ in range(engines))
            rows[-1] += [replace(o, difference=_difference(own, noisy, o)) for o in others]
    return rows


def _difference(own: Outcome, noisy: Outcome, outcome: Outcome) -> str:
    if "failed" in (own.verdict, noisy.verdict, outcome.verdict):
        return ""
    own_run, noisy_run, run = (Recording.open(each.run) for each in (own, noisy, outcome))
    found = difference_of(own_run, noisy_run, run, own.read.regression)
    before, now = _touching(own), _touching(outcome)
    new = [f"{pair} touch" for pair in sorted(now - before)]
    return "; ".join([found, *new, *(f"{pair} touch no more" for pair in sorted(before - now))])


def _touching(outcome: Outcome) -> set[str]:
    """Return the pairs of bodies in unwanted contact."""
    return {" and ".join(each["bodies"]) for each in outcome.summary.contact.get("unwanted", ())}


def difference_of(own: Recording, noisy: Recording, run: Recording, tolerances: Tolerances) -> str:
    """Tell whether rounding explains how a run differs, from which tick on, and in which signal."""
    rows = min(each.rows for each in (own, noisy, run))
    beyond = {} if own.rows == run.rows else {"its length": rows}  # first tick, by column
    apart: dict[str, int] = {}
    for name, width in widths(own, tolerances).items():
        first, noise, other = (each[name][:rows] for each in (own, noisy, run))
        differs = np.asarray(first != other)
        if name in own.texts:
            wrong = differs & (first == noise)
        else:
            first, noise, other = (x.astype(float) for x in (first, noise, other))
            effect = np.maximum.accumulate(np.abs(noise - first))
            wrong = ~(np.abs(other - first) <= np.maximum(GROWTH * effect, FLOOR * width))
        for found, where in ((apart, differs), (beyond, wrong)):
            if where.any():
                found[name] = int(where.argmax())
    for word, found in (("beyond rounding", beyond), ("rounding", apart)):
        if found:
            name = min(found, key=found.__getitem__)
            return f"{word}, tick {found[name]}: {name}"
    return "equal"
