"""Steps of a system from one state, again and again, with something added to some inputs."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..errors import InputError, SimulationError
from .fmu import FmuSlave
from .kernel import make_kernel
from .step import Step
from .system import OpenSystem
from .wiring import Array, Name, Slave, SlowSlave, bind

# From the rows so far, factors of what feeds the targets in this tick, and what is added (targets,)
Change = Callable[[Array], tuple[Array, Array]]


class PerturbedSystem:
    """A system that goes back to some tick before each run, with values added to named inputs."""

    def __init__(
        self,
        opened: OpenSystem,
        targets: Sequence[Name],  # inputs to which something is added, each fed by an output
        external: Array,  # external inputs from this tick on (n, external)
    ) -> None:
        master = opened.master
        self.columns = [("", "time"), *master.columns]  # of a row
        self._rows = np.zeros((len(external) + 1, len(self.columns)))
        self._back = [_save(slave) for slave in master.slaves]  # before the kernel is made
        fed = {each.target: each for each in master.system.connections}
        self._fed = [fed[target] for target in targets]
        self.fed_by = [self.columns.index(each.source) for each in self._fed]
        # Values are added as offsets of the connections, which `run` changes in place.
        varied = fed | {each.target: replace(each, offset=math.nan) for each in self._fed}
        system = replace(master.system, connections=list(varied.values()))
        bound = bind(master.slaves, master.columns, system, self._rows)
        linear = {(b.slave.name, name): pair for b in bound for name, pair in b.linear.items()}
        self._linear = [linear[target] for target in targets]
        self._step = Step(bound, master.coupling, master.step_size, self._rows, lambda _row: None)
        self._checked = master.checked
        stop, self._tick = ctypes.c_int32(), master.steps
        self._kernel = make_kernel(self._step, self._rows, master.start, stop)
        self._rows[0] = master.latest()
        self._rows[:-1, 1 : 1 + len(system.external)] = external
        ticks = self._tick + np.arange(len(self._rows))
        self._rows[:, 0] = master.start + ticks * master.step_size
        self._start = self._rows.copy()

    def run(self, added: Array, change: Change | None = None) -> Array:
        """Go back and take steps with values added (n, targets); returns rows (n, columns).

        If there is a change, it multiplies what feeds the targets by a factor, and adds to it.
        """
        ticks = len(added)
        self._rows[: ticks + 1] = self._start[: ticks + 1]
        for go_back in self._back:
            go_back()
        rows = np.flatnonzero(np.diff(added, axis=0).any(axis=1)) + 1
        begins = range(ticks) if change else [0, *map(int, rows)]
        factors, more = np.ones(len(self._fed)), np.zeros(len(self._fed))
        for row, end in zip(begins, [*begins[1:], ticks], strict=True):
            if change:
                factors, more = change(self._rows[:row])
            values = added[row] + more
            for i, (each, pair) in enumerate(zip(self._fed, self._linear, strict=True)):
                pair[:] = each.factor * factors[i], each.offset + each.factor * values[i]
            self._advance(row, end)
        taken: Array = self._rows[:ticks].copy()
        if not np.isfinite(taken[:, self._checked]).all():
            raise SimulationError("an output is not finite after a pulse at an input")
        return taken

    def _advance(self, row: int, end: int) -> None:
        """Take the steps of some rows, in C if possible."""
        while row < end:
            if self._kernel is None:
                self._step.take(row, float(self._rows[row, 0]))
                row += 1
            else:
                row += self._kernel.take(self._tick + row, row, end - row)[0]
                self._kernel.check(float(self._rows[row, 0]))


def _save(slave: Slave) -> Callable[[], None]:
    """Save the state; returns a function that goes back to it, as often as it is called."""
    fmu = slave.slave if isinstance(slave, SlowSlave) else slave
    if not isinstance(fmu, FmuSlave):
        raise InputError("isolate: states of an isolated FMU cannot be restored; must be False")
    fmu.fmu.check_restorable(fmu.name)
    slave.save_state()
    return slave.restore_state
