"""Values are a set of flat keys, the same at each door: no order of the keys is seen."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panda_cosim import InputError, Options, Scenario, Session, load_scenario
from panda_cosim.cli.common import values_of
from panda_cosim.fmus.interface.parameters import expand
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.run.prepare import prepare
from panda_cosim.run.start import start_values
from panda_cosim.study.compare.regress import with_values
from refusals import refused

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
def test_any_order_of_keys_gives_the_same_scenario_and_start_values(order, left_out):
    chosen = {key: VALUES[key] for key in VALUES if key not in left_out}
    shuffled = {key: VALUES[key] for key in order if key not in left_out}
    try:
        expected = ROTATED.changed(chosen)
    except InputError:
        with pytest.raises(InputError):
            ROTATED.changed(shuffled)
        return
    changed = ROTATED.changed(shuffled)
    assert changed == expected
    assert start_values(changed) == start_values(expected)


Door = Callable[[Scenario, Mapping[str, Any]], Scenario]


def by_old_options(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """Parameters by instance and name, the rest by key; to be removed in the next release."""
    overrides: dict[str, Any] = {}
    for key, value in values.items():
        instance, dot, name = key.partition(".")
        if dot and instance in ("plant", "controller"):
            overrides.setdefault(instance, {})[name] = value
        else:
            overrides[key] = value
    with pytest.warns(DeprecationWarning, match="what to run is values="):
        options = Options(overrides)
    return prepare(scenario, options).scenario


DOORS: Mapping[str, Door] = {
    "--set": lambda s, values: s.changed(values_of([f"{k}={written(values[k])}" for k in values])),
    "session": lambda scenario, values: Session(scenario, values=values).scenario,
    "regress": lambda scenario, values: next(with_values([scenario], values)),  # type: ignore[arg-type,return-value]
    "options": by_old_options,
}
# Of any kind of value; the keys of `VALUES` do not act together on any arm.
EACH: Mapping[str, Any] = {
    **{key: value for key, value in VALUES.items() if key != "gains"},
    "coupling": "jacobi",
    "scene": "elastic",
    "robot": "fr3",
    "interpolation": "linear",
    "inputs.controller.force_cmd": [0.0, 0.0, 1.0],
    "tolerance": 1e-6,
}


@settings(max_examples=8, deadline=None)  # each compiles two models
@given(st.sampled_from(list(DOORS)), st.sets(st.sampled_from(list(EACH)), min_size=1))
def test_each_door_takes_the_same_keys_and_gives_the_same_scenario(door, keys):
    values = {key: EACH[key] for key in EACH if key in keys}
    try:
        expected = ROTATED.changed(values)
        start_values(expected)
    except InputError:
        with pytest.raises(InputError):
            DOORS[door](ROTATED, values)
        return
    assert DOORS[door](ROTATED, values) == expected


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(
    ("key", "told"),
    [
        ("controler.kp", "controler.kp: no instance 'controler'; valid: plant, controller, "),
        ("block_mass", "block_mass: no such key; .* did you mean 'plant.block_mass'"),
        ("step", "step: value 0.3; must be 0.001 with a trajectory"),
        ("plant.block_mas", "plant.block_mas: no such parameter .* did you mean 'block_mass'"),
    ],
)
def test_each_door_refuses_the_same_keys_in_the_same_words(door, key, told):
    with pytest.raises(InputError, match=told):
        start_values(DOORS[door](PUSHED, {key: 0.3}))


def test_parts_and_steps_are_keys_as_others(tmp_path, monkeypatch):
    law = "class Hold:\n    def update(self, time, qpos): return [0.0] * 8\n"
    (tmp_path / "law.py").write_text(law)
    (tmp_path / "scenario.toml").write_text('duration = 0.1\n[fmus]\na = "law.py:Hold"\n')
    monkeypatch.chdir(tmp_path)
    system = load_scenario(tmp_path).changed({"step": 0.002, "fmus.b": "law.py:Hold"})
    assert (system.ticks, system.step) == (50, 0.002)
    assert system.fmus == {"a": "law.py:Hold", "b": f"{tmp_path.resolve()}/law.py:Hold"}
    # A part, and what is only valid with it, in either order.
    values = {"scene": "motors", "fmus.controller": "law.py:Hold"}
    both = [PUSHED.changed(values), PUSHED.changed(dict(reversed(values.items())))]
    assert both[0] == both[1]
    assert (both[0].scene, both[0].fmus["controller"]) == ("motors", system.fmus["b"])


def written(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


@given(st.permutations(["kp", "kp[1]", "kp[7]"]), st.permutations(["kp", "kp[2]"]))
def test_sections_and_overrides_are_sets_and_an_override_replaces_the_section(section, given):
    values = {"kp": 5.0, "kp[1]": 1.0, "kp[7]": 7.0}
    own = {name: values[name] for name in section}
    scenario = Scenario("test", PUSHED.table, 3.0, controller=own)
    assert gains(scenario) == [1.0, 5.0, 5.0, 5.0, 5.0, 5.0, 7.0]
    over = {"kp": 4.0, "kp[2]": 2.0}
    changed = scenario.changed({f"controller.{name}": over[name] for name in given})
    assert gains(changed) == [4.0, 2.0, 4.0, 4.0, 4.0, 4.0, 4.0]


def gains(scenario: Scenario) -> list[object]:
    values = start_values(scenario)["controller"]
    return [values[f"kp[{joint}]"] for joint in range(1, 8)]


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"duration": 0.0504}, r"^duration: value 0.0504; .* such as 0.05$"),
        ({"duration": 0.0001}, r"^duration: value 0.0001; "),
        ({"success.max_slip": 0.1, "table.rows[2].z": 99.0}, r"^table.rows\[2\].z: "),
        ({"mismatch.joint_offset[8]": 0.0}, r"^mismatch.joint_offset\[8\]: there is no"),
        ({"success.max_slop": 0.1}, r"^success.max_slop: .* did you mean"),
        ({"push[9].start": 0.1, "gains": "tutorial"}, r"^push\[9\].start: there is no push 9"),
    ],
)
def test_the_key_that_cannot_be_used_is_named(values, told):
    with pytest.raises(InputError, match=told):
        PUSHED.changed(values)


# Parameters that a person gives become start values, or one clear line says why not.


CONTROLLER = INTERFACES["controller"]


def test_numbers_lists_texts_and_switches_become_the_elements_values():
    for instance, given_, values in (
        ("controller", {"kp": 8}, {f"kp[{i}]": 8.0 for i in range(1, 8)}),
        ("plant", {"block_pos": (0.45, -0.1), "block_pos[2]": 0.0},
         {"block_pos[1]": 0.45, "block_pos[2]": 0.0}),
        ("plant", {"scene": "tutorial"}, {"scene": "tutorial"}),
        ("controller", {"use_reference": False}, {"use_reference": False}),
        ("controller", {"use_reference": 1}, {"use_reference": True}),
    ):  # fmt: skip
        assert expand(instance, INTERFACES[instance], given_) == values


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64, np.array])
def test_numbers_of_numpy_are_numbers(kind):
    assert expand("controller", CONTROLLER, {"ik_gain": kind(3)}) == {"ik_gain": 3.0}
    for gains in ([kind(3)] * 7, np.full(7, kind(3))):
        assert set(expand("controller", CONTROLLER, {"kp": gains}).values()) == {3.0}


@pytest.mark.parametrize("value", [None, {1.0, 2.0}, {"a": 1}, 1j, np.array([[3.0]]), b"a"])
def test_no_other_value_is_a_parameter(value):
    with pytest.raises(InputError, match="ik_gain"):
        expand("controller", CONTROLLER, {"ik_gain": value})


BAD = [
    ("plant", {"block_mas": 1.0}, "did you mean 'block_mass'"),
    ("plant", {"block_pos[3]": 0.1}, "no such parameter of PandaPlant; did you mean 'block_pos"),
    ("plant", {"ctrl[1]": 0.1}, "of causality input in PandaPlant, not parameter"),
    ("plant", {"block_mass": -1.0}, "must be a number from 0.001 to 3 kg"),
    ("plant", {"block_mass": float("nan")}, "value nan; must be"),
    ("plant", {"block_mass": "heavy"}, "value 'heavy'; must be a number"),
    ("plant", {"block_pos": (1.0, 2.0, 3.0)}, "a list of 3; must be one number for all, or 2"),
    ("plant", {"block_pos": (0.4, 2.0)}, "plant.block_pos[2]: value 2.0; must be"),
    ("plant", {"scene": "tabeltop"}, "did you mean 'tabletop'"),
    ("plant", {"scene": 3.0}, "value 3.0; must be one of tabletop"),
    ("controller", {"use_reference": "maybe"}, "must be true or false"),
    ("controller", {"servo_stiffness": 0.0}, "controller.servo_stiffness[1]: value 0.0; must be"),
    ("controller", {"limit_share": 1.5}, "must be a number from 0.001 to 1"),
    ("controller", {"period": 0.0015}, "must be a whole multiple of 0.001 s"),
]


@pytest.mark.parametrize(("instance", "given_", "expected"), BAD)
def test_a_bad_parameter_is_refused_with_what_would_be_valid(instance, given_, expected):
    message = refused(expand, instance, INTERFACES[instance], given_)
    assert expected in message
    assert instance in message


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("plant.block_pos[1]=0.45", {"plant.block_pos[1]": 0.45}),
        ("controller.kp=8", {"controller.kp": 8.0}),
        (" controller.kp = 1,2,3,4,5,6,7 ", {"controller.kp": [1, 2, 3, 4, 5, 6, 7]}),
        ("plant.scene=tutorial", {"plant.scene": "tutorial"}),
        ("controller.use_reference=FALSE", {"controller.use_reference": False}),
    ],
)
def test_an_assignment_is_read(text, expected):
    assert values_of([text]) == expected


@pytest.mark.parametrize("text", ["", "=", "kp=8", "plant.=1", "plant.block_mass", "plnt.scene=x"])
def test_a_bad_assignment_is_refused_in_one_line(text):
    assert refused(lambda: PUSHED.changed(values_of([text])))


@given(st.text(max_size=40), st.sampled_from(["", "plant.", "fmus.plant=", "step="]))
def test_no_text_gives_anything_but_an_input_error(text, start):
    with suppress(InputError):
        start_values(PUSHED.changed(values_of([start + text])))
