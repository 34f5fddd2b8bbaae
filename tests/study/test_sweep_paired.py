"""`sweep compare`: two sweeps pair by pair, against computations of their own."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panda_cosim.cli.commands.sweep import compare
from panda_cosim.study.sweep.paired import Difference, Paired, pair
from panda_cosim.study.sweep.sweeping import sweep
from refusals import refused
from sweep_support import FORCE, short_sweep

pytestmark = pytest.mark.usefixtures("forked_workers")


def paired(outcomes):
    """Pairs of which either succeeds or not."""
    rows = [{"index": 0, "status": status, "margin": None} for status in ("missed", "success")]
    return Paired((), (), tuple((rows[a], rows[b]) for a, b in outcomes), (0, 0))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=40))
def test_mcnemar_is_the_binomial_sum_and_rates_are_counted(outcomes):
    lost = sum(a and not b for a, b in outcomes)
    gained = sum(b and not a for a, b in outcomes)
    flips = lost + gained
    tail = sum(math.comb(flips, k) for k in range(min(lost, gained) + 1)) / 2**flips
    found = paired(outcomes)
    assert found.p_value == pytest.approx(min(1.0, 2.0 * tail))
    assert len(found.flipped(lost=True)) == lost
    assert len(found.flipped(lost=False)) == gained
    assert found.rates == pytest.approx(tuple(np.mean(outcomes, axis=0)))
    assert found.success.mean == pytest.approx((gained - lost) / len(outcomes))


def test_intervals_are_those_of_resampled_pairs_and_hold_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(100):
        values = rng.normal(0.3, 1.0, 60)
        found = Difference.of(values)
        held += found.low <= 0.3 <= found.high
    assert 88 <= held <= 99  # of 100, at 95 %; percentiles are a little narrow
    own = np.quantile(rng.choice(values, (20_000, 60)).mean(axis=1), (0.025, 0.975))
    assert (found.low, found.high) == pytest.approx(tuple(own), abs=0.02)
    assert Difference.of([0.25] * 9) == Difference(0.25, 0.25, 0.25)


def test_worse_is_what_the_interval_says():
    sunk, even = paired([(True, False)] * 9 + [(True, True)]), paired([(True, True)] * 9)
    few = paired([(True, False)] + [(True, True)] * 30)
    assert sunk.is_worse(None)
    assert [even.is_worse(bound) for bound in (None, 0.0)] == [False, False]
    # One of 31 may be chance, but it may be more than 2 %.
    assert [few.is_worse(bound) for bound in (None, 0.02, 0.2)] == [False, True, False]


@pytest.mark.parametrize("number", [1, 5, 200])
def test_without_flips_it_says_what_so_few_pairs_leave_open(number):
    """The share at which so many pairs without a flip have a probability of 2.5 %."""
    share = paired([(True, True)] * number).unseen
    assert (1.0 - share) ** number == pytest.approx(0.025)


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory):
    """The same pushes, with the law's gains and with lower ones."""
    folder = tmp_path_factory.mktemp("sweeps")
    definition = short_sweep(folder, 8)
    made = {}
    for name, gain in (("before", 8.0), ("after", 3.0)):
        kp = {"controller.kp": {"values": [gain]}}
        changed = short_sweep(folder, 8, vary={**definition.vary, **kp}, seed=3)
        made[name] = sweep(changed, folder / name, jobs=2).folder
    return made


def test_rows_are_paired_by_what_varies_and_what_is_constant_is_the_treatment(sweeps):
    found = pair(sweeps["before"], sweeps["after"])
    assert FORCE in found.keys
    assert "controller.kp" not in found.keys
    assert found.treatment[0] == "controller.kp 8 -> 3"
    assert len(found.pairs) == 8
    assert all(a[FORCE] == b[FORCE] for a, b in found.pairs)
    changes = [b["margin"] - a["margin"] for a, b in found.pairs]
    assert found.margins[""].mean == pytest.approx(np.mean(changes))
    same = pair(sweeps["before"], sweeps["before"])
    assert (same.p_value, same.success, same.treatment) == (1.0, Difference(0.0, 0.0, 0.0), ())


def test_sweeps_of_other_values_are_no_pairs(sweeps, tmp_path):
    other = sweep(short_sweep(tmp_path, 3, seed=4), tmp_path / "other", jobs=2).folder
    assert "no row has the values of a row of" in refused(pair, sweeps["before"], other)


def test_the_command_prints_rates_and_the_rows_that_flip(sweeps, capsys):
    compare(sweeps["before"], sweeps["after"], not_worse=1.0, json=False)
    said = capsys.readouterr().out
    for words in ("treatment: controller.kp 8 -> 3", "8 pairs: success", "McNemar's p = "):
        assert words in said
