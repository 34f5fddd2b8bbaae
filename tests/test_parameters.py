"""Parameters that a person gives become start values, or one clear line says why not."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panda_cosim import load_scenario
from panda_cosim.cli.options import values_of
from panda_cosim.controller.gains import PRESETS
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.interface.parameters import expand
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.run.start import start_values

PLANT, CONTROLLER = INTERFACES["plant"], INTERFACES["controller"]
PUSH = load_scenario("push")


def test_one_number_sets_all_elements():
    assert expand("controller", CONTROLLER, {"kp": 8}) == {f"kp[{i}]": 8.0 for i in range(1, 8)}


def test_a_sequence_sets_each_element_and_an_index_sets_one():
    values = expand("plant", PLANT, {"block_pos": (0.45, -0.1), "block_pos[2]": 0.0})
    assert values == {"block_pos[1]": 0.45, "block_pos[2]": 0.0}


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64, np.array])
def test_numbers_of_numpy_are_numbers(kind):
    assert expand("controller", CONTROLLER, {"ik_gain": kind(3)}) == {"ik_gain": 3.0}
    each = expand("controller", CONTROLLER, {"kp": [kind(3)] * 7})
    assert each == expand("controller", CONTROLLER, {"kp": np.full(7, 3)})
    assert set(each.values()) == {3.0}


@pytest.mark.parametrize("value", [None, {1.0, 2.0}, {"a": 1}, 1j, np.array([[3.0]]), b"a"])
def test_no_other_value_is_a_parameter(value):
    with pytest.raises(InputError, match="ik_gain"):
        expand("controller", CONTROLLER, {"ik_gain": value})


def test_an_override_of_no_instance_is_refused():
    told = "plnt.block_mass: no instance 'plnt'; valid: plant, controller, sensors; did you mean"
    with pytest.raises(InputError, match=told):
        PUSH.changed({"plnt.block_mass": 0.3})


def test_text_and_switches_keep_their_type():
    assert expand("plant", PLANT, {"scene": "tutorial"}) == {"scene": "tutorial"}
    assert expand("controller", CONTROLLER, {"use_reference": False}) == {"use_reference": False}
    assert expand("controller", CONTROLLER, {"use_reference": 1}) == {"use_reference": True}


BAD = [
    ("plant", {"block_mas": 1.0}, "did you mean 'block_mass'"),
    ("plant", {"block_pos[3]": 0.1}, "no such parameter of PandaPlant; did you mean 'block_pos"),
    ("plant", {"ctrl[1]": 0.1}, "an input of PandaPlant, not a parameter"),
    ("plant", {"block_mass": -1.0}, "must be between 0.001 and 3 kg"),
    ("plant", {"block_mass": float("nan")}, "out of range"),
    ("plant", {"block_mass": "heavy"}, "'heavy' is not a number"),
    ("plant", {"block_pos": (1.0, 2.0, 3.0)}, "a list of 3; must be one number for all, or 2"),
    ("plant", {"block_pos": (0.4, 2.0)}, "plant.block_pos[2]: 2.0 m is out of range"),
    ("plant", {"scene": "tabeltop"}, "did you mean 'tabletop'"),
    ("plant", {"scene": 3.0}, "3.0 is not text"),
    ("controller", {"use_reference": "maybe"}, "must be true or false"),
    ("controller", {"servo_stiffness": 0.0}, "controller.servo_stiffness[1]: 0.0 N.m/rad is out"),
    ("controller", {"limit_share": 1.5}, "must be between 0.001 and 1"),
    ("controller", {"period": 0.0015}, "must be a whole multiple of 0.001 s"),
]


@pytest.mark.parametrize(("instance", "given_", "expected"), BAD)
def test_a_bad_parameter_is_refused_with_what_would_be_valid(instance, given_, expected):
    with pytest.raises(InputError) as caught:
        expand(instance, INTERFACES[instance], given_)  # type: ignore[arg-type]
    message = str(caught.value)
    assert expected in message
    assert instance in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("plant.block_pos[1]=0.45", ("plant", "block_pos[1]", 0.45)),
        ("controller.kp=8", ("controller", "kp", 8.0)),
        (" controller.kp = 1,2,3,4,5,6,7 ", ("controller", "kp", [1, 2, 3, 4, 5, 6, 7])),
        ("plant.scene=tutorial", ("plant", "scene", "tutorial")),
        ("controller.use_reference=FALSE", ("controller", "use_reference", False)),
    ],
)
def test_an_assignment_is_read(text, expected):
    instance, name, value = expected
    assert values_of([text]) == {f"{instance}.{name}": value}


@pytest.mark.parametrize("text", ["", "=", "kp=8", "plant.=1", "plant.block_mass", "plnt.scene=x"])
def test_a_bad_assignment_is_refused_in_one_line(text):
    with pytest.raises(InputError) as caught:
        PUSH.changed(values_of([text]))
    assert "\n" not in str(caught.value)


@given(
    st.text(max_size=40), st.sampled_from(["", "plant.", "fmus.plant=", "inputs.file=", "step="])
)
def test_no_text_gives_anything_but_an_input_error(text, start):
    with suppress(InputError):
        start_values(PUSH.changed(values_of([start + text])))


@pytest.mark.parametrize("name", PRESETS)
def test_each_set_of_gains_fits_the_interface(name):
    preset = PRESETS[name]
    given_ = {
        v.name: getattr(preset, v.name) for v in CONTROLLER.of("parameter") if v.name != "period"
    }
    values = expand("controller", CONTROLLER, given_)
    assert len(values) == sum(v.size for v in CONTROLLER.of("parameter")) - 1
