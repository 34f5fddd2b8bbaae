"""Measures the loops of a scenario at an instant of its run.

Something small is added to one input of the plant, such as a servo target, for one period of the
controller. The response is the difference to what happens without it, divided by what was added.
Before each pulse, all FMUs go back to the state of that instant; commands and pushes continue as
in the run. Responses are cut off where a contact or a limit changes them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from ...fmus.errors import InputError, SimulationError, refuse
from ...fmus.master.perturbed import Change, PerturbedSystem
from ...fmus.master.wiring import Array, Name
from ...run.inputs import Inputs
from ...run.prepare import Prepared
from ...task.tolerances import signal_of
from .sensitivity import Sensitivity

WINDOWS: Final = (250, 500, 1000, 2000, 4000)  # [ticks] the first in which responses decay
DECAYED: Final = 1e-3  # of its peak, below which a response has; a longer window adds little
ENOUGH: Final = 1e-2  # likewise, if it cannot be followed further
SIZES: Final = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # of pulses: units of the input, or its value if > 1
LINEAR: Final = 1e-3  # of its peak, by which a response may differ from a linear one
CHAOS: Final = 0.1  # likewise: it is not linear at all
CHANGED: Final = 2e-2  # of the peak, by which that to a later pulse differs once the loops have
LATER: Final = 5  # [ticks] by which this pulse is later, or a period
EXPLOSION: Final = 10.0  # growth from a third to the next: a longer window shows where it saturates
RUN_SIZE: Final = 1e-5  # of a pulse in runs that may become unstable, or within which a run rests
LARGE: Final = 1e2  # growth from the begin of the run to its end, also where it saturates
DECIDED: Final = 1.2  # growth from one third to the next, or its inverse, by which it is clear
LEAST: Final = 20  # samples of a response
POSITIONS: Final = "qpos"  # the plant's output with the joints' positions
SPEEDS: Final = "qvel"  # likewise
POSE: Final = ("hand_xpos", "hand_xquat")  # likewise of the hand


Filters = tuple[Array, Array]  # b and a (taps, n), with a[0] = 1: a filter in each of n loops


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses to a pulse of 1, of one period, at the input of each of n loops."""

    inputs: tuple[str, ...]  # (n,)
    positions: tuple[str, ...]  # of the joints that they move (n,), or none if these are unknown
    at: float  # [s] the instant
    period: float  # [s] between two updates of what feeds the inputs
    pulses: Array  # (ticks, n + outputs, n) what feeds the inputs, then the outputs; by input
    linearity: float  # of twice a pulse at all inputs, half its response [share of the peak]
    changed: bool  # whether they end before a contact or a limit changes them
    outputs: tuple[str, ...] = ()  # of the plant: positions, then others

    @property
    def window(self) -> float:
        """Length of the responses [s]."""
        return len(self.pulses) * self.period

    @property
    def states(self) -> list[int]:
        """Which of the outputs may be states: positions and speeds."""
        kinds = [signal_of(name).rpartition(".")[2] for name in self.outputs]
        return [i for i, kind in enumerate(kinds) if kind in (POSITIONS, SPEEDS)]

    @cached_property
    def sensitivity(self) -> Sensitivity:
        """S = 1 / (1 + L) of the n loops."""
        return Sensitivity(self.pulses[:, : len(self.inputs)], self.period)

    def of_plant(self, ticks: int) -> Array:
        """Return the outputs (ticks, outputs, n) after a pulse of 1 that nothing is fed back of."""
        n = len(self.inputs)
        entering, leaving = self.pulses[:ticks, :n].copy(), self.pulses[:ticks, n:].copy()
        entering[0] += np.eye(n)
        first = np.linalg.inv(entering[0])
        for tick in range(len(leaving)):
            before = np.einsum("tij,tjk->ik", leaving[:tick], entering[tick:0:-1])
            leaving[tick] = (leaving[tick] - before) @ first
        return leaving

    @property
    def remaining(self) -> float:
        """Share of the peak that is left at the end of the window."""
        return _course(self.sensitivity.pulses)[0]

    @property
    def growth(self) -> float:
        """Factor per period by which the answers change, from the middle third to the last."""
        return float(_course(self.sensitivity.pulses)[1] ** (1.0 / max(len(self.pulses) // 3, 1)))

    @property
    def linear(self) -> bool:
        """Whether answers depend on a pulse's size almost linearly; else they say little."""
        return self.linearity <= CHAOS

    @property
    def unstable(self) -> bool:
        """Whether the answers grow, by themselves or before a contact or a limit changes them."""
        remaining, growth = _course(self.sensitivity.pulses)
        return remaining > ENOUGH and growth > (EXPLOSION if self.changed else 1.0)


def _course(answers: Array) -> tuple[float, float]:
    """Share of the peaks that is left at the end, and the growth from one third to the last."""
    sizes = np.abs(answers).reshape(*answers.shape[:2], -1).max(axis=2)
    if not sizes.any(axis=0).all():  # one has not answered yet
        return 1.0, 1.0
    shares = (sizes / sizes.max(axis=0)).max(axis=1)
    _, middle, last = (part.max(initial=0.0) for part in np.array_split(shares, 3))
    left = shares[-max(len(shares) // 10, 1) :].max()
    return float(left), float(last / middle) if middle else 0.0


@contextmanager
def opened(prepared: Prepared, inputs: Inputs, tick: int, loop: str = "") -> Iterator[Measurement]:
    """Step a system to a tick of the run, from where it is measured; `loop`: see `_targets`."""
    system, step = prepared.assembly.system, prepared.scenario.step
    targets = _targets([connection.target for connection in system.connections], loop or "plant")
    with prepared.open([], longer=WINDOWS[-1] * step) as running:
        running.master.begin(lambda _rows: None)
        running.master.step(tick, inputs)
        external = inputs[tick : tick + (WINDOWS[-1] if tick else 1)]  # the start is at rest
        after = ((0, WINDOWS[-1] - len(external)), (0, 0))  # from the end, commands stay
        perturbed = PerturbedSystem(running, targets, np.pad(external, after, mode="edge"))
        yield Measurement(perturbed, targets, prepared, tick)


def _targets(fed: Sequence[Name], loop: str) -> list[Name]:
    """Inputs at which the loops are opened: one, those of an array, or all of an instance."""
    names = {target: ".".join(target) for target in fed}
    chosen = [t for t, name in names.items() if loop in (name, signal_of(name), t[0])]
    if not chosen:
        valid = list(dict.fromkeys(map(signal_of, names.values())))
        must = f"must be an input that an FMU feeds: {', '.join(valid) or 'there is none'}"
        refuse("--loop", loop, must, valid)
    return chosen


class Measurement:
    """Measures the responses of a system that has been stepped to some tick."""

    def __init__(
        self, system: PerturbedSystem, targets: Sequence[Name], prepared: Prepared, tick: int
    ) -> None:
        self._system, self._targets, self._step = system, targets, prepared.scenario.step
        self._instant = prepared.assembly.start_time + tick * self._step
        self._read = {connection.source for connection in prepared.assembly.system.connections}
        self._nothing = np.empty((0, len(targets)))
        self._resize(WINDOWS[0])
        again = system.run(np.zeros_like(self._nothing))
        if (changes := np.argwhere(again != self._base)).size:
            instance, variable = system.columns[changes[0, 1]]
            raise InputError(
                f"{instance}: {variable} differs after its state was restored; its FMU must save "
                "all that its outputs depend on"
            )
        self._scale = np.maximum(1.0, np.abs(self._base[0, system.fed_by]))

    def responses(self) -> Responses:
        """Find the loops, choose the pulses' size and the window, then apply one after another."""
        system, loops = self._system, self._find_loops()
        self._loops, positions = loops, self._positions(loops)
        others = self._others(loops, positions)
        places = [system.columns.index(place) for place in (*positions, *others)]
        columns = [*(system.fed_by[i] for i in loops), *places]
        inputs, moved, seen = (
            tuple(map(".".join, names))
            for names in ([self._targets[i] for i in loops], positions, (*positions, *others))
        )
        about, tried = (inputs, moved, self._instant, self._at.step * self._step), []
        for self._size in SIZES:  # the largest to which answers are linear, or the most linear one
            tried.append(Responses(*about, *self._measured(loops, columns), seen))
            if tried[-1].linearity <= LINEAR:
                break
        return min(tried, key=lambda each: each.linearity)

    def bears(self, filters: Filters) -> bool | None:
        """Whether the loops stay stable with a filter in each, by runs with a pulse at all inputs.

        None: it is not decided within 2,000 ticks, or 500 where the arm moves. What diverges until
        an FMU fails is not stable.
        """
        fed_by, self._size = [self._system.fed_by[i] for i in self._loops], RUN_SIZE
        moves = np.ptp(self._base[:, fed_by] / self._scale[self._loops], axis=0).max() > RUN_SIZE
        for window in WINDOWS[: 2 if moves else 4]:
            self._resize(window)
            try:
                answers = self._answers(self._loops, fed_by, change=self._filtered(*filters))
            except SimulationError:
                return False
            left, growth = _course(answers[..., None])
            if left <= DECAYED:
                return True
            begin, end = (np.abs(part).max() for part in np.array_split(answers, 50)[::49])
            if growth > EXPLOSION or end > LARGE * begin:
                return False
        return None if 1.0 / DECIDED < growth < DECIDED else bool(growth < 1.0)

    def _filtered(self, forward: Array, backward: Array) -> Change:
        """Filter what feeds the loops' inputs, as far as it differs from what does in the run."""
        fed, loops, taps = self._system.fed_by, self._loops, np.arange(1, len(forward))
        base, delays = self._base[:, fed], taps * self._at.step
        entered, left = np.zeros_like(base), np.zeros_like(base)
        b, a = (np.zeros((len(forward), len(fed))) for _ in range(2))
        b[0] = 1.0
        b[:, loops], a[:, loops] = forward, backward
        held = np.zeros(len(fed))  # of what entered before

        def change(rows: Array) -> tuple[Array, Array]:
            nonlocal held
            tick = len(rows)
            if tick:
                entered[tick - 1] = rows[-1, fed] - base[tick - 1]
                left[tick - 1] = b[0] * entered[tick - 1] + held
            before = tick - delays
            n, before = taps[before >= 0], before[before >= 0]
            held = (b[n] * entered[before] - a[n] * left[before]).sum(axis=0)
            return b[0], (1.0 - b[0]) * base[tick] + held

        return change

    def _find_loops(self) -> list[int]:
        """Inputs that have an effect, and whose feeding output answers; sets the period."""
        for window in WINDOWS:
            self._resize(window)
            rows = self._system.run(SIZES[-1] * self._scale + self._nothing) - self._base
            answers = rows[:, self._system.fed_by]
            changes = np.flatnonzero(np.diff(answers, axis=0).any(axis=1)) + 1
            if len(changes) > 2:
                length = int(np.gcd.reduce(np.diff(changes)))
                self._at = slice(int(changes[0]) % length, None, length)
                answering = [int(i) for i in np.flatnonzero(answers.any(axis=0))]
                columns, self._size = [self._system.fed_by[i] for i in answering], SIZES[-1]
                loops = [i for i in answering if self._answers([i], columns).any()]
                if loops:
                    return loops
        raise InputError(
            f"{', '.join(map('.'.join, self._targets))}: a pulse there causes no response "
            f"within {WINDOWS[-1] * self._step:g} s; there is no loop"
        )

    def _positions(self, loops: Sequence[int]) -> list[Name]:
        """Positions of the joints that the inputs move, which have the same numbers."""
        targets = [self._targets[i] for i in loops]
        places = [(fmu, POSITIONS + name.removeprefix(signal_of(name))) for fmu, name in targets]
        return places if set(places) <= set(self._system.columns) else []

    def _others(self, loops: Sequence[int], positions: Sequence[Name]) -> list[Name]:
        """Other outputs of the plant: the joints' speeds, the hand's pose, and what is read.

        Of a plant without such names, it is all that is read.
        """
        plant = self._targets[loops[0]][0]
        speeds = [(fmu, name.replace(POSITIONS, SPEEDS)) for fmu, name in positions]
        own = [c for c in self._system.columns if c[0] == plant and c not in positions]
        joints = [c for c in own if c in self._read and signal_of(c[1]) in (POSITIONS, SPEEDS)]
        known = [c for c in own if c in speeds or c in joints or signal_of(c[1]) in POSE]
        return known or [c for c in own if c in self._read]

    def _measured(self, loops: Sequence[int], columns: Sequence[int]) -> tuple[Array, float, bool]:
        """Lengthen the window until answers to each pulse decay, change or are not linear."""
        returning, pulses, linearity, enough = columns[: len(loops)], np.empty(0), 0.0, False
        for window in WINDOWS:
            self._resize(window)
            longer = np.stack([self._answers([i], columns) for i in loops], axis=-1)
            answers = self._answers(loops, returning)
            end = self._first_change(answers, loops, returning)
            changed = end < len(longer)
            if changed and enough:  # the window before was long enough
                break
            pulses, twice = longer[:end], self._answers(loops, returning, 2.0)
            linearity = _difference(answers, twice)
            remaining, growth = _course(pulses[:, : len(loops)])
            enough = remaining <= ENOUGH
            decayed = len(longer) > LEAST and (remaining <= DECAYED or growth > EXPLOSION)
            if decayed or changed or linearity > CHAOS:
                break
        return pulses / self._scale[loops], linearity, changed

    def _first_change(self, answers: Array, loops: Sequence[int], columns: Sequence[int]) -> int:
        """Row at which answers first differ from those to a later pulse, or their number.

        Where the loops do not change, they are the same, only later.
        """
        late = math.ceil(LATER / self._at.step)
        later = self._answers(loops, columns, late=late)[late:]
        apart = np.abs(later - answers[: len(later)]) / self._scale[loops]
        bound = CHANGED * (np.abs(answers) / self._scale[loops]).max()
        rows = np.flatnonzero((apart > bound).any(axis=1))
        return max(int(rows[0]), 1) if rows.size else len(answers)

    def _resize(self, ticks: int) -> None:
        if ticks != len(self._nothing):
            self._nothing = np.zeros((ticks, len(self._targets)))
            self._base = self._system.run(self._nothing)

    def _answers(
        self,
        inputs: Sequence[int],
        columns: Sequence[int],
        factor: float = 1.0,
        late: int = 0,
        change: Change | None = None,
    ) -> Array:
        """Return the responses (ticks, columns) to a pulse at some inputs, of one period."""
        added, first = self._nothing.copy(), self._at.start + late * self._at.step
        size = factor * self._size
        added[first : first + self._at.step, inputs] = size * self._scale[inputs]
        return (self._system.run(added, change) - self._base)[self._at, columns] / size


def _difference(one: Array, other: Array) -> float:
    """Largest difference of responses, as a share of each one's peak."""
    peaks = np.abs(one).max(axis=0, initial=0.0)
    differences = np.abs(one - other).max(axis=0, initial=0.0)
    return float((differences[peaks > 0] / peaks[peaks > 0]).max(initial=0.0))
