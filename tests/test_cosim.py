"""The co-simulation over real FMUs is the plain loop of the same objects, bit for bit."""

import sys

import pytest

import cosim_jobs
from fmu_support import in_process


@pytest.mark.parametrize(
    ("scenario", "coupling", "steps"),
    [
        ("pick_and_place", "gauss-seidel", 2000),
        ("tutorial", "gauss-seidel", 1500),
        ("tutorial", "jacobi", 600),
    ],
)
def test_the_run_over_fmus_equals_the_plain_loop_bit_for_bit(scenario, coupling, steps):
    result = in_process(cosim_jobs.compare, scenario, coupling, steps)
    assert result["columns"], "every output and command is recorded once"
    assert result["differing"] == []
    assert result["repeats"], "and so does a second run"
    assert result["rows"] == steps + 1
    assert result["moved"] > 0.01, "and the hand has moved [m]"


@pytest.mark.skipif(sys.platform == "win32", reason="no resource module")
def test_memory_does_not_grow_with_the_length_of_a_run():
    short, longer = in_process(cosim_jobs.memory_of_runs, [2_000, 20_000])
    assert longer - short <= 5.0  # [MB]


def test_the_bench_compares_ways_that_do_the_same():
    """It raises where they end elsewhere; its numbers are no matter of a test's machine."""
    result = in_process(cosim_jobs.short_bench)
    numbers = result["json"]
    assert numbers["format"] == 4
    assert set(numbers["steps"]) == {"physics", "bare", "lists", "master", "fmpy"}
    assert set(numbers["ratios"]) == {"c/a", "c/a'", "d/a", "b/c", "cold run"}
    assert numbers["ratios"]["cold run"]["median"] == pytest.approx(2.5)
    for spread in (*numbers["steps"].values(), *numbers["ratios"].values()):
        assert 0.0 < spread["low"] <= spread["median"] <= spread["high"]
    for text in ("(a) mj_step", "(a') mj_step", "c/a", "c/a'", "at most 1.1", "numpy"):
        assert text in result["text"]
