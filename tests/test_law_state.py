"""The state of a law's FMU restores every bit; what it cannot hold is named."""

from __future__ import annotations

from pathlib import Path

import pytest
from fmpy.fmi1 import FMICallException
from fmu_jobs import TICK, Instance
from fmu_support import Worker
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.fmus.sources.law import law_fmu, law_interface, read_law
from panda_cosim.fmus.sources.targets import build_fmu

pytestmark = pytest.mark.fmu

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


def law_of(folder: str) -> Fmu:
    Path(folder, "my_law.py").write_text(LAW)
    law = read_law(Path(folder, "my_law.py"), "Law")
    interface = law_interface(law, PLANT.variable, PLANT.variable("ctrl"))
    return Fmu(build_fmu(law_fmu(law, interface, (0.0,) * 8)))


def go_on(it: Instance, first: int) -> list[list[float]]:
    rows = []
    for tick in range(first, first + 10):
        it.doStep(tick * TICK, TICK)
        rows.append(it.outputs())
    return rows


def restore(folder: str) -> bool:
    """Replay from a state, in the same and in another instance; returns whether bits are equal."""
    fmu = law_of(folder)
    it, other = Instance(fmu).start(), Instance(fmu, "other").start()
    go_on(it, 0)
    go_on(other, 0)
    go_on(other, 10)
    data = it.serializeFMUstate(it.getFMUstate())
    expected = go_on(it, 10)
    for one in (it, other):
        one.setFMUstate(one.deSerializeFMUstate(data))
        assert go_on(one, 10) == expected
    return True


def refuse(folder: str, switch: str) -> str:
    """Save a law that holds what cannot be saved; returns the reason."""
    it = Instance(law_of(folder)).start({switch: True})
    with pytest.raises(FMICallException):
        it.getFMUstate()
    go_on(it, 0)  # it can go on
    return it.log[-1][2]


def test_a_laws_state_restores_every_bit(worker: Worker, tmp_path: Path) -> None:
    assert worker.do(restore, str(tmp_path))


@pytest.mark.parametrize(
    ("switch", "words"),
    [("lock", "self.thing holds a lock"), ("objects", "self.things holds a ndarray")],
)
def test_a_law_that_cannot_be_saved_says_which_attribute(
    worker: Worker, tmp_path: Path, switch: str, words: str
) -> None:
    text = worker.do(refuse, str(tmp_path), switch)
    assert f"{words}; must be numbers, texts" in text
