"""What is given from outside is the same, made at once or a part at a time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panda_cosim.run import prepare as preparing
from panda_cosim.run.prepare import prepare
from panda_cosim.run.start import instants, resolve, start_values
from panda_cosim.task.scenario import load_scenario

INPUTS = prepare(load_scenario("pick_and_place")).inputs()


@pytest.mark.parametrize("name", ["tutorial", "push", "fast_circle"])
@pytest.mark.parametrize("part", [100, 16_384])
def test_parts_hold_what_the_whole_does(name, part, monkeypatch):
    monkeypatch.setattr(preparing, "CHUNK", part)
    scenario = load_scenario(name)
    values = start_values(scenario)
    whole = resolve(scenario, values).sample(instants(scenario))
    made = prepare(scenario).inputs()
    rows = np.concatenate([made[k : k + 257][:256] for k in range(0, scenario.ticks + 1, 256)])
    assert rows.shape == made.shape
    np.testing.assert_allclose(rows[:, -14:], whole, rtol=0, atol=1e-15)
    assert bool(scenario.push) == (made.shape[1] == 17)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 7000), st.integers(0, 7000))
def test_a_slice_is_cut_off_as_that_of_an_array(start, stop):
    assert len(INPUTS[start:stop]) == len(range(INPUTS.shape[0])[start:stop])


@pytest.mark.parametrize("body", ["hand", "block"])
def test_a_push_begins_and_ends_with_its_ticks(body):
    scenario = load_scenario("push")
    scenario = replace(scenario, push=tuple(replace(p, on=body) for p in scenario.push))
    made = prepare(scenario).inputs()
    forces, times = made[0 : made.shape[0]][:, :3], instants(scenario)
    pushed = np.zeros(len(times), dtype=bool)
    for push in scenario.push:
        pushed |= (times > push.start - 5e-4) & (times < push.start + push.duration - 5e-4)
    assert pushed.any()
    np.testing.assert_array_equal(np.abs(forces).sum(axis=1) > 0, pushed)
