"""What is done with a law's FMU and its states, in a process of its own."""

from __future__ import annotations

from pathlib import Path

import pytest
from fmpy.fmi1 import FMICallException
from fmu_jobs import TICK, Instance
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.fmus.sources.law import law_fmu, law_interface, read_law
from panda_cosim.fmus.sources.targets import build_fmu

LAW = '''
import threading
from collections import deque
import numpy as np

class Law:
    """Uses everything that a state can hold."""
    lock = False
    objects = False

    def start(self):
        self.ticks, self.name, self.nothing, self.odd = 0, "ä", None, float("nan")
        self.line = deque([0.0] * 3, 3)
        self.square = np.asfortranarray(np.arange(9.0).reshape(3, 3) / 7)
        self.whole, self.yes, self.one = np.arange(3), np.array([True]), np.float64(1 / 3)
        self.table = {1: (2.0, [3.0]), "set": {4.0}}
        self.sum = 0.0
        if self.lock:
            self.thing = threading.Lock()
        if self.objects:
            self.things = np.array([None])

    def update(self, time, qpos):
        self.ticks += 1
        self.line.append(self.line[0] / 2 + self.ticks / 7)
        self.square = np.asfortranarray(self.square @ self.square / 3 + 0.1)
        self.table[1] = (self.table[1][0] + self.whole[2] * self.one, [time])
        self.sum += 0.1 * (self.line[0] - self.sum)
        return [self.square[0, 1] % 1, self.sum, *self.line, self.table[1][0], self.ticks, 0]
'''


def _fmu(folder: str) -> Fmu:
    Path(folder, "my_law.py").write_text(LAW)
    law = read_law(Path(folder, "my_law.py"), "Law")
    interface = law_interface(law, PLANT.variable, PLANT.variable("ctrl"))
    return Fmu(build_fmu(law_fmu(law, interface, (0.0,) * 8)))


def _go(it: Instance, first: int) -> list[list[float]]:
    rows = []
    for tick in range(first, first + 10):
        it.doStep(tick * TICK, TICK)
        rows.append(it.outputs())
    return rows


def restore(folder: str) -> bool:
    """Replay from a state, in the same and in another instance; returns whether bits are equal."""
    fmu = _fmu(folder)
    it, other = Instance(fmu).start(), Instance(fmu, "other").start()
    _go(it, 0)
    _go(other, 0)
    _go(other, 10)
    data = it.serializeFMUstate(it.getFMUstate())
    expected = _go(it, 10)
    for one in (it, other):
        one.setFMUstate(one.deSerializeFMUstate(data))
        assert _go(one, 10) == expected
    return True


def refuse(folder: str, switch: str) -> str:
    """Save a law that holds what cannot be saved; returns the reason."""
    it = Instance(_fmu(folder)).start({switch: True})
    with pytest.raises(FMICallException):
        it.getFMUstate()
    _go(it, 0)  # it can go on
    return it.log[-1][2]
