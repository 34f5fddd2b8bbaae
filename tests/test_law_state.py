"""The state of a law's FMU restores every bit."""

from ctypes import byref, c_void_p

import pytest

from fmu_instance import ERROR, OK, Instance, unpacked_fmu
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.fmus.sources.law import law_fmu, law_interface, read_law

pytestmark = pytest.mark.own_process

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


@pytest.fixture
def fmu(tmp_path):
    file = tmp_path / "my_law.py"
    file.write_text(LAW)
    law = read_law(file, "Law")
    interface = law_interface(law, PLANT.variable, PLANT.variable("ctrl"))
    return unpacked_fmu(law_fmu(law, interface, (0.0,) * 8))


def test_a_laws_state_restores_every_bit(fmu):
    it, other = Instance(fmu).start(), Instance(fmu).start()
    it.play(0, 10)
    other.play(0, 20)
    data = it.serialize(it.save())
    expected = it.play(10, 10)
    for one in (it, other):
        status, state = one.deserialize(data)
        assert status == one.load(state) == OK
        assert one.play(10, 10) == expected


@pytest.mark.parametrize(
    ("switch", "told"),
    [("lock", "self.thing holds a lock"), ("objects", "self.things holds a ndarray")],
)
def test_a_law_that_cannot_be_saved_says_which_attribute(fmu, switch, told):
    it = Instance(fmu).start({switch: [True]})
    assert it("GetFMUstate", byref(c_void_p())) == ERROR
    assert f"{told}; must be numbers, texts" in it.messages()
    it.play(0, 10)  # it can go on
