"""The master's algorithm, with slaves that are small linear systems."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import panda_cosim.fmus.master.master
from master_support import all_rows
from panda_cosim.fmus.errors import InputError, SimulationError
from panda_cosim.fmus.interface.tables import Connection
from panda_cosim.fmus.master.master import Master, RealtimePacer
from panda_cosim.fmus.master.step import Coupling
from panda_cosim.fmus.master.wiring import BLOCK_ROWS, Exchange, SlowSlave, System
from panda_cosim.task.rotations import Array

H = 0.001
Law = Callable[[dict[str, float], dict[str, float]], None]


class FakeSlave:
    """A slave y = step(u, state) in plain Python."""

    def __init__(self, name: str, law: Law, outputs: Mapping[str, float]) -> None:
        self.name, self.stop = name, math.inf
        self.inputs: dict[str, float] = {}
        self.outputs = dict(outputs)
        self.times: list[float] = []
        self.spent = defaultdict[str, float](float)
        self._law = law
        self._kept: dict[int, tuple[dict[str, float], dict[str, float]]] = {}

    def save_state(self, place: int = 0) -> None:
        """Keep inputs and outputs."""
        self._kept[place] = dict(self.inputs), dict(self.outputs)

    def restore_state(self, place: int = 0) -> None:
        """Go back to what was kept."""
        inputs, outputs = self._kept[place]
        self.inputs.update(inputs)
        self.outputs.update(outputs)

    def bind_get(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that reads."""

        def get(row: int) -> None:
            block[row] = [self.outputs[name] for name in names]

        return get

    def bind_set(self, names: Sequence[str], block: Array) -> Exchange:
        """Make a function that writes."""

        def put(row: int) -> None:
            self.inputs.update(zip(names, block[row].tolist(), strict=True))

        return put

    def step(self, time: float, step_size: float) -> None:
        """Compute the outputs."""
        assert step_size == H or time + step_size <= self.stop
        self.times.append(time)
        self._law(self.inputs, self.outputs)


def drive(inputs: dict[str, float], outputs: dict[str, float]) -> None:
    """A controller with a memory: u = -2 x + r + 0.1 u_before."""
    outputs["u"] = -2.0 * inputs["x"] + inputs["r"] + 0.1 * outputs["u"]
    outputs["twice"] = 2.0 * outputs["u"]


def follow(inputs: dict[str, float], outputs: dict[str, float]) -> None:
    """A plant: x' = x + h u."""
    outputs["x"] += 0.05 * inputs["u"]
    outputs["v"] = inputs["u"]


WIRED = System(
    {},
    (Connection(("c", "u"), ("p", "u")), Connection(("p", "x"), ("c", "x"))),
    external=[("c", "r")],
    outputs={"p": ["x", "v"], "c": ["u", "twice"]},
)


def loop(
    coupling: Coupling = "gauss-seidel", laws: Sequence[Law] = (drive, follow), **options: Any
) -> Master:
    c = FakeSlave("c", laws[0], {"twice": 0.5, "u": 0.25})
    p = FakeSlave("p", laws[1], {"x": 1.0, "v": 0.0})
    return Master([c, p], WIRED, H, coupling, **options)


def begun(master: Master) -> list[Array]:
    """Begin a run; its blocks of rows come into the list."""
    rows: list[Array] = []
    master.begin(lambda block: rows.append(block.copy()))
    return rows


def run(master: Master, steps: int, external: Array | None = None) -> Array:
    """Run to the end, and return all rows."""
    rows = all_rows(master, steps, references(steps) if external is None else external)
    assert master.statistics.steps == steps
    return rows


def references(steps: int) -> Array:
    return np.sin(np.arange(steps + 1.0))[:, np.newaxis]


def in_a_plain_loop(steps: int, *, delayed: bool, until: int = 10**6) -> Array:
    """Columns time, r, x, v, u, twice; from a tick on, outputs are delayed if they were not."""
    c, p = {"twice": 0.5, "u": 0.25}, {"x": 1.0, "v": 0.0}
    rows = []
    for k, (r,) in enumerate(references(steps).tolist()):
        before = dict(c)
        drive({"x": p["x"], "r": r}, c)
        told = before if delayed == (k < until) else c
        rows.append([k * H, r, p["x"], p["v"], told["u"], told["twice"]])
        follow({"u": told["u"]}, p)
    return np.array(rows)


@pytest.mark.parametrize("steps", [0, 1, 2, 100, BLOCK_ROWS - 1, BLOCK_ROWS, BLOCK_ROWS + 1, 1000])
@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_a_run_is_the_plain_loop(steps, coupling):
    rows = run(loop(coupling), steps)
    expected = in_a_plain_loop(steps, delayed=coupling == "jacobi")
    np.testing.assert_array_equal(rows, expected)


@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
@settings(max_examples=25, deadline=None)
@given(counts=st.lists(st.integers(0, 2 * BLOCK_ROWS + 3), max_size=8))
def test_however_it_is_stepped_from_outside_the_rows_are_those_of_a_run(coupling, counts):
    master, steps = loop(coupling), sum(counts)
    external = references(steps)
    rows = begun(master)
    for count in counts:
        assert master.step(count, external) == count
        assert master.time == master.steps * H
    master.end(external[steps:])
    np.testing.assert_array_equal(np.concatenate(rows), run(loop(coupling), steps))


@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
@pytest.mark.parametrize("steps", [0, 1, BLOCK_ROWS, BLOCK_ROWS + 1])
def test_the_latest_row_has_what_is_known_before_the_next_tick(coupling, steps):
    master = loop(coupling)
    rows = begun(master)
    master.step(steps, references(steps))
    latest = master.latest()
    master.end(references(steps)[steps:])
    last = rows[-1][-1]
    assert latest[0] == last[0] == steps * H
    np.testing.assert_array_equal(latest[2:4], last[2:4])
    before = last if coupling == "jacobi" else np.concatenate(rows)[-2] if steps else None
    np.testing.assert_array_equal(latest[4:], [0.25, 0.5] if before is None else before[4:])
    assert latest[1] == (references(steps)[steps - 1, 0] if steps else 0.0), "the last one given"


@pytest.mark.parametrize("at", [0, 1, BLOCK_ROWS - 1, BLOCK_ROWS, 300])
@pytest.mark.parametrize("first", ["gauss-seidel", "jacobi"])
def test_the_coupling_changes_between_two_ticks(first, at):
    """The plain loop with a coupling that changes: outputs act until the next ones are read."""
    second: Coupling = "jacobi" if first == "gauss-seidel" else "gauss-seidel"
    steps = 600
    master = loop(first)
    rows = begun(master)
    master.step(at, references(steps))
    master.couple(second)
    master.step(steps - at, references(steps))
    expected = in_a_plain_loop(steps, delayed=first == "jacobi", until=at)[:steps]
    master.flush()
    np.testing.assert_array_equal(np.concatenate(rows), expected)


def test_an_earlier_leader_hears_a_later_one_a_tick_later():
    """Three in a ring, a -> b -> c -> a and b -> a: b's answer reaches a at the next tick."""

    def add(inputs: dict[str, float], outputs: dict[str, float]) -> None:
        outputs["y"] = sum(inputs.values()) + 1.0

    slaves = [FakeSlave(name, add, {"y": 0.0}) for name in "abc"]
    wires = [
        Connection((source, "y"), (target, f"from_{source}"))
        for source, target in ("ab", "bc", "ca", "ba")
    ]
    system = System({}, wires, outputs={name: ["y"] for name in "abc"})
    rows = run(Master(slaves, system), 600, np.zeros((601, 0)))
    a = b = c = 0.0
    expected = []
    for k in range(601):
        before = c
        a = c + b + 1.0
        b = a + 1.0
        expected.append([k * H, a, b, before])
        c = b + 1.0
    np.testing.assert_array_equal(rows, expected)


def test_iterations_take_inputs_from_outside_at_the_step_s_end_as_connected_ones():
    """`own` has the values from outside, `fed` those of a source that counts alike."""

    def adopt(inputs: dict[str, float], outputs: dict[str, float]) -> None:
        outputs["x"] += sum(inputs.values())  # at the step's end

    own, fed = (FakeSlave(name, adopt, {"x": 0.0}) for name in ("own", "fed"))

    def count(_inputs: dict[str, float], outputs: dict[str, float]) -> None:
        outputs["y"] += 1.0

    source, steps = FakeSlave("source", count, {"y": 0.0}), 2 * BLOCK_ROWS + 1
    outputs = {"own": ["x"], "fed": ["x"], "source": ["y"]}
    wires = [Connection(("source", "y"), ("fed", "u"))]
    system = System({}, wires, [("own", "u")], outputs)
    master = Master([own, fed, source], system, H, "iterated")
    rows = run(master, steps, np.arange(steps + 1.0)[:, np.newaxis])
    np.testing.assert_array_equal(rows[:, 2], np.cumsum(np.arange(steps + 1.0)))
    np.testing.assert_array_equal(rows[:, 3], rows[:, 2])
    assert (rows[1:, -1] == 2).all()


@pytest.mark.parametrize("first", ["a 0", 2**62, b"\x00"], ids=["text", "integer", "binary"])
def test_what_is_no_real_number_takes_part_in_iterations(first):
    """The reader is stepped first, and has what the source says at the step's end."""
    following = {first: first + first[:1] if isinstance(first, str | bytes) else first + 1}

    def say(_inputs: dict[str, Any], outputs: dict[str, Any]) -> None:
        outputs["y"] = following.get(outputs["y"], outputs["y"])

    def read(inputs: dict[str, Any], outputs: dict[str, Any]) -> None:
        outputs["x"] = inputs["u"]

    slaves = [FakeSlave("reader", read, {"x": first}), FakeSlave("source", say, {"y": first})]
    ends, names = [Connection(("source", "y"), ("reader", "u"))], [("reader", "x"), ("source", "y")]
    outputs = {"reader": ["x"], "source": ["y"]}
    master = Master(slaves, System({}, ends, (), outputs), H, "iterated", objects=names)
    rows = run(master, 2, np.zeros((3, 0)))
    assert rows[:, 1].tolist() == rows[:, 2].tolist() == [first, *[following[first]] * 2]


@pytest.mark.parametrize("multiple", [1, 4])
def test_a_leader_is_never_stepped_beyond_its_stop(multiple):
    """In the last row are its outputs as they are; one without an end takes a step more."""
    ticks = []
    for stop in (6 * H, math.inf):
        c = FakeSlave("c", drive, {"twice": 0.5, "u": 0.25})
        c.stop = stop
        p = FakeSlave("p", follow, {"x": 1.0, "v": 0.0})
        master = Master([c, p], replace(WIRED, steps={"c": multiple}))
        rows = run(master, 6)
        assert (rows[-1, -1] == rows[-2, -1]) == (stop == 6 * H or multiple > 1)
        ticks.append([round(time / H) for time in c.times])
    assert ticks == ([[*range(6)], [*range(7)]] if multiple == 1 else [[0], [0, 4]])


@pytest.mark.parametrize("leads", [False, True])
def test_a_slow_slave_goes_back_to_its_place_in_the_step(leads):
    fake = FakeSlave("c", lambda _inputs, outputs: outputs.update(y=outputs["y"] + 1.0), {"y": 0.0})
    slave, block = SlowSlave(fake, 4), np.zeros((40, 1))
    slave.leads, fake.stop = leads, 40 * H
    get = slave.bind_get(["y"], block)

    def take(ticks: Iterable[int]) -> list[float]:
        for tick in ticks:
            slave.step(tick * H, H)
            get(tick)
        return [float(block[tick, 0]) for tick in ticks]

    take(range(6))
    slave.save_state()
    first = take(range(6, 20))
    slave.restore_state()
    assert take(range(6, 20)) == first
    assert first[-1] == 5.0


def breaks(at: int, what: Callable[[dict[str, float]], None], usual: Law = follow) -> Law:
    """Let a law, `follow` for example, do something else at one tick."""
    count = 0

    def law(inputs: dict[str, float], outputs: dict[str, float]) -> None:
        nonlocal count
        usual(inputs, outputs)
        if count == at:
            what(outputs)
        count += 1

    return law


def collect(master: Master, steps: int) -> tuple[SimulationError, Array]:
    def to_the_end() -> None:
        master.step(steps, references(steps))
        master.end(references(steps)[steps:])

    rows = begun(master)
    with pytest.raises(SimulationError) as caught:
        to_the_end()
    return caught.value, np.concatenate([np.zeros((0, 6)), *rows])


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("at", [0, 7, BLOCK_ROWS - 1, BLOCK_ROWS, 299])
def test_a_value_that_is_not_finite_ends_the_run(at, value):
    error, rows = collect(
        loop(laws=(drive, breaks(at, lambda outputs: outputs.update(v=value)))), 300
    )
    assert (error.instance, error.variable) == ("p", "v")
    assert error.time == pytest.approx((at + 1) * H), "what is read after a tick is of its end"
    assert str(value) in str(error)
    np.testing.assert_array_equal(rows, in_a_plain_loop(300, delayed=False)[: at + 1])


def test_what_a_refused_value_leads_to_is_reported_as_that_value():
    """If a slave refuses a value, the error names the value's source."""

    def refuse(inputs: dict[str, float], outputs: dict[str, float]) -> None:
        if not all(map(math.isfinite, inputs.values())):
            raise SimulationError("an input is not finite", instance="c")
        drive(inputs, outputs)

    spoilt = breaks(7, lambda outputs: outputs.update(x=math.nan))
    error, rows = collect(loop(laws=(refuse, spoilt)), 300)
    assert (error.instance, error.variable) == ("p", "x")
    assert error.time == pytest.approx(8 * H)
    assert len(rows) == 8


@pytest.mark.parametrize("at", [0, 7, BLOCK_ROWS - 1, BLOCK_ROWS])
@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_a_failure_keeps_all_rows_up_to_it(at, coupling):
    def fail(_outputs: dict[str, float]) -> None:
        raise SimulationError("no more", instance="p")

    error, rows = collect(loop(coupling, laws=(drive, breaks(at, fail))), 300)
    assert "no more" in str(error)
    assert f"{at * H:.3f}" in str(error)
    expected = in_a_plain_loop(300, delayed=coupling == "jacobi")
    np.testing.assert_array_equal(rows, expected[: at + 1])


def test_an_error_of_the_sink_ends_the_run():
    def full(_rows: Array) -> None:
        raise SimulationError("disk full")

    master, external = loop(), references(BLOCK_ROWS + 5)
    external[BLOCK_ROWS] = math.nan  # which nobody has used yet
    master.begin(full)
    with pytest.raises(SimulationError, match="disk full"):
        master.step(BLOCK_ROWS + 5, external)


def test_an_unknown_coupling_is_named():
    with pytest.raises(InputError, match="'gauss'; valid: gauss-seidel, jacobi"):
        Master([], System({}, ()), H, "gauss")  # type: ignore[arg-type]


class Clock:
    """A clock that advances by a fixed time at each reading, and by sleeping."""

    def __init__(self, look: float) -> None:
        self.now, self.look, self.sleeps = 0.0, look, 0

    def perf_counter(self) -> float:
        """Read the clock."""
        self.now += self.look
        return self.now

    def sleep(self, seconds: float) -> None:
        """Advance it."""
        self.sleeps += 1
        self.now += seconds


@pytest.mark.parametrize(("speed", "look"), [(1.0, 1e-5), (2.0, 1e-5), (1.0, 1e-3)])
def test_a_run_in_real_time_sleeps_until_each_tick_is_due(monkeypatch, speed, look):
    """What is late is counted: the clock is read twice in a tick."""
    clock, master, is_late = Clock(look), loop(), look == H
    monkeypatch.setattr(panda_cosim.fmus.master.master, "clock", clock)
    begun(master)
    master.step(100, references(100), pace=RealtimePacer(H / speed, master.statistics).wait)
    late = master.statistics
    assert (late.overruns, clock.sleeps) == ((100, 0) if is_late else (0, 100))
    assert (late.worst_lateness > 0.09) == is_late
    assert is_late or clock.now == pytest.approx(0.1 / speed, abs=2e-3)
