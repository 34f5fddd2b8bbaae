"""Our slaves in PythonFMU's wrapper: the same bits, and each trap of that host."""

import gc
import re
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

from fmu_support import changed_plant
from forked import command, script
from panda_cosim.cli.app import app
from panda_cosim.fmus.build.platforms import PLATFORMS, this_platform
from panda_cosim.fmus.errors import CosimError, SimulationError
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.fmus.master.fmu_file import Fmu, described_interface
from panda_cosim.fmus.sources.targets import HOSTED, OWN, Target, build, build_fmu
from panda_cosim.run.execution import run_scenario
from panda_cosim.run.options import Options
from panda_cosim.run.prepare import prepare
from panda_cosim.run.start import start_values
from panda_cosim.task.scenario import load_scenario

STEP = 0.001  # [s]
PACKED = Target("pythonfmu")
STEPS = b"self._plant.step(count)"  # what a step of the plant's slave does


class Unit:
    """An FMU in plain FMPy, initialized."""

    def __init__(self, path: Path) -> None:
        fmu = Fmu(path)
        self.references = {v.name: v.valueReference for v in fmu.description.modelVariables}
        self.slave = FMU2Slave(
            guid=fmu.guid,
            unzipDirectory=str(fmu.folder),
            modelIdentifier=fmu.description.coSimulation.modelIdentifier,
            instanceName="it",
        )
        self.slave.instantiate()
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def get(self, names: Sequence[str]) -> list[float]:
        """Values of Reals."""
        values: list[float] = self.slave.getReal([self.references[name] for name in names])
        return values

    def steps(self, count: int, first: int = 0) -> "Unit":
        """Take steps of 1 ms."""
        for tick in range(first, first + count):
            self.slave.doStep(tick * STEP, STEP)
        return self


def outputs(unit: Unit) -> list[float]:
    """All outputs of a plant."""
    return unit.get([n for v in INTERFACES["plant"].of("output") for n in v.names()])


@cache
def plant() -> Path:
    """The packed plant."""
    return build(["plant"], target=PACKED)["plant"]


def with_step(step: bytes) -> Path:
    """A packed plant that does something else in place of a step."""
    return build_fmu(changed_plant("pythonfmu", STEPS, step))


# The same bits.


@pytest.mark.own_process
@pytest.mark.parametrize("name", ["elastic", "sensor_noise", "jacobi"])
def test_our_master_gives_the_same_bits_with_each_kind(name, tmp_path):
    scenario = load_scenario(name).changed({"duration": 1.0})
    runs = [
        run_scenario(scenario, tmp_path / kind, Options(kind=kind)).recording
        for kind in ("native", "pythonfmu")
    ]
    for column in runs[0].columns:
        assert runs[0][column].tobytes() == runs[1][column].tobytes(), column


@pytest.mark.long
@pytest.mark.parametrize("kind", ["python", "pythonfmu"])
def test_all_references_match_in_python(kind):
    done = command("regress", "--kind", kind, code=0)
    assert re.search(r"(\d+) of \1 scenarios match|31 of 32 .*; 1 skipped", done.stdout)


@pytest.mark.own_process
@pytest.mark.parametrize("name", [name for name in OWN if name not in HOSTED])
def test_the_description_is_ours_and_valid(name):
    packed, ours = (
        Fmu(build([name], target=target)[name]) for target in (PACKED, Target("python"))
    )
    assert validate_fmu(str(packed.path)) == []
    assert described_interface(packed) == described_interface(ours)
    assert packed.in_python
    assert not ours.in_python


# A script of a user's, which PythonFMU alone packs.

SCRIPT = """from panda_cosim.fmus.inside.{name} import {base}


class Mine({base}):
    pass
"""


@pytest.mark.own_process
@pytest.mark.parametrize("name", ["plant", "trajectory"])
def test_pythonfmu_alone_makes_an_fmu_of_a_short_script(name, tmp_path):
    (tmp_path / "mine.py").write_text(SCRIPT.format(name=name, base=OWN[name].slave[1]))
    build_it = [sys.executable, "-m", "pythonfmu", "build", "-f", "mine.py"]
    subprocess.run(build_it, cwd=tmp_path, check=True, timeout=300)
    (alone,) = tmp_path.glob("*.fmu")
    paths = (alone, build([name], target=PACKED)[name])
    units, (mine, ours) = list(map(Unit, paths)), map(Fmu, paths)
    own = {n: (s.start_value(), s.variable.causality) for n, s in ours.variables.items()}
    for variable, (start, causality) in own.items():  # which PythonFMU writes with 16 digits
        scalar = mine.variables[variable]
        same = start if isinstance(start, str) else pytest.approx(start, rel=1e-15)
        assert scalar.start_value() == same
        assert scalar.variable.causality == causality
    names = [n for v in OWN[name].interface.of("output") for n in v.names()]
    first, second = (unit.steps(5).get(names) for unit in units)
    assert first == second


# The wrapper's traps.


@pytest.mark.own_process
def test_any_number_of_instances_live_in_one_process():
    expected = outputs(Unit(plant()).steps(3))
    for _ in range(2):
        gc.collect()
        unit = Unit(plant()).steps(3)
        assert outputs(unit) == expected
        unit.slave.terminate()
        unit.slave.freeInstance()


@pytest.mark.own_process
def test_two_fmus_of_one_name_run_each_its_own_code():
    still = Unit(with_step(b"pass")).steps(5)
    moving = Unit(plant()).steps(5)
    assert outputs(still) == outputs(Unit(plant()))
    assert outputs(moving) != outputs(still)


@pytest.mark.own_process
@pytest.mark.parametrize("call", ["getReal", "setReal", "getString"])
def test_an_unknown_reference_is_refused_and_shortens_nothing(call):
    unit = Unit(plant())
    values = ([0.0, 0.0],) if call.startswith("set") else ()
    with pytest.raises(FMICallException, match="fatal"):
        getattr(unit.slave, call)([0, 99999], *values)


@pytest.mark.own_process
def test_an_exception_ends_the_simulation_and_not_the_process():
    path = with_step(b"raise ValueError('broken 100%')")
    for _ in range(2):
        with pytest.raises(FMICallException, match="fatal"):
            Unit(path).steps(1)
        with pytest.raises(FMICallException, match="fatal"):
            fmpy.simulate_fmu(str(path), stop_time=0.01, step_size=STEP)
    Unit(plant()).steps(3)


@pytest.mark.own_process
def test_our_master_says_where_and_why_a_slave_failed(tmp_path):
    fmus = {"plant": with_step(b"raise ValueError('broken 100%')")}
    options = Options(fmus=fmus, kind="pythonfmu")
    with pytest.raises(SimulationError, match=r"t = 0.000 s.*'plant'.*broken 100%"):
        run_scenario("push", tmp_path / "run", options)
    assert (tmp_path / "run" / "recording.parquet").is_file()


@pytest.mark.own_process
def test_code_that_cannot_be_imported_is_named_when_it_is_built():
    fmu = changed_plant("pythonfmu", b"class PlantSlave(", b"import not_there\nclass PlantSlave(")
    with pytest.raises(CosimError, match="No module named 'not_there'"):
        build_fmu(fmu)


@pytest.mark.own_process
def test_a_state_is_restored_bit_for_bit_also_in_another_instance():
    unit, other = Unit(plant()).steps(20), Unit(plant()).steps(3)
    kept = unit.slave.serializeFMUstate(unit.slave.getFMUstate())
    expected = outputs(unit.steps(20, 20))
    for each in (unit, other):
        each.slave.setFMUstate(each.slave.deSerializeFMUstate(kept))
        assert outputs(each.steps(20, 20)) == expected


# What it cannot do, and what does without it.


@pytest.mark.own_process
@pytest.mark.parametrize(
    "words", [("--fmi", "3"), ("--platform", ",".join([this_platform(), [*PLATFORMS][-1]]))]
)
def test_what_pythonfmu_cannot_make_is_refused(words, tmp_path):
    done = CliRunner().invoke(
        app, ["build", "--kind", "pythonfmu", *words, "--out", str(tmp_path / "new")]
    )
    assert done.exit_code == 2
    assert "kind pythonfmu: PythonFMU makes FMUs of FMI 2.0" in done.output
    assert not (tmp_path / "new").exists()


# Our own FMUs as parts.


@pytest.mark.own_process
@pytest.mark.parametrize("target", [Target("native"), PACKED], ids=lambda target: target.kind)
def test_an_fmu_of_ours_gets_the_scenarios_start_values_from_any_file(target, tmp_path):
    built = build(target=target)
    parts = {name: str(path.rename(tmp_path / f"{name}-1.fmu")) for name, path in built.items()}
    scenario = load_scenario("tutorial")
    given = prepare(scenario.changed({f"fmus.{name}": file for name, file in parts.items()}))
    own = start_values(scenario)
    assert given.values == own
    assert given.assembly.changed(given.values, {})["plant"] == {"scene": "tutorial"}


@pytest.mark.own_process
def test_a_new_slave_runs_in_our_master_and_in_fmpy_alone(tmp_path):
    folder = tmp_path / "gust"
    assert CliRunner().invoke(app, ["new", str(folder), "--slave", "--law"]).exit_code == 0
    run = run_scenario(folder, tmp_path / "run")
    assert run.summary.success, run.summary.criteria
    assert not run.warnings
    ours = run.recording["gust.force"]
    build_it = [sys.executable, "-m", "pythonfmu", "build", "-f", "my_slave.py"]
    subprocess.run(build_it, cwd=folder, check=True, timeout=300)
    alone = fmpy.simulate_fmu(
        str(folder / "Gust.fmu"), stop_time=0.5, step_size=STEP, output_interval=STEP
    )["force"]
    assert np.ptp(alone) > 1.0  # [N]
    np.testing.assert_allclose(alone[1:], ours[: len(alone) - 1], rtol=0.0, atol=1e-9)  # [N]


# Without the package pythonfmu, what needs it says so in one line, and all else runs.


WITHOUT = """
import sys
from importlib import metadata
sys.modules["pythonfmu"] = None
def distribution(name):
    if name == "pythonfmu":
        raise metadata.PackageNotFoundError(name)
    return metadata.Distribution.from_name(name)
metadata.distribution = distribution
sys.argv[0] = "panda-cosim"
from panda_cosim.cli import main
main()
"""


@pytest.mark.parametrize(("words", "code"), [
    ("run push --kind python --out OUT", 2),
    ("build --kind pythonfmu --out OUT", 2),
    ("build --slave SLAVE --out OUT", 2),
    ("check sensor_offset", 2),
    ("run tutorial --duration 0.05 --no-video --no-view --out OUT", 3),
    ("check push", 0),
])  # fmt: skip
def test_without_the_package_only_what_needs_it_fails_in_one_line(words, code, tmp_path):
    places = {"OUT": tmp_path / "new", "SLAVE": Path(__file__).parents[1] / "slaves" / "decay.py"}
    done = script(WITHOUT, *(str(places.get(word, word)) for word in words.split()))
    assert done.returncode == code, done.stderr
    if code == 2:
        told = " ".join((done.stdout + done.stderr).split())
        assert told.count("the package pythonfmu is not installed") == 1
        assert "Traceback" not in told
        assert not (tmp_path / "new").exists()
