"""What is in C and in Python has the same bits, and the stamp says of which code."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_instance import OK, STEP, Instance, unpacked
from panda_cosim.fmus import twins
from panda_cosim.fmus.interface.tables import INTERFACES, TRAJECTORY

STAMP: dict[str, Any] = runpy.run_path(str(Path(__file__).parents[2] / ".ci" / "stamp.py"))
TICKS = 300


def test_the_stamp_is_that_of_the_code():
    now = {twin: STAMP["digests"](twin) for twin in STAMP["COMPARED"]}
    assert twins.proven() == now, f"Python code has changed: run `{twins.RENEW}`, see CONTRIBUTING"


def test_the_list_of_calls_that_c_goes_through_is_compared_too():
    assert "fmus/master/kernel.py" in twins.proven()["kernel"]


def drive(it: Instance, name: str) -> list[list[float]]:
    """Outputs over ticks with inputs that wander, tuned on the way and set back once."""
    source, interface = np.random.default_rng(5), INTERFACES.get(name, TRAJECTORY)
    inputs = [*interface.of("input")]
    values = np.concatenate([np.ravel(v.start or 0.0) * np.ones(v.size) for v in inputs] or [[]])
    rows = [it.outputs()]
    for tick in range(TICKS):
        values = values + source.normal(0.0, 1e-3, len(values))
        if tick == 200:
            values[3:7] *= 1.5  # a command's quaternion, or servo targets
        it.set_inputs(values.tolist())
        if tick == 100 and name == "controller":
            assert it.set("kp", *[3.0] * 7) == OK
        assert it.step(tick * STEP) == OK, it.messages()
        rows.append(it.outputs())
    return rows


@pytest.mark.own_process
@pytest.mark.parametrize(
    ("name", "start"),
    [("plant", {"block_pos": [0.5, 0.1]}), ("controller", {}),
     ("controller", {"period": [0.005], "ki": [2.0] * 7}), ("trajectory", {})],
    ids=["plant", "controller", "slow controller", "trajectory"],
)  # fmt: skip
def test_fmus_of_either_kind_have_the_same_bits(name, start):
    native, python = (Instance(unpacked(k, name, 2)).start(start) for k in ("native", "python"))
    rows = drive(native, name)
    assert rows == drive(python, name)
    assert native.log == python.log
    assert rows[0] != rows[-1], "and something happens"
