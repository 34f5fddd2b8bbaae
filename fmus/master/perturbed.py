"""Steps a coupled system again and again from one state, with something added to some inputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..errors import InputError, SimulationError
from .fmu import FmuSlave
from .step import Step
from .system import Instance, OpenSystem
from .wiring import Array, Exchange, Name, bind


class PerturbedSystem:
    """A system that has been stepped to some tick, to which it goes back before each run.

    What is added acts on the named inputs alone: outputs are recorded, and reach other inputs, as
    their FMU gave them.
    """

    def __init__(
        self,
        opened: OpenSystem,
        targets: Sequence[Name],  # inputs to which something is added, each fed by an output
        external: Array,  # external inputs from this tick on (n, external)
    ) -> None:
        master = opened.master
        self.columns = [("", "time"), *master.columns]  # of a row
        self._rows = np.zeros((len(external) + 1, len(self.columns)))
        slaves = opened.slaves
        self._back = [_save(slave) for slave in slaves.values()]  # before `step` is bound
        bound = bind(
            list(slaves.values()), master.columns, master.external, master.connections, self._rows,
            master.multiples,
        )  # fmt: skip
        sources = {each.target: each.source for each in master.connections}
        self.fed_by = [self.columns.index(sources[target]) for target in targets]
        for name, slave in zip(slaves, bound, strict=True):
            own = [i for i, target in enumerate(targets) if target[0] == name]
            if own:
                slave.set_inputs = self._adding(slave.set_inputs, own)
        self._step = Step(bound, master.coupling, master.step_size, self._rows, lambda _row: None)
        self._rows[0] = master.latest()
        self._rows[:-1, 1 : 1 + len(master.external)] = external
        ticks = master.steps + np.arange(len(self._rows))
        self._rows[:, 0] = master.start + ticks * master.step_size
        self._start = self._rows.copy()

    def _adding(self, set_inputs: Exchange, own: Sequence[int]) -> Exchange:
        """Make a function that sets the inputs of one FMU, with what is added to them."""
        columns = [self.fed_by[i] for i in own]

        def put(row: int) -> None:
            values = self._rows[row, columns]
            self._rows[row, columns] = values + self._added[row, own]
            set_inputs(row)
            self._rows[row, columns] = values

        return put

    def run(self, added: Array) -> Array:
        """Go back and take steps with values added (n, targets); returns rows (n, columns)."""
        self._added, ticks = added, len(added)
        self._rows[:] = self._start
        for go_back in self._back:
            go_back()
        for tick in range(ticks):
            self._step.take(tick, float(self._rows[tick, 0]))
        rows: Array = self._rows[:ticks].copy()
        if not np.isfinite(rows).all():
            raise SimulationError("an output is not finite after something was added to an input")
        return rows


def _save(slave: Instance) -> Callable[[], None]:
    if not isinstance(slave, FmuSlave):
        raise InputError("isolate: does not go with states that are returned to; must be False")
    return slave.save()
