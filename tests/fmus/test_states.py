"""States of our FMUs: whatever is called in between, they are those of a twin that saves none."""

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_instance import MODELS, OK, Instance, Unpacked, unpacked
from fmu_support import in_process
from panda_cosim.fmus.sources.targets import Kind

TICKS = 160  # at a model's step of 2 ms, bodies fall asleep from the 80th on, and wake again
# What is called, in which of two instances, and how far or which output or state.
CALLS = st.tuples(
    st.sampled_from(["step", "read", "save", "restore"]), st.integers(0, 1), st.integers(0, 999)
)


class Walker:
    """Two instances that go through one course; each reads what it is told to, and no more."""

    def __init__(self, fmu: Unpacked) -> None:
        self.fmu, self.names = fmu, fmu.names("output")
        self.it = [Instance(fmu).start(), Instance(fmu).start()]
        self.at = [0, 0]  # ticks
        self.states: list[tuple[int, bytes]] = []

    def call(self, what: str, which: int, number: int) -> Iterator[tuple[int, str, Any]]:
        """Do one thing; yields tick, output and value if that is to read one."""
        it = self.it[which]
        if what == "step":
            for _ in range(min(number % 40, TICKS - self.at[which])):
                it.play_unread(self.at[which])
                self.at[which] += 1
        elif what == "read":
            name = self.names[number % len(self.names)]
            yield self.at[which], name, it.get(name)
        elif what == "save":
            state = it.save()
            self.states.append((self.at[which], it.serialize(state)))
            assert it.drop(state) == OK
        elif self.states:
            self.at[which], content = self.states[number % len(self.states)]
            status, state = it.deserialize(content)
            assert status == it.load(state) == it.drop(state) == OK


def walk(kind: Kind, name: str, version: int, courses: list[list[Any]]) -> list[Any]:
    """What differs from the twin's values: tick, output, value and the twin's."""
    fmu = unpacked(kind, name, version)
    twin = Instance(fmu).start()
    rows = [{name: twin.get(name) for name in fmu.names("output")}]
    for tick in range(TICKS):
        twin.play_unread(tick)
        rows.append({name: twin.get(name) for name in rows[0]})
    return [
        (tick, output, value, rows[tick][output])
        for course in courses
        for walker in [Walker(fmu)]
        for step in course
        for tick, output, value in walker.call(*step)
        if value != rows[tick][output]
    ]


@pytest.mark.parametrize(("kind", "name"), MODELS)
@settings(max_examples=1, deadline=None)
@given(
    version=st.sampled_from([2, 3]),
    courses=st.lists(st.lists(CALLS, min_size=10, max_size=40), min_size=4, max_size=4),
)
def test_values_are_those_of_a_twin_that_saves_nothing(kind, name, version, courses):
    assert in_process(walk, kind, name, version, courses) == []


@pytest.mark.parametrize(("kind", "name"), MODELS)
def test_an_output_that_was_never_read_is_in_a_state(kind, name):
    """Saved first, then read, restored, and read again, after steps in between, and elsewhere."""
    walks = [
        [["step", 0, 30], ["save", 0, 0], ["read", 0, i], ["step", 0, 30], ["restore", 0, 0],
         ["read", 0, i], ["restore", 1, 0], ["read", 1, i]]
        for i in range(0, 60, 7)
    ]  # fmt: skip
    assert in_process(walk, kind, name, 3, walks) == []
