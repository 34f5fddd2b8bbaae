"""Values of `--set`, sweeps and overrides are a set: no order of their keys is seen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from panda_cosim.fmus.errors import InputError
from panda_cosim.scenarios.cli.options import overrides
from panda_cosim.scenarios.run.options import (
    TOP,
    Options,
    split_settings,
    with_options,
    with_values,
)
from panda_cosim.scenarios.run.start import start_values
from panda_cosim.scenarios.scenario.scenario import Scenario, load_scenario

ROTATED = load_scenario("rotated_block")
PUSHED = load_scenario("push")
VALUES: Mapping[str, Any] = {
    "mismatch.preset": "worn",
    "mismatch.seed": 7.0,
    "mismatch.joint_offset": 0.002,
    "mismatch.joint_offset[3]": 0.001,
    "mismatch.joint_offset[7]": -0.001,
    "mismatch.servo_scale[1]": 0.9,
    "mismatch.payload": 0.3,
    "controller.kp": 6.0,
    "controller.kp[1]": 9.0,
    "controller.kp[7]": 3.0,
    "plant.block_pos[1]": 0.4,
    "plant.block_pos": [0.45, 0.05],
    "gains": "tutorial",
    "duration": 9.0,
    "table.rows[2].time": 1.9,
    "table.rows[3].time": 2.1,
    "table.rows[2].z": 0.2,
    "success.tracking_max": 0.5,
}


@settings(max_examples=10, deadline=None)  # each compiles two models
@given(st.permutations(list(VALUES)), st.sets(st.sampled_from(list(VALUES))))
def test_any_order_of_keys_gives_the_same_scenario_and_start_values(
    order: list[str], left_out: set[str]
) -> None:
    chosen = {key: VALUES[key] for key in VALUES if key not in left_out}
    shuffled = {key: VALUES[key] for key in order if key not in left_out}
    try:
        expected = with_values(ROTATED, chosen)
    except InputError:
        with pytest.raises(InputError):
            with_values(ROTATED, shuffled)
        return
    changed = with_values(ROTATED, shuffled)
    assert changed == expected
    assert start_values(changed) == start_values(expected)
    # The same from texts of `--set`, which the command line takes apart first.
    texts = [f"{key}={written(value)}" for key, value in shuffled.items()]
    keys, others = split_settings(texts)
    options = Options(overrides(others, (), TOP))
    assert start_values(with_options(with_values(ROTATED, keys), options)) == start_values(expected)


@pytest.mark.parametrize("text", ["duration=1_000", "controller.kp=٣"])
def test_numbers_in_another_notation_are_refused(text: str) -> None:
    with pytest.raises(InputError, match=f"--set '{text}': .* in the digits 0 to 9, as "):
        overrides(split_settings([text])[1])


def written(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


@given(st.permutations(["kp", "kp[1]", "kp[7]"]), st.permutations(["kp", "kp[2]"]))
def test_sections_and_overrides_are_sets_and_an_override_replaces_the_section(
    section: list[str], given: list[str]
) -> None:
    values = {"kp": 5.0, "kp[1]": 1.0, "kp[7]": 7.0}
    scenario = changed(controller={name: values[name] for name in section})
    assert gains(scenario) == [1.0, 5.0, 5.0, 5.0, 5.0, 5.0, 7.0]
    over = {"kp": 4.0, "kp[2]": 2.0}
    options = Options({"controller": {name: over[name] for name in given}})
    expected = [4.0, 2.0, 4.0, 4.0, 4.0, 4.0, 4.0]
    assert gains(with_options(scenario, options)) == expected
    assert gains(scenario, options) == expected


def changed(**keys: Any) -> Scenario:
    return Scenario("test", PUSHED.table, 3.0, **keys)


def gains(scenario: Scenario, options: Options | None = None) -> list[object]:
    values = start_values(scenario, options.overrides if options else None)["controller"]
    return [values[f"kp[{joint}]"] for joint in range(1, 8)]


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"duration": 0.0504}, r"^duration: value 0.0504; .* such as 0.05$"),
        ({"duration": 0.0001}, r"^duration: value 0.0001; "),
        ({"success.max_slip": 0.1, "table.rows[2].z": 99.0}, r"^table.rows\[2\].z: "),
        (
            {"mismatch.joint_offset[8]": 0.0},
            r"^mismatch.joint_offset\[8\]: there is no",
        ),
        ({"success.max_slop": 0.1}, r"^success.max_slop: key .* did you mean"),
        ({"push[9].start": 0.1, "gains": "tutorial"}, r"^push\[9\].start: there is no push 9"),
    ],
)
def test_the_key_that_cannot_be_used_is_named(values: Mapping[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        with_values(PUSHED, values)
