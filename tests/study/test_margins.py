"""Margins of made-up loops: confirmed by linear systems on both sides, and by python-control."""

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from panda_cosim.study.analysis.confirm import confirm
from panda_cosim.study.analysis.margins import judge
from panda_cosim.study.analysis.responses import Responses
from panda_cosim.study.analysis.sensitivity import Sensitivity, disk_margin, limits

Matrix = NDArray[Any]

PERIOD = 0.004  # s
NEAR = 1e-3  # share of a margin within which a system is on its other side
SAME = 1e-6  # relative, of the same number by another way
AGREEMENT = 0.01  # of python-control's bound on a grid of its own
TICKS = 400  # after which a response has fallen below 1e-9
MOST = 40.0  # [dB] a gain beyond which nothing is said


@dataclass(frozen=True, eq=False)
class Loops:
    """Loops L = C (z - A)^-1 B that are stable when closed: u = -y."""

    a: Matrix
    b: Matrix
    c: Matrix

    def radius(self, factors: Any = 1.0, ticks: int = 0) -> float:
        """Largest modulus of a pole with each loop times a factor, and all later by some ticks."""
        n, m = len(self.a), self.b.shape[1]
        chain = np.eye(n + m * ticks, k=m, dtype=complex)  # from the newest input to the plant's
        chain[:n] = 0.0
        chain[:n, :n] = self.a
        if ticks:
            chain[:n, n : n + m] = self.b
        returned = (factors * np.ones(m))[:, None] * self.c
        if ticks:
            chain[-m:, :n] -= returned
        else:
            chain -= self.b @ returned
        return float(np.abs(np.linalg.eigvals(chain)).max())

    @cached_property
    def pulses(self) -> Matrix:
        """What returns after a pulse of 1 (TICKS, n, n), and then where the outputs move."""
        closed, state = self.a - self.b @ self.c, self.b
        answers = [np.zeros((self.c.shape[0], self.b.shape[1]))]
        for _ in range(TICKS - 1):
            answers.append(-self.c @ state)
            state = closed @ state
        return np.array(answers)

    @property
    def sensitivity(self) -> Sensitivity:
        """S by the responses to pulses."""
        return Sensitivity(self.pulses, PERIOD)

    def alone(self, index: int) -> "Loops":
        """One loop, with the others closed."""
        others = np.arange(self.b.shape[1]) != index
        a = self.a - self.b[:, others] @ self.c[others]
        return Loops(a, self.b[:, [index]], self.c[[index]])

    def response(self, omega: Matrix) -> Matrix:
        """L (m, n, n) at frequencies (m,)."""
        z = np.exp(1j * omega * PERIOD)[:, None, None]
        return np.asarray(self.c @ np.linalg.solve(z * np.eye(len(self.a)) - self.a, self.b))


@st.composite
def loops(draw: st.DrawFn, most: int = 3) -> Loops:
    """Loops of any kind that are stable when closed: open, they may be unstable."""
    n, order = draw(st.integers(1, most)), draw(st.integers(2, 6))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    closed = random.normal(size=(order, order))
    closed *= draw(st.floats(0.5, 0.94)) / np.abs(np.linalg.eigvals(closed)).max()
    b, c = random.normal(size=(order, n)), random.normal(size=(n, order))
    c *= draw(st.floats(0.02, 0.5))
    made = Loops(closed + b @ c, b, c)
    assume(np.abs(made.pulses[-50:]).max() < 1e-9 * max(np.abs(made.pulses).max(), 1e-9))
    return made


@settings(deadline=None, max_examples=20)
@given(loops())
def test_loops_are_stable_up_to_each_limit_and_not_beyond(made):
    """Gains, phases and whole ticks of delay of all loops alike, by the poles."""
    found = limits(made.sensitivity)
    for sign, decibels in ((1.0, found.gain_up_db), (-1.0, found.gain_down_db)):
        inside = np.linspace(0.0, min(decibels * (1.0 - NEAR), MOST), 40)
        assert all(made.radius(10.0 ** (sign * x / 20.0)) < 1.0 for x in inside)
        if math.isfinite(decibels):
            at_limit = made.radius(10.0 ** (sign * decibels / 20.0))
            assert at_limit == pytest.approx(1.0, abs=SAME)
    phase = math.radians(found.phase_margin_deg)
    inside = np.linspace(0.0, min(phase * (1.0 - NEAR), math.pi), 40)
    assert all(made.radius(np.exp(1j * s * x)) < 1.0 for x in inside for s in (-1, 1))
    if math.isfinite(phase):
        at_limit = min(abs(made.radius(np.exp(1j * s * phase)) - 1.0) for s in (-1, 1))
        assert at_limit < SAME
    delay = found.delay_margin_ms / 1e3 / PERIOD
    highest = np.abs(np.linalg.eigvals(made.response(np.array([math.pi / PERIOD])))).max()
    assume(highest < 1.0 and abs(delay - round(min(delay, 1e3))) > NEAR)
    bearable = math.ceil(min(delay, 21.0)) - 1  # whole ticks
    assert all(made.radius(ticks=k) < 1.0 for k in range(bearable + 1))
    if delay < 20.0:
        # A fraction of a tick is a phase that grows with the frequency: det(1 + L e^-jwT) = 0.
        omega = np.linspace(1.0, math.pi / PERIOD, 20_000)
        late = made.response(omega) * np.exp(-1j * omega * delay * PERIOD)[:, None, None]
        assert np.abs(np.linalg.eigvals(late) + 1.0).min() < AGREEMENT


@settings(deadline=None, max_examples=5)
@given(loops())
def test_the_disk_margin_is_that_of_python_control(made):
    import control  # noqa: PLC0415 - as above

    if made.b.shape[1] > 1:
        pytest.importorskip("slycot")
    n = made.b.shape[1]
    system = control.ss(made.a, made.b, made.c, np.zeros((n, n)), PERIOD)
    omega = np.linspace(1e-3, math.pi / PERIOD * 0.9999, 400)
    theirs, _, _ = control.disk_margins(system, omega)
    own, _, _ = disk_margin(made.sensitivity)
    assert own <= theirs * (1.0 + AGREEMENT)
    peaks = 1.0 / np.linalg.norm(made.sensitivity.at(omega) - 0.5 * np.eye(n), 2, axis=(1, 2))
    assert own >= peaks.min() * 0.9  # scaling only makes it larger
    # On both sides: by changes in the disk, and by one that reaches its edge.
    random = np.random.default_rng(0)
    for _ in range(20):
        edge = own * (1.0 - NEAR) * np.exp(2j * math.pi * random.random(n))
        assert made.radius((2.0 + edge) / (2.0 - edge)) < 1.0


def responses_of(made: Loops, positions: Matrix) -> Responses:
    """What `analyze` would measure, with the positions (n, order) of the states."""
    n, state = made.b.shape[1], made.b
    moves = [np.zeros((len(positions), n))]
    for _ in range(TICKS - 1):
        moves.append(positions @ state)
        state = (made.a - made.b @ made.c) @ state
    names = tuple(f"plant.ctrl[{i + 1}]" for i in range(n))
    pulses = np.concatenate((made.pulses, np.array(moves)), axis=1)
    return Responses(names, names, 0.0, PERIOD, pulses, 0.0, False)


@settings(deadline=None, max_examples=8)
@given(loops(), st.integers(0, 2**32))
def test_each_number_of_an_analysis_is_what_its_definition_says(made, seed):
    """Computed again from the words of definitions.toml: by poles, and by L on a dense grid."""
    n = made.b.shape[1]
    positions = np.random.default_rng(seed).normal(size=(n, len(made.a)))
    margins = judge(responses_of(made, positions), "jacobi")
    assert (margins.stable, margins.reason, margins.coupling) == (True, "", "jacobi")
    omega = np.linspace(1e-6, math.pi / PERIOD, 30_000)
    closed = made.a - made.b @ made.c
    for i, loop in enumerate(margins.loops):
        own = made.alone(i)
        answer = own.response(omega)[:, 0, 0]
        for level, values, found in (
            (1.0, np.abs(answer), loop.crossover_hz),
            (math.sqrt(0.5), np.abs(answer / (1.0 + answer)), loop.bandwidth_hz),
        ):
            rows = np.flatnonzero(np.diff(values > level))
            highest = omega[rows[-1]] if rows.size else 0.0
            assert 2.0 * math.pi * found == pytest.approx(highest, rel=1e-3, abs=omega[1])
        for name, value in vars(limits(own.sensitivity)).items():  # which are tested above
            assert getattr(loop, name) == pytest.approx(value, rel=SAME), name
        state, path = np.zeros(len(closed)), []
        for _ in range(4 * TICKS):
            path.append(positions[i] @ state)
            state = closed @ state + made.b[:, i]
        away = np.abs(np.array(path) - path[-1])
        settled = np.flatnonzero(away > 0.02 * away.max())[-1] + 1
        assert loop.settling_ms == pytest.approx(1e3 * PERIOD * settled, abs=1e3 * PERIOD)
        assert loop.peak_ratio == pytest.approx(np.abs(path).max(), rel=SAME)
        assert (loop.input, loop.joint) == (f"plant.ctrl[{i + 1}]", i + 1)
    every = np.linalg.eigvals(made.response(omega))
    for level, values, found in (
        (1.0, every, margins.crossover_hz),
        (math.sqrt(0.5), every / (1.0 + every), margins.bandwidth_hz),
    ):
        above = (np.abs(values) > level).sum(axis=1)  # of eigenvalues, whatever their order
        rows = np.flatnonzero(np.diff(above))
        highest = omega[rows[-1]] if rows.size else 0.0
        assert 2.0 * math.pi * found == pytest.approx(highest, rel=1e-3, abs=omega[1])
    assert margins.gain_margin_db == min(margins.gain_up_db, margins.gain_down_db)
    half = 0.5 * margins.disk_margin
    gain = math.inf if half >= 1.0 else 20.0 * math.log10((1.0 + half) / (1.0 - half))
    assert margins.disk_gain_db == pytest.approx(gain)
    assert margins.disk_phase_deg == pytest.approx(2.0 * math.degrees(math.atan(half)))


def with_filters(made: Loops, filters: Any) -> bool:
    """Whether the loops are stable with a filter in each, by the poles of python-control."""
    import control  # noqa: PLC0415 - as above

    each = zip(filters[0].T, filters[1].T, strict=True)
    systems = [control.ss(control.tf(b, a, PERIOD)) for b, a in each]
    n = made.b.shape[1]
    loop = control.ss(made.a, made.b, made.c, np.zeros((n, n)), PERIOD)
    closed = control.feedback(control.append(*systems) * loop, np.eye(n))
    return bool(np.abs(closed.poles()).max() < 1.0)


@settings(deadline=None, max_examples=8)
@given(loops())
def test_filters_on_both_sides_of_each_margin_confirm_it_and_refute_a_wrong_one(made):
    margins = judge(responses_of(made, np.ones((made.b.shape[1], len(made.a)))), "jacobi")
    bears = partial(with_filters, made)
    found = confirm(margins, made.sensitivity, bears)
    assert all(c.stable_within for c in found), found
    # A longer delay may make loops stable again.
    assert not any(c.stable_beyond for c in found if c.margin != "delay_margin_ms"), found
    finite = {key for key in ("gain_up_db", "gain_down_db") if math.isfinite(getattr(margins, key))}
    assert finite <= {c.margin for c in found if not c.input}
    wrong = replace(margins, gain_up_db=2.0 * margins.gain_up_db)
    if math.isfinite(wrong.gain_up_db):
        first = confirm(wrong, made.sensitivity, bears)[0]
        assert (first.margin, first.verdict) == ("gain_up_db", "refuted")


@given(st.floats(1.001, 1.05))
def test_what_grows_is_unstable_and_what_is_cut_off_has_no_margins(modulus):
    """Whatever has not fallen below 1 % of its peak has no margins, and one line says why."""
    growing = modulus ** np.arange(TICKS)[:, None, None] * np.ones((1, 2, 2))
    about = (("plant.ctrl[1]", "plant.ctrl[2]"), (), 0.5, PERIOD)
    found = judge(Responses(*about, growing, 0.0, False), "jacobi")
    assert found.reason == f"UNSTABLE, a pole of modulus {found.pole_modulus:.4f}"
    assert found.pole_modulus == pytest.approx(modulus)
    falling = 0.99 ** np.arange(TICKS)[:, None, None] * np.ones((1, 2, 2))
    for ticks in (50, 300, 399):
        found = judge(Responses(*about, falling[:ticks], 0.0, True), "jacobi")
        left = 0.99 ** (ticks - ticks // 10)
        assert bool(found.reason) == (left > 0.01) == (found.loops == ())
        assert found.reason == "" or found.reason == (
            f"NO MARGINS: {left:.0%} of the responses is left when a contact or limit changes "
            f"them, {ticks * PERIOD * 1e3:g} ms after 0.5 s; choose an instant at rest"
        )
