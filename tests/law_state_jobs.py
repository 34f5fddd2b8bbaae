"""What is done with a law's FMU and its states, in a process of its own."""

from __future__ import annotations

import json
import os
import pickle
import struct
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmu_jobs import TICK, Instance
from native_support import forged
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.packaging.build import build_one
from panda_cosim.fmus.packaging.law import law_fmu, law_interface, read_law

LAW = '''
import threading
from collections import deque
from string import Template
import numpy as np
from my_filter import Filter

class Stage:
    """A class in the law's file."""
    def __init__(self):
        self.sum, self.filter = 0.0, Filter()

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
        self.random, self.stage = np.random.default_rng(3), Stage()
        if self.lock:
            self.thing = threading.Lock()
        if self.objects:
            self.things = np.array([None])

    def update(self, time, qpos):
        self.ticks += 1
        self.line.append(self.random.normal())
        self.square = np.asfortranarray(self.square @ self.square / 3 + 0.1)
        self.table[1] = (self.table[1][0] + self.whole[2] * self.one, [time])
        self.stage.sum += self.stage.filter.put(self.line[0])
        return [self.square[0, 1] % 1, self.stage.sum, *self.line, self.table[1][0], self.ticks, 0]
'''
FILTER = """
class Filter:
    def __init__(self):
        self.kept = 0.0
    def put(self, value):
        self.kept += 0.1 * (value - self.kept)
        return self.kept
"""


def _fmu(folder: str) -> Fmu:
    Path(folder, "my_law.py").write_text(LAW)
    Path(folder, "my_filter.py").write_text(FILTER)
    law = read_law(Path(folder, "my_law.py"), "Law")
    interface = law_interface(law, PLANT.variable, PLANT.variable("ctrl"))
    return Fmu(build_one(law_fmu(law, interface, (0.0,) * 8)))


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


def forge(folder: str) -> list[str]:
    """Restore states that somebody has made up; returns the reasons of refusal."""
    mark, it = Path(folder, "run"), Instance(_fmu(folder)).start()
    _go(it, 0)
    data = it.serializeFMUstate(it.getFMUstate())
    start = data.index(b"[10, 0.0, ")
    good = json.loads(data[start:])

    class Evil:
        def __reduce__(self) -> tuple[object, ...]:
            return os.mkdir, (str(mark),)

    def with_stage(stage: object) -> bytes:
        return json.dumps([10, 0.0, good[2] | {"stage": stage}]).encode()

    made_up = [
        pickle.dumps((10, 0.0, {"x": Evil()})),
        b"",
        b"\xff{",
        b"[1, 2]",
        b'[1, "x", {}]',
        b'[1, 0.0, {"a": {}}]',
        b"[" * 100_000,
        with_stage({"object": "threading", "of": {}}),
        with_stage({"object": "Template", "of": {}}),
        with_stage({"object": "nothing", "of": {}}),
        with_stage({"array": ["|O", [1], "C", "00" * 8], "scalar": False}),
        with_stage({"array": ["<f8", [2**40], "C", "00" * 8], "scalar": False}),
        with_stage({"generator": {"dict": [["bit_generator", "system"]]}}),
        with_stage({"generator": {"dict": [["bit_generator", "seed"]]}}),  # a function of numpy
        with_stage({"eval": ["1"]}),
    ]
    random = np.random.get_state()[1].tolist()  # type: ignore[index]
    for content in made_up:
        head = bytearray(data[:start])
        struct.pack_into("<Q", head, 16, start + len(content))  # the header's size
        struct.pack_into("<Q", head, 40, len(content))  # and model_size
        state = it.deSerializeFMUstate(forged(bytes(head) + content))
        with pytest.raises(FMICallException):
            it.setFMUstate(state)
        assert not mark.exists()
        assert np.random.get_state()[1].tolist() == random  # type: ignore[index]
    it.setFMUstate(it.deSerializeFMUstate(data))  # the instance is as good as before
    _go(it, 10)
    return [text for _, _, text in it.log if "state" in text]


def refuse(folder: str, switch: str) -> str:
    """Save a law that holds what cannot be saved; returns the reason."""
    it = Instance(_fmu(folder)).start({switch: True})
    with pytest.raises(FMICallException):
        it.getFMUstate()
    _go(it, 0)  # it can go on
    return it.log[-1][2]
