"""Random legal and illegal calls from C: never a crash, always a status with a logged reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import pytest
from fmu_support import (
    ERROR,
    OK,
    Answer,
    Host,
    compile_host,
    compiler,
    resources_uri,
)
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from panda_cosim.fmus.files.fmu_file import Fmu
from panda_cosim.fmus.inside.base import LOG_CATEGORIES
from panda_cosim.fmus.inside.trajectory import HOME
from panda_cosim.fmus.sources.python_fmu import python_library
from panda_cosim.fmus.sources.targets import Target, build, build_trajectory

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
    pytest.mark.skipif(python_library() is None, reason="this Python has no shared library"),
]
SLOTS = 4
NAMES = ("plant", "controller", "trajectory")
slots = st.integers(0, SLOTS - 1)
references = st.one_of(st.integers(0, 260), st.sampled_from([9999, 2**31 - 1, 2**31, 2**32 - 1]))
numbers = st.one_of(
    st.floats(-2.0, 2.0),
    st.sampled_from([float("nan"), float("inf"), -float("inf"), 1e300, -1e300, 0.0, 0.001, 5e-324]),
)
texts = st.text(st.characters(codec="utf-8", exclude_characters="\0\n\r "), max_size=20)


class Calls(RuleBasedStateMachine):
    """Four instances of three FMUs, in one host for all examples."""

    host: ClassVar[Host]
    fmus: ClassVar[list[Fmu]]

    def __init__(self) -> None:
        super().__init__()
        self.phase: dict[int, str] = {}
        self.kind: dict[int, int] = {}
        self.states: set[int] = set()

    @initialize()
    def begin(self) -> None:
        """Make one instance."""
        self.new(0, 0)

    def call(self, *words: Any) -> Answer:
        """Do a call and check what is always true."""
        answer = self.host(*words)
        assert answer.status in (OK, ERROR), answer.messages
        assert answer.status == OK or answer.messages
        for message in answer.messages:
            severity, category, name, text = message.split(" ", 3)
            assert category in LOG_CATEGORIES
            assert severity in "1234"
            assert name.startswith("slot")
            assert text
        return answer

    @rule(slot=slots, kind=st.integers(0, len(NAMES) - 1))
    def new(self, slot: int, kind: int) -> None:
        """Make an instance in an empty slot."""
        if slot in self.phase:
            return
        fmu = self.fmus[kind]
        self.call("new", slot, kind, fmu.guid, resources_uri(fmu.folder))
        self.phase[slot], self.kind[slot] = "instantiated", kind

    def live(self, slot: int) -> int | None:
        """A slot that holds an instance, or None."""
        held = sorted(self.phase)
        return held[slot % len(held)] if held else None

    @rule(slot=slots)
    def free(self, slot: int) -> None:
        """Free an instance, in whatever state it is."""
        if (found := self.live(slot)) is not None:
            self.call("free", found)
            del self.phase[found]

    @rule(slot=slots, start=st.one_of(st.just(0.0), numbers))
    def setup(self, slot: int, start: float) -> None:
        """Set up the experiment, perhaps from a time that is none."""
        if (found := self.live(slot)) is not None:
            self.call("setup", found, start, start + 1.0)

    @rule(slot=slots)
    def start(self, slot: int) -> None:
        """Go through initialization, as a good host does."""
        if (found := self.live(slot)) is not None and self.phase[found] == "instantiated":
            self.call("setup", found, 0.0, 1.0)
            self.go(found, "enter")
            self.go(found, "exit")

    @rule(slot=slots, call=st.sampled_from(["enter", "exit", "term", "reset"]))
    def go(self, slot: int, call: str) -> None:
        """Go through the phases in any order."""
        if (found := self.live(slot)) is None:
            return
        before = self.phase[found]
        answer = self.call(call, found)
        legal = {"enter": "instantiated", "exit": "initializing"}
        after = {"enter": "initializing", "exit": "stepping", "term": "terminated"}
        if call == "reset":
            self.phase[found] = "instantiated"
        elif call in legal and before in legal.values():
            assert (answer.status == OK) == (legal[call] == before)
        if answer.status == OK and call in after:
            self.phase[found] = after[call]

    @rule(slot=slots, size=st.one_of(st.sampled_from([0.001, 0.002, 0.005]), numbers))
    def step(self, slot: int, size: float) -> None:
        """Step by any size."""
        if (found := self.live(slot)) is not None:
            answer = self.call("step", found, 0.0, min(size, 0.05))
            if self.phase[found] != "stepping" or not size >= 0.0:
                assert answer.status == ERROR

    @rule(slot=slots, pairs=st.lists(st.tuples(references, numbers), max_size=30))
    def set_reals(self, slot: int, pairs: list[tuple[int, float]]) -> None:
        """Set any Reals to anything."""
        if (found := self.live(slot)) is not None:
            vrs, values = [p[0] for p in pairs], [p[1] for p in pairs]
            self.call("setr", found, len(pairs), vrs, values)

    @rule(slot=slots, vrs=st.lists(references, max_size=30), kind=st.sampled_from("rbi"))
    def get(self, slot: int, vrs: list[int], kind: str) -> None:
        """Read any variables."""
        if (found := self.live(slot)) is not None:
            answer = self.call(f"get{kind}", found, len(vrs), vrs)
            known = len(self.fmus[self.kind[found]].variables)
            if any(vr > known for vr in vrs):
                assert answer.status == ERROR

    @rule(slot=slots, vr=references, value=st.integers(-1, 2), kind=st.sampled_from("bi"))
    def set_one(self, slot: int, vr: int, value: int, kind: str) -> None:
        """Set a Boolean or an Integer."""
        if (found := self.live(slot)) is not None:
            self.call(f"set{kind}", found, 1, vr, value)

    @rule(slot=slots, vr=st.sampled_from([0, 1, 7]), text=texts)
    def set_text(self, slot: int, vr: int, text: str) -> None:
        """Set and read a String."""
        if (found := self.live(slot)) is not None:
            self.call("sets", found, vr, text)
            self.call("gets", found, vr)

    @rule(slot=slots, state=st.integers(0, 5))
    def save(self, slot: int, state: int) -> None:
        """Take a state."""
        found = self.live(slot)
        if found is not None and state not in self.states:
            self.call("save", found, state)
            self.states.add(state)

    @precondition(lambda self: self.states)
    @rule(slot=slots, which=st.integers(0, 5))
    def load(self, slot: int, which: int) -> None:
        """Restore a state, perhaps one of another FMU."""
        if (found := self.live(slot)) is not None:
            held = sorted(self.states)
            answer = self.call("load", found, held[which % len(held)])
            if not answer.messages:  # then it may be in any phase
                del self.phase[found]
                self.call("free", found)

    @precondition(lambda self: self.states)
    @rule(slot=slots, which=st.integers(0, 5))
    def drop(self, slot: int, which: int) -> None:
        """Free a state."""
        if (found := self.live(slot)) is not None:
            held = sorted(self.states)
            state = held[which % len(held)]
            self.call("drop", found, state)
            self.states.remove(state)

    @invariant()
    def the_host_lives(self) -> None:
        """The host has not died."""
        assert self.host.process.poll() is None

    def teardown(self) -> None:
        """Free all that is left."""
        if not self.phase and self.states:
            self.new(0, 0)
        for state in self.states:
            self.call("drop", min(self.phase), state)
        for slot in self.phase:
            self.call("free", slot)


@pytest.mark.parametrize("examples", [40, pytest.param(1000, marks=pytest.mark.long)])
def test_no_order_of_calls_crashes_the_host(
    examples: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    paths: dict[str, Path] = build(target=Target("python"))
    paths["trajectory"] = build_trajectory(_home(3), target=Target("python"))
    Calls.fmus = [Fmu(paths[name]) for name in NAMES]
    program = compile_host(tmp_path_factory.mktemp("calls"))
    with Host(program) as host:
        Calls.host = host
        for slot, fmu in enumerate(Calls.fmus):
            assert host.load(slot, fmu.folder, fmu.description.modelName).status == OK
        run_state_machine_as_test(
            Calls,
            settings=settings(
                max_examples=examples,
                stateful_step_count=40,
                deadline=None,
                suppress_health_check=list(HealthCheck),
            ),
        )
        assert host.close() == 0


def _home(rows: int) -> Any:
    import numpy as np  # noqa: PLC0415 - only here

    return np.tile(HOME, (rows, 1))
