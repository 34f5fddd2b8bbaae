"""What other versions of MuJoCo change in a suite: nothing, the rounding, or the results.

Engines that round differently are never equal to the last bit, and what rounding makes may grow. So
each scenario runs once more with all inputs of its plant times 1 + 1e-14. An engine has changed a
signal where it is further off than `GROWTH` times what this noise has made of the signal so far.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from ...result.recording import Recording
from ...task.scenario import Scenario
from ...task.tolerances import Tolerances, flattened
from .causes import models_of
from .outcome import Member, Outcome
from .tubes import widths

Ticks = dict[str, list[int]]  # at which geoms touch, by pair

BEYOND: Final = "beyond rounding"
SHOWN: Final = 3  # pairs of geoms in a line, the earliest
NOISE: Final = 1.0 + 1e-14
GROWTH: Final = 1000.0
FLOOR: Final = 1e-5  # of a tolerance: less is rounding, also where the noise has no effect yet


def variants(scenario: Member, engines: Sequence[str], runs: int, *, noise: bool) -> list[Member]:
    """Return a scenario, its repeats and, if these are asked for, it with noise and engines."""
    name = scenario.name
    found = [scenario, *(replace(scenario, name=f"{name} run {n}") for n in range(2, runs + 1))]
    if (noise or engines) and isinstance(scenario, Scenario):
        found.append(replace(scenario, name=f"{name}-noise", input_scale=NOISE))
        found += [replace(scenario, name=f"{name}-{each}", mujoco=each) for each in engines]
    return found


def engine_row(own: Outcome, noisy: Outcome | None = None, *others: Outcome) -> list[Outcome]:
    """Return a scenario's outcomes: its own engine's, then the others' with differences."""
    first = replace(own, noisy=noisy.run if noisy else None)
    return [first, *(replace(o, difference=_difference(own, noisy, o)) for o in others if noisy)]


def _difference(own: Outcome, noisy: Outcome, outcome: Outcome) -> str:
    if "failed" in (own.verdict, noisy.verdict, outcome.verdict):
        return ""
    runs = (own, noisy, outcome)
    first, noise, other = (Recording.open(each.run) for each in runs)
    told = [difference_of(first, noise, other, own.read.regression)]
    before, now = _touching(own), _touching(outcome)
    told += [f"{pair} touch{' no more' * (pair in before)}" for pair in sorted(before ^ now)]
    if told[0].startswith(BEYOND):
        told += changed_pairs(*map(_contacts, runs))[:SHOWN]
    return "; ".join(told)


def _contacts(outcome: Outcome) -> Ticks:
    look = partial(touching, outcome.run)
    return dict(flattened(models_of(outcome.read, Recording.open(outcome.run), look)))


def touching(run: Path, model: Any, instance: str) -> Ticks:
    """Return the ticks at which two geoms touch, by pair, at the positions that a run recorded."""
    import mujoco  # noqa: PLC0415 - slow to import; another version than the installed one

    recording, data = Recording.open(run), mujoco.MjData(model)
    found = defaultdict[str, list[int]](list)
    signal = f"{instance}.qpos"
    qpos = recording[signal].reshape(recording.rows, -1) if signal in recording else np.empty(0)
    known = qpos.shape[-1] == model.nq  # no output tells where rotors of elastic joints are
    for tick, data.qpos[:] in enumerate(qpos if known else ()):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        for pair in {tuple(sorted(pair)) for pair in data.contact.geom.tolist()}:
            found[" and ".join(_named(model, geom) for geom in pair)].append(tick)
    return found


def _named(model: Any, geom: int) -> str:
    """Return the name of a geom, or its number in its body."""
    body = model.body(model.geom_bodyid[geom])
    place = body.name or f"body {body.id}"
    return model.geom(geom).name or f"{place} geom {geom - body.geomadr[0] + 1}"


def changed_pairs(own: Ticks, noisy: Ticks, other: Ticks) -> list[str]:
    """Name pairs that touch, or do not, unlike in the own run, and before noise changes them."""
    found = []
    for pair in own.keys() | other.keys():
        before, noise, now = (set(each.get(pair, ())) for each in (own, noisy, other))
        tick = min(before ^ now, default=math.inf)
        if tick < min(before ^ noise, default=math.inf):
            found.append((tick, f"{pair} {'touch' if tick in now else 'are apart'} at tick {tick}"))
    return [text for _, text in sorted(found)]


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
            differs &= ~(np.isnan(first) & np.isnan(other))
            effect = np.fmax.accumulate(np.abs(noise - first))
            wrong = differs & ~(np.abs(other - first) <= np.fmax(GROWTH * effect, FLOOR * width))
        for found, where in ((apart, differs), (beyond, wrong)):
            if where.any():
                found[name] = int(where.argmax())
    for word, found in ((BEYOND, beyond), ("rounding", apart)):
        if found:
            name = min(found, key=found.__getitem__)
            return f"{word}, tick {found[name]}: {name}"
    return "equal"
