"""A user's own PythonFMU slave as an FMU: it runs, and what cannot be packaged is told."""

import shutil
import sys
from ctypes import byref, c_void_p
from pathlib import Path
from types import ModuleType

import fmpy
import pytest
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

from fmu_instance import ERROR, OK, Instance, Unpacked, unpacked_fmu
from panda_cosim.cli.app import app
from panda_cosim.fmus.errors import CosimError, InputError
from panda_cosim.fmus.interface.plant import PLANT
from panda_cosim.fmus.master.fmu_file import Fmu
from panda_cosim.fmus.sources.law import law_fmu, law_interface, read_law
from panda_cosim.fmus.sources.python_fmu import slave_fmu
from panda_cosim.fmus.sources.targets import Target, build_fmu

SLAVES = Path(__file__).parents[1] / "slaves"
pytestmark = pytest.mark.own_process


@pytest.fixture
def folder(tmp_path):
    for name in ("decay.py", "my_helper.py"):
        shutil.copy(SLAVES / name, tmp_path)
    return tmp_path


@pytest.mark.parametrize(("fmi", "name"), [("2", "decay.py"), ("3", "decay.py:Decay")])
def test_a_slave_becomes_an_fmu_that_runs(folder, fmi, name):
    out = folder / "out"
    words = ["build", "--slave", str(folder / name), "--fmi", fmi, "--out", str(out)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    fmu = str(out / "Decay.fmu")
    assert validate_fmu(fmu) == []
    x = [0.0]
    for _ in range(10):
        x.append(x[-1] + 2 * 1.0 * 0.01 * 3)
    result = fmpy.simulate_fmu(fmu, stop_time=0.1, step_size=0.01, output_interval=0.01)
    assert result["x"] == pytest.approx(x, rel=1e-12)


@pytest.fixture(scope="module", params=(2, 3), ids=("fmi2", "fmi3"))
def decay(request):
    return unpacked_fmu(slave_fmu(SLAVES / "decay.py"), request.param)


def test_values_texts_and_states_arrive(decay):
    it = Instance(decay).start({"u": [2.0]})
    assert [it.step(i * 0.01, 0.01) for i in range(3)] == [OK] * 3
    assert it.get("x") == [pytest.approx(sum([2 * 2.0 * 0.01 * 3] * 3), rel=1e-15)]
    assert it.get("echo") == [b"abc!"]
    state = it.save()
    after = []
    for _ in range(2):
        it.set("text", "neu ä".encode())
        assert it.step(0.03, 0.5) == OK
        assert it.get("echo") == ["neu ä!".encode()]
        after.append(it.get("x"))
        assert it.load(state) == OK
        assert it.get("echo") == [b"abc!"]
    assert after[0] == after[1]
    assert it("Terminate") == OK
    it.free()
    assert it.log == []


@pytest.mark.parametrize(
    ("fail", "told"), [(1.0, "RuntimeError: boom 100%"), (2.0, "do_step returned False")]
)
def test_a_failure_of_the_slave_is_an_error(decay, fail, told):
    it = Instance(decay).start({"fail": [fail]})
    assert it.step(0.0, 0.01) == ERROR
    assert told in it.messages()
    assert ('decay.py", line ' in it.messages()) == (fail == 1.0)
    assert it("Reset") == OK
    it.start({"fail": [0.0], "u": [2.5]})
    assert it.step(0.0, 0.01) == OK
    big = decay.rows["big"].reference
    assert it.get_references([big], 1, "Integer")[0] == ERROR
    assert "big = 2.5e+09 does not fit an integer" in it.messages()


def test_the_hosts_modules_and_path_stay_as_they_are(folder):
    sys.modules["my_helper"] = own = ModuleType("my_helper")
    path, meta = list(sys.path), list(sys.meta_path)
    it = Instance(unpacked_fmu(slave_fmu(folder / "decay.py"))).start()
    (folder / "my_helper.py").write_text("def double(x):\n    return 100 * x\n")
    other = Instance(unpacked_fmu(slave_fmu(folder / "decay.py"))).start()
    for one, factor in ((it, 2), (other, 100)):
        assert one.step(0.0, 1.0) == OK
        assert one.get("x") == [factor * 3.0]
    assert sys.modules["my_helper"] is own
    assert "decay" not in sys.modules
    assert (sys.path, sys.meta_path) == (path, meta)


def test_a_changed_helper_is_another_fmu_and_what_an_editor_leaves_is_not(folder):
    before = slave_fmu(folder / "decay.py").digest
    (folder / ".#decay.py").symlink_to("me@here.4711:1732")
    assert slave_fmu(folder / "decay.py").digest == before
    (folder / "my_helper.py").write_text("def double(x):\n    return 3 * x\n")
    assert slave_fmu(folder / "decay.py").digest != before


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("class A: pass", "must have one subclass of Fmi2Slave, or name one of: A"),
        ("def (", "not valid Python"),
        (None, "cannot be read: No such file"),
    ],
)
def test_a_file_without_a_slave_is_refused(tmp_path, source, told):
    path = tmp_path / "mine.py"
    if source is not None:
        path.write_text(source)
    with pytest.raises(InputError, match=told):
        slave_fmu(path)


def test_a_slave_that_cannot_be_made_is_reported_with_its_reason(folder):
    path = folder / "decay.py"
    path.write_text(path.read_text().replace("super().__init__(**kwargs)", "1 / 0"))
    with pytest.raises(CosimError, match="Decay cannot be instantiated: ZeroDivisionError"):
        slave_fmu(path)


PECULIAR = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real, String
from pythonfmu.enums import Fmi2Status

class Peculiar(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u, self.time, self.fixed, self.word = 1.0, 0.0, 3.0, "begun"
        setattr(self, "share [%]", 50.0)
        computed = {"causality": Fmi2Causality.output}
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("time", **computed))
        self.register_variable(Real("fixed", variability=Fmi2Variability.constant, **computed))
        self.register_variable(String("word", **computed))
        self.register_variable(Real("share [%]", causality=Fmi2Causality.parameter,
                                    variability=Fmi2Variability.fixed))

    def do_step(self, current_time, step_size):
        self.time = current_time + step_size
        if self.time > 0.035:
            self.log("the spring is broken", Fmi2Status.error)
        return self.time < 0.035
"""


@pytest.fixture(scope="module", params=[2, 3])
def peculiar(request, tmp_path_factory):
    """An FMU whose variables have odd names and variabilities, and that fails after three steps."""
    folder = tmp_path_factory.mktemp("peculiar")
    (folder / "peculiar.py").write_text(PECULIAR)
    fmu = slave_fmu(folder / "peculiar.py", "Peculiar")
    return build_fmu(fmu, Target(fmi=request.param))


def test_a_slave_may_have_any_names_and_says_why_it_failed(peculiar):
    assert validate_fmu(str(peculiar)) == []
    it = Instance(Unpacked(Fmu(peculiar).folder)).start()
    assert [it.step(i * 0.01, 0.01) for i in range(4)] == [OK, OK, OK, ERROR]
    warning, failure = (text for _, _, text in it.log)
    assert warning.endswith("DoStep: the spring is broken")
    assert failure.endswith("DoStep: do_step returned False")


def test_the_description_of_a_slave_claims_nothing_that_is_not_known(peculiar):
    description = fmpy.read_model_description(str(peculiar))
    variables = {v.name: v for v in description.modelVariables}
    assert {v.description for v in variables.values()} <= {None, "Simulation time"}
    assert variables["word"].start is None
    assert float(variables["fixed"].start) == 3.0
    first = {unknown.variable.name: unknown for unknown in description.initialUnknowns}
    assert set(first) == {"time", "word"}
    assert first["time"].dependencies is None  # all, the inputs too


# The state of a law's FMU restores every bit.


LAW = '''
import threading
from collections import deque
import numpy as np

class Law:
    """Uses everything that a state can hold."""
    lock = False
    objects = False

    def start(self):
        self.ticks, self.name, self.nothing, self.odd = 0, "ä", None, float("nan")
        self.line = deque([0.0] * 3, 3)
        self.square = np.asfortranarray(np.arange(9.0).reshape(3, 3) / 7)
        self.whole, self.yes, self.one = np.arange(3), np.array([True]), np.float64(1 / 3)
        self.table = {1: (2.0, [3.0]), "set": {4.0}}
        self.sum = 0.0
        if self.lock:
            self.thing = threading.Lock()
        if self.objects:
            self.things = np.array([None])

    def update(self, time, qpos):
        self.ticks += 1
        self.line.append(self.line[0] / 2 + self.ticks / 7)
        self.square = np.asfortranarray(self.square @ self.square / 3 + 0.1)
        self.table[1] = (self.table[1][0] + self.whole[2] * self.one, [time])
        self.sum += 0.1 * (self.line[0] - self.sum)
        return [self.square[0, 1] % 1, self.sum, *self.line, self.table[1][0], self.ticks, 0]
'''


@pytest.fixture
def fmu(tmp_path):
    file = tmp_path / "my_law.py"
    file.write_text(LAW)
    law = read_law(file, "Law")
    interface = law_interface(law, PLANT.variable, PLANT.variable("ctrl"))
    return unpacked_fmu(law_fmu(law, interface, (0.0,) * 8))


def test_a_laws_state_restores_every_bit(fmu):
    it, other = Instance(fmu).start(), Instance(fmu).start()
    it.play(0, 10)
    other.play(0, 20)
    data = it.serialize(it.save())
    expected = it.play(10, 10)
    for one in (it, other):
        status, state = one.deserialize(data)
        assert status == one.load(state) == OK
        assert one.play(10, 10) == expected


@pytest.mark.parametrize(
    ("switch", "told"),
    [("lock", "self.thing holds a lock"), ("objects", "self.things holds a ndarray")],
)
def test_a_law_that_cannot_be_saved_says_which_attribute(fmu, switch, told):
    it = Instance(fmu).start({switch: [True]})
    assert it("GetFMUstate", byref(c_void_p())) == ERROR
    assert f"{told}; must be numbers, texts" in it.messages()
    it.play(0, 10)  # it can go on
