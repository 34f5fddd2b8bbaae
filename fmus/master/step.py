"""The master's step: from the values at t_k to those at t_k+1 = t_k + step size.

All values are in the rows of the recording: slaves set their inputs from row k, and write their
outputs to row k or k + 1. There is no other copy of them.

Gauss-Seidel: a slave that feeds a later one is a leader, such as the controller, which feeds the
plant. Its outputs act within the same step. The other slaves are followers.
Jacobi: there are no leaders, so all outputs act one step later.
Iterated: the step is repeated, with the outputs at its end as inputs, until these no longer change.

What is called here are FMPy's own methods, on views of the rows (calls.py). `Kernel` (kernel.py)
makes the same calls in C, many ticks at a time, and gives the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Literal

import numpy as np

from ..errors import InputError, SimulationEndedError, SimulationError
from .wiring import ROUNDING, Array, BoundSlave, SlowSlave, can_step

Coupling = Literal["gauss-seidel", "jacobi", "iterated"]
SWITCHED: tuple[Coupling, ...] = ("gauss-seidel", "jacobi")  # also during a run
COUPLINGS: tuple[Coupling, ...] = (*SWITCHED, "iterated")
Stepper = Literal["kernel", "fmpy"]  # what makes the calls: C where it can, or FMPy's methods
ITERATIONS: Final = ("coupling", "iterations")  # name of their column
MOST_ITERATIONS: Final = 100
TOLERANCE: Final = 1e-10  # change of an output by an iteration; relative, or absolute below 1


class Step:
    """One communication step of a coupled system.

    The master makes one for each coupling that it is given. It keeps no values and no time: all are
    in the rows.
    """

    ended: SimulationEndedError | None = None  # by an FMU, at the end of a step

    def __init__(
        self,
        slaves: Sequence[BoundSlave],  # in the order of stepping
        coupling: Coupling,
        size: float,  # [s]
        rows: Array,  # (n, columns) that the slaves are bound to
        complete: Callable[[int], None],  # called with a row's index before followers read it
    ) -> None:
        if coupling not in COUPLINGS:
            raise InputError(f"coupling: {coupling!r}; valid: {', '.join(COUPLINGS)}")
        self.leaders = _leaders(slaves) if coupling == "gauss-seidel" else []
        self.followers = [slave for slave in slaves if slave not in self.leaders]
        for slave in slaves:
            if isinstance(slave.slave, SlowSlave):
                slave.slave.leads = slave in self.leaders
        self.leader_columns = _columns(self.leaders)
        # Columns of outputs that a leader or an earlier one reads in the next step.
        self.fed_back = _columns(_feeding_back(self.leaders))
        inputs = {column for slave in slaves for column in slave.inputs}
        self._fed = sorted(inputs.intersection(_columns(slaves)))
        self.size, self._rows, self.complete = size, rows, complete

    def take(self, row: int, time: float) -> None:
        """Step from `time` [s]; its row has the external inputs and the followers' outputs."""
        for leader in self.leaders:
            leader.set_inputs(row)
            self._step(leader, time)
            leader.get_outputs(row)
        self.complete(row)
        for follower in self.followers:
            follower.set_inputs(row)
        for follower in self.followers:
            self._step(follower, time)
        for follower in self.followers:
            follower.get_outputs(row + 1)
        if self.fed_back:  # read by this or an earlier leader in the next step
            self._rows[row + 1, self.fed_back] = self._rows[row, self.fed_back]

    def _step(self, slave: BoundSlave, time: float) -> None:
        """Step a slave; one that ends the simulation at the step's end lets the others finish."""
        try:
            slave.step(time, self.size)
        except SimulationEndedError as ended:
            if ended.reached < time + (1.0 - ROUNDING) * self.size:
                raise
            self.ended = ended

    def finish(self, row: int, time: float) -> None:
        """Complete the last row: leaders that may go beyond it step, the others are only read."""
        for leader in self.leaders:
            leader.set_inputs(row)
            if self.ended is None and can_step(leader.slave, time, self.size):
                leader.step(time, self.size)
            leader.get_outputs(row)


class IteratedStep(Step):
    """A step that is repeated, by Aitken's method, until outputs and inputs at its end agree.

    Inputs from outside are those at its end, too. What is not a real number, such as a text, takes
    part as it is.
    """

    def take(self, row: int, time: float) -> None:
        """Step from `time` [s]."""
        self.complete(row)
        now, end = self._rows[row], self._rows[row + 1]
        end[self._fed] = now[self._fed]
        for slave in self.followers:
            slave.slave.save_state()
        count, worst = settle(end, self._fed, lambda: self._iterate(row + 1, time), self._go_back)
        if worst is None:
            end[-1] = count
            return
        slave = next(slave for slave in self.followers if worst in slave.outputs)
        raise SimulationError(
            f'coupling = "iterated": {MOST_ITERATIONS} iterations do not settle to a change of '
            f"{TOLERANCE:g}",
            time=time,
            instance=slave.slave.name,
            variable=slave.names[slave.outputs.index(worst)],
        )

    def _go_back(self) -> None:
        for slave in self.followers:
            slave.slave.restore_state()

    def _iterate(self, row: int, time: float) -> None:
        """Take the step with the inputs at its end."""
        self.ended = None
        for slave in self.followers:
            slave.set_inputs(row)
            self._step(slave, time)
            slave.get_outputs(row)


def settle(
    row: Array,
    columns: Sequence[int],  # that are fed
    iterate: Callable[[], None],
    go_back: Callable[[], None] = lambda: None,  # before the next iteration
    plain: int = 1,  # iterations without Aitken's method, which takes real numbers alone
) -> tuple[int, int | None]:
    """Iterate until a row agrees with itself; returns how often, and a column that does not."""
    reals = [column for column in columns if isinstance(row[column], float)]
    others = sorted({*columns}.difference(reals))
    share, change = 1.0, np.zeros(len(reals))
    for count in range(1, MOST_ITERATIONS + 1):
        guess, held, before = row[reals].astype(np.float64), row[others].tolist(), change
        iterate()
        after = row[reals].astype(np.float64)
        change = after - guess
        settled = np.abs(change) <= TOLERANCE * np.maximum(1.0, np.abs(after))  # not if NaN
        changed = [c for c, old in zip(others, held, strict=True) if row[c] != old]
        if settled.all() and not changed:
            return count, None
        difference = change - before
        if count > plain and difference.any():
            share *= -float(before @ difference) / float(difference @ difference)
        row[reals] = guess + share * change
        go_back()
    worst = (changed or reals)[0 if changed else int(np.argmax(np.abs(change)))]
    return MOST_ITERATIONS, worst


def _leaders(slaves: Sequence[BoundSlave]) -> list[BoundSlave]:
    """Slaves that feed a later one."""
    return [slave for i, slave in enumerate(slaves) if any(map(slave.feeds, slaves[i + 1 :]))]


def _feeding_back(leaders: Sequence[BoundSlave]) -> list[BoundSlave]:
    """Leaders that feed themselves or an earlier leader."""
    return [leader for i, leader in enumerate(leaders) if any(map(leader.feeds, leaders[: i + 1]))]


def _columns(slaves: Sequence[BoundSlave]) -> list[int]:
    return [column for slave in slaves for column in slave.outputs]
