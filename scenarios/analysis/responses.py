"""Measures the loops of a scenario at an instant of its run.

Something small is added to one input of the plant, such as a servo target, for one period of the
controller. The response is the difference to what happens without it, divided by what was added.
Before each pulse, all FMUs go back to the state of that instant; commands and pushes stay as they
are then, so that the arm comes to rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError, did_you_mean
from ...fmus.master.system import PerturbedSystem
from ...fmus.master.wiring import Name
from ..run.prepare import Prepared

Array = NDArray[np.float64]

WINDOWS: Final = (250, 500, 1000, 2000, 4000)  # [ticks] the first at whose end responses decayed
DECAYED: Final = 1e-3  # of its peak, below which a response has
SIZES: Final = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # of pulses: units of the input, or its value if > 1
LINEAR: Final = 1e-3  # of its peak, by which a response may differ from a linear one
BENT: Final = 1e-2  # likewise: a longer window would no longer be of use
CHAOS: Final = 0.1  # likewise: it is not linear at all
GROWTH: Final = 1.01  # from one third of the window to the next, above which a response grows
EXPLOSION: Final = 10.0  # likewise: a longer window would only show where it saturates
LEAST: Final = 20  # samples of a response
POSITIONS: Final = "qpos"  # the plant's output with the joints' positions


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses to a pulse of 1, of one period, at the input of each of n loops."""

    inputs: tuple[str, ...]  # (n,)
    positions: tuple[str, ...]  # of the joints that they move (n,), or none if these are unknown
    period: float  # [s] between two updates of what feeds the inputs
    pulses: Array  # (ticks, n + positions, n) what feeds the inputs, then positions; by input
    linearity: float  # difference of a pulse of 2 at all inputs to the sum [share of the peak]
    motion: float  # largest change of a position without a pulse

    @property
    def window(self) -> float:
        """Length of the responses [s]."""
        return len(self.pulses) * self.period

    @property
    def remaining(self) -> float:
        """Share of the peak that is left at the end of the window."""
        return _course(self.pulses[:, : len(self.inputs)])[0]

    @property
    def growth(self) -> float:
        """Factor per period by which the answers change, in the last third of the window."""
        return float(_course(self.pulses[:, : len(self.inputs)])[1] ** (3.0 / len(self.pulses)))

    @property
    def linear(self) -> bool:
        """Whether answers depend on a pulse's size almost linearly; else they say little."""
        return self.linearity <= CHAOS

    @property
    def stable(self) -> bool:
        """Whether the answers are linear and decay, or at least do not grow."""
        remaining, growth = _course(self.pulses[:, : len(self.inputs)])
        return self.linear and (remaining <= DECAYED or growth <= GROWTH)


def _course(answers: Array) -> tuple[float, float]:
    """Share of the peaks that is left at the end, and the growth from one third to the last."""
    sizes = np.abs(answers).reshape(*answers.shape[:2], -1).max(axis=2)
    sizes = sizes[:, sizes.any(axis=0)]
    shares = (sizes / sizes.max(axis=0)).max(axis=1, initial=0.0)
    _, middle, last = (part.max() for part in np.array_split(shares, 3))
    return float(shares[-max(len(shares) // 10, 1) :].max()), float(
        last / middle
    ) if middle else 0.0


def measure(prepared: Prepared, tick: int, loop: str = "") -> Responses:
    """Measure the responses from a tick of the run on; `loop`: see `_targets`."""
    system, step = prepared.assembly.system, prepared.scenario.step
    targets = _targets([connection.target for connection in system.connections], loop)
    with prepared.open([], longer=WINDOWS[-1] * step) as opened:
        inputs = prepared.inputs()
        opened.master.begin(lambda _rows: None)
        opened.master.step(tick, inputs)
        held = np.repeat(inputs[tick : tick + 1], WINDOWS[-1], axis=0)
        perturbed = PerturbedSystem(opened, targets, held)
        return _Measurement(perturbed, targets, step).responses()


def _targets(fed: Sequence[Name], loop: str) -> list[Name]:
    """Inputs at which the loops are opened: those that are named, else all of the plant."""
    names = {target: ".".join(target) for target in fed}
    chosen = [t for t in fed if loop in (names[t], _whole(names[t]))]
    chosen = chosen if loop else [t for t in fed if t[0] == "plant"]
    if not chosen:
        valid = list(dict.fromkeys(map(_whole, names.values())))
        what = f"--loop {loop}: no FMU feeds it" if loop else "no FMU is named `plant`"
        raise InputError(
            f"{what}; --loop must name a connected input: {', '.join(valid) or 'none'}"
            f"{did_you_mean(loop, valid)}"
        )
    return chosen


def _whole(name: str) -> str:
    return name.partition("[")[0]


class _Measurement:
    """Measures the responses of a system that has been stepped to some tick."""

    def __init__(self, system: PerturbedSystem, targets: Sequence[Name], step: float) -> None:
        self._system, self._targets, self._step = system, targets, step
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
        self._choose_size(loops)
        self._choose_window(loops)
        places = [system.columns.index(place) for place in self._positions(loops)]
        columns = [*(system.fed_by[i] for i in loops), *places]
        pulses = np.stack([self._answers([i], columns) for i in loops], axis=-1)
        twice = self._answers(loops, columns, 2.0)
        motion = np.ptp(self._base[:, places], axis=0)
        return Responses(
            tuple(".".join(self._targets[i]) for i in loops),
            tuple(".".join(system.columns[place]) for place in places),
            self._at.step * self._step,
            pulses / self._scale[loops],
            _difference(twice, pulses.sum(axis=-1)),
            float(motion.max(initial=0.0)),
        )

    def _find_loops(self) -> list[int]:
        """Inputs whose feeding output answers to a step; sets the period between two answers."""
        for window in WINDOWS:
            self._resize(window)
            rows = self._system.run(SIZES[-1] * self._scale + self._nothing) - self._base
            answers = rows[:, self._system.fed_by]
            changes = np.flatnonzero(np.diff(answers, axis=0).any(axis=1)) + 1
            if len(changes) > 2:
                length = int(np.gcd.reduce(np.diff(changes)))
                self._at = slice(int(changes[0]) % length, None, length)
                return np.flatnonzero(answers.any(axis=0)).tolist()
        raise InputError(
            f"{', '.join(map('.'.join, self._targets))}: a pulse there causes no response "
            f"within {WINDOWS[-1] * self._step:g} s; there is no loop"
        )

    def _positions(self, loops: Sequence[int]) -> list[Name]:
        """Positions of the joints that the inputs move, which have the same numbers."""
        targets = [self._targets[i] for i in loops]
        places = [(fmu, POSITIONS + name.removeprefix(_whole(name))) for fmu, name in targets]
        return places if set(places) <= set(self._system.columns) else []

    def _choose_size(self, loops: Sequence[int]) -> None:
        """Choose the largest pulse to which answers are linear, else that with the most linear."""
        linearity: dict[float, float] = {}
        for self._size in SIZES:
            linearity[self._size] = _difference(*self._compared(loops))
            if linearity[self._size] <= LINEAR:
                break
        self._size = min(linearity, key=linearity.__getitem__)

    def _choose_window(self, loops: Sequence[int]) -> None:
        """Lengthen the window until answers have decayed, or are no longer linear."""
        before = 0
        for window in WINDOWS:
            self._resize(window)
            answers, twice = self._compared(loops)
            if before and _difference(answers, twice) > BENT:  # contact is made or lost, say
                self._resize(before)
                break
            remaining, growth = _course(answers)
            if len(answers) > LEAST and (remaining <= DECAYED or growth > EXPLOSION):
                break
            before = window

    def _compared(self, loops: Sequence[int]) -> tuple[Array, Array]:
        """Answers (ticks, loops) to a pulse at all loops, and half of those to twice the pulse."""
        columns = [self._system.fed_by[i] for i in loops]
        return self._answers(loops, columns), self._answers(loops, columns, 2.0)

    def _resize(self, ticks: int) -> None:
        self._nothing = np.zeros((ticks, len(self._targets)))
        self._base = self._system.run(self._nothing)

    def _answers(self, inputs: Sequence[int], columns: Sequence[int], factor: float = 1.0) -> Array:
        """Return the responses (ticks, columns) to a pulse at some inputs, of one period."""
        added, first = self._nothing.copy(), self._at.start
        size = factor * self._size
        added[first : first + self._at.step, inputs] = size * self._scale[inputs]
        answers: Array = (self._system.run(added) - self._base)[self._at, columns] / size
        return answers


def _difference(one: Array, other: Array) -> float:
    """Largest difference of responses, as a share of each one's peak."""
    peaks = np.abs(one).max(axis=0)
    return float((np.abs(one - other).max(axis=0)[peaks > 0] / peaks[peaks > 0]).max(initial=0.0))
