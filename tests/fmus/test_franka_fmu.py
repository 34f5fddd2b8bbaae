"""FrankaInterface.fmu by hand, and in our master with the plant and real programs."""

import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from ctypes import byref, c_double, c_int
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from fmu_instance import DISCARD, ERROR, OK, Instance, unpacked
from franka_support import PLANT as PARAMETERS
from franka_support import claimed_address, client, couple, needs_clients
from master_support import all_rows
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.interface.franka import FRANKA
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.fmus.interface.tables import Connection
from panda_cosim.fmus.master.fmu_file import read_fmu
from panda_cosim.fmus.master.system import OpenSystem, open_system
from panda_cosim.fmus.master.wiring import System
from panda_cosim.fmus.sources.targets import Target, build

MOST_STEPS = 5000
pytestmark = [pytest.mark.own_process, pytest.mark.timeout(120)]


@pytest.fixture(params=[2, 3])
def fmi(request):
    return request.param


@pytest.fixture
def address() -> Iterator[str]:
    with claimed_address() as claimed:
        yield claimed


def listens(address: str) -> bool:
    """Whether somebody listens at the robot's port."""
    with suppress(ConnectionRefusedError), socket.create_connection((address, 1337)):
        return True
    return False


def initialized(address: str, fmi: int, **values: float) -> Instance:
    it = Instance(unpacked("python", "franka", fmi))
    assert it.set("address", address.encode()) == OK
    return it.start({name: [value] for name, value in values.items()})


def test_it_listens_once_initialization_has_ended(address, fmi):
    it = Instance(unpacked("python", "franka", fmi))
    assert it.set("address", address.encode()) == OK
    assert it.enter() == OK
    assert it.outputs()[7] == 255.0  # the gripper is open
    assert not listens(address)
    assert it("ExitInitializationMode") == OK, it.messages()
    assert listens(address)
    assert it("Terminate") == OK
    assert not listens(address)


def test_it_has_no_states_and_says_so(address, fmi):
    description = read_fmu(build(["franka"], Target(fmi=fmi))["franka"])
    assert validate_fmu(str(description.path)) == []
    with pytest.raises(InputError, match="cannot restore its state"):
        description.check_restorable("an analysis")
    it = initialized(address, fmi)
    assert it._state("GetFMUstate" if fmi == 2 else "GetFMUState", byref(c_int())) == ERROR
    assert "cannot go back" in it.messages()


def test_the_program_s_leaving_ends_the_simulation_by_fmi(address, fmi):
    it = initialized(address, fmi)
    with client("older", address):
        status = it.step(0.0)
    assert it.messages().endswith("the program has left")
    assert it.log[-1][1] == "logStatusDiscard"
    if fmi == 3:
        assert (status, it.terminate.value, it.early.value, it.last.value) == (OK, True, False, 0.0)
        return
    terminated, last = c_int(), c_double(7.0)
    assert status == DISCARD
    assert it("GetBooleanStatus", 3, byref(terminated)) == OK
    assert it("GetRealStatus", 2, byref(last)) == OK
    assert (terminated.value, last.value) == (1, 0.0)


def test_no_program_within_the_timeout_is_an_error_of_one_line(address, fmi):
    it = initialized(address, fmi, connection_timeout=0.2)
    assert it.step(0.0) == ERROR
    ((_, _, text),) = it.log
    assert text == f"fmi{fmi}DoStep: no program has connected to {address}:1337 for 0.2 s"
    assert not listens(address)


def test_an_address_in_use_is_an_error_at_the_end_of_initialization(address):
    first = initialized(address, 2)
    it = Instance(unpacked("python", "franka", 2))
    assert it.set("address", address.encode()) == OK
    assert it.enter() == OK
    assert it("ExitInitializationMode") == ERROR
    assert f"robot: cannot listen on {address}:1337" in it.messages()
    first.free()


# In our master.


@contextmanager
def coupled(address: str, fmi: int = 2, **options: Any) -> Iterator[OpenSystem]:
    """Open the plant with the interface in the place of its controller."""
    files = build(["plant"], Target(fmi=fmi))
    files["controller"] = build(["franka"], Target(fmi=fmi))["franka"]
    ends = [(f"ctrl[{i}]", f"torque[{i}]") for i in range(1, 8)]
    feeds = [(n, n) for v in FRANKA.of("input") for n in v.names()]
    connections = [
        *(Connection(("controller", a), ("plant", b)) for a, b in [*ends, ("ctrl[8]", "ctrl[8]")]),
        *(Connection(("plant", a), ("controller", b)) for a, b in feeds),
    ]
    outputs = {name: [n for v in interface.of("output") for n in v.names()]
               for name, interface in (("plant", PLANT), ("controller", FRANKA))}  # fmt: skip
    order = {name: files[name] for name in ("controller", "plant")}
    given = {"controller": {"address": address, "connection_timeout": 60.0},
             "plant": {"scene": PARAMETERS.scene, "robot": PARAMETERS.robot}}  # fmt: skip
    system = System(order, connections, [], outputs)
    with open_system(system, given, stop=1e-3 * MOST_STEPS, **options) as opened:
        yield opened


@needs_clients
def test_fmus_of_either_version_give_the_bits_of_the_objects(fmi):
    with claimed_address() as address, coupled(address, fmi) as opened:
        with client("joint", address):
            rows = all_rows(opened.master, MOST_STEPS)
        assert "the program has left" in str(opened.master.ended)
        first = 1 + opened.master.columns.index(("controller", "ctrl[1]"))  # after the time
    expected = couple("joint").output("ctrl")
    np.testing.assert_array_equal(rows[: len(expected), first : first + 8], expected)


def test_a_signal_ends_the_wait_for_a_program(address):
    came = []
    signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    with coupled(address) as opened:
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        all_rows(opened.master, MOST_STEPS)
    assert came == [signal.SIGINT]
    assert "SIGINT while it waited for the program" in str(opened.master.ended)


def test_pythonfmu_s_wrapper_does_not_hold_it():
    assert Target("pythonfmu").kind_of("franka") == "python"
    fmu = read_fmu(build(["franka"], Target("pythonfmu"))["franka"])
    assert (fmu.code, fmu.in_python) == ("python", False)
