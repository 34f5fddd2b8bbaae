"""Systems of other people's FMUs: nothing of their files is changed or dropped in silence."""

import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from fmu_support import needs_compiler
from forked import command
from odd_fmu import Variable, odd_fmu, odd_ssp
from panda_cosim import Recording, Scenario, Session
from panda_cosim.fmus.master.ssp_reader import system_from_ssp

pytestmark = needs_compiler
CONTROL = [
    ("p", "Real", "parameter", 0),
    ("n", "Integer", "parameter", 0),
    ("b", "Boolean", "parameter", 0),
]
OUTPUTS = [
    ("y", "Real", "output", 100),
    ("count", "Integer", "output", 100),
    ("z", "Real", "output", 101),
    ("on", "Boolean", "output", 100),
    ("said", "String", "output", 100),
]
VARIABLES: list[Variable] = [*CONTROL, *OUTPUTS]


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory):
    """A cache for these FMUs alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PANDA_COSIM_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


def run(
    ssp: Path, out: Path, *arguments: str, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    options = ("--no-video", *arguments)
    return command("run", "--system", ssp, "--out", out, *options, cwd=cwd, **environment)


def outputs(*names: str) -> list[Variable]:
    return [(name, "Real", "output", 120 + k) for k, name in enumerate(names)]


NAMES = ("hand_xpos[3]", "y", "y[1]", "pipe[1].T[2]", "pipe[2].T[1]", "a[1,2]", "a[2]", "a[0]",
         "x y", "$x$", "ü", "time")  # fmt: skip


def test_a_recording_of_any_names_can_be_opened(tmp_path):
    fmu = odd_fmu(tmp_path / "odd.fmu", outputs(*NAMES))
    ssp = odd_ssp(tmp_path / "odd.ssp", {"c": fmu}, {"c": NAMES})
    done = run(ssp, tmp_path / "run")
    assert done.returncode == 0, done.stderr
    recording = Recording.open(tmp_path / "run")
    for name in NAMES:
        assert recording[f"c.{name}"].tolist() == [float(n) for n in range(11)]
    for name, out in (("export", ["all.csv"]), ("plot", [])):
        command(name, tmp_path / "run", *out, cwd=tmp_path, code=0)


def test_names_that_would_be_one_column_are_refused(tmp_path):
    one = odd_fmu(tmp_path / "one.fmu", outputs("b.c"))
    other = odd_fmu(tmp_path / "other.fmu", outputs("c"))
    ssp = odd_ssp(tmp_path / "x.ssp", {"a": one, "a.b": other}, {"a": ["b.c"], "a.b": ["c"]})
    done = run(ssp, tmp_path / "run")
    assert done.returncode == 2
    assert "'a' and 'a.b': 'b.c' and 'c' would both be column a.b.c of the rec" in done.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
def test_integers_booleans_and_text_are_recorded(tmp_path, isolate):
    fmu = odd_fmu(tmp_path / "odd.fmu", VARIABLES)
    parameters = (
        '<ssv:Parameter name="p"><ssv:Real value="0.5"/></ssv:Parameter>'
        '<ssv:Parameter name="n"><ssv:Integer value="-2147483648"/></ssv:Parameter>'
        '<ssv:Parameter name="b"><ssv:Boolean value="true"/></ssv:Parameter>'
    )
    names = [name for name, *_ in OUTPUTS]
    ssp = odd_ssp(tmp_path / "odd.ssp", {"c": fmu}, {"c": names}, {"c": parameters})
    done = run(ssp, tmp_path / "run", *isolate)
    assert done.returncode == 0, done.stderr
    recording = Recording.open(tmp_path / "run")
    assert recording.columns == ("time", "c.y", "c.count", "c.z", "c.on")
    assert recording.texts == ("c.said",)
    steps = range(11)
    assert recording["c.y"].tolist() == [0.5 + k for k in steps]
    assert recording["c.count"].tolist() == [-2147483648.0 + k for k in steps]
    assert recording["c.z"].tolist() == [float(k) for k in steps]
    assert recording["c.on"].tolist() == [1.0] * 11


def test_the_start_time_is_the_first_row_s(tmp_path):
    fmu = odd_fmu(tmp_path / "odd.fmu", [*outputs("y"), ("start", "Real", "output", 199)])
    experiment = '<ssd:DefaultExperiment startTime="2.5" stopTime="2.51"/>'
    ssp = odd_ssp(tmp_path / "odd.ssp", {"c": fmu}, {"c": ["y", "start"]}, experiment=experiment)
    done = run(ssp, tmp_path / "run")
    assert done.returncode == 0, done.stderr
    recording = Recording.open(tmp_path / "run")
    assert recording.time.tolist() == [2.5 + k * 0.001 for k in range(11)]
    assert recording["c.start"][0] == 2.5  # as the FMU is told


@pytest.mark.own_process
def test_a_session_of_a_system_keeps_the_criteria_within_its_time(tmp_path):
    fmu = odd_fmu(tmp_path / "odd.fmu", outputs("y"))
    experiment = '<ssd:DefaultExperiment startTime="2.5" stopTime="2.51"/>'
    odd_ssp(tmp_path / "odd.ssp", {"c": fmu}, {"c": ["y"]}, experiment=experiment)
    (tmp_path / "scenario.toml").write_text(
        'system = "odd.ssp"\nduration = 0.01\n[[success.signal]]\n'
        'signal = "c.y"\nreduce = "max"\nto = 2.504\nbelow = 9.0\n'
    )
    with Session(tmp_path) as session:
        session.step(5)
        assert session.as_scenario().success == Scenario.read(tmp_path).success


def test_the_fmus_name_the_times_that_the_system_leaves_open(tmp_path):
    experiments = {"one": 'startTime="1" stopTime="3"', "other": 'stopTime="4" stepSize="0.5"'}
    fmus = {
        name: odd_fmu(tmp_path / f"{name}.fmu", outputs("y"), "", f"<DefaultExperiment {text}/>")
        for name, text in experiments.items()
    }
    read = system_from_ssp(odd_ssp(tmp_path / "x.ssp", fmus, {}, experiment=""))
    assert (read.start_time, read.stop_time, read.step_size) == (1.0, 4.0, 0.5)


def test_what_can_be_instantiated_once_is_instantiated_once(tmp_path):
    flag = ' canBeInstantiatedOnlyOncePerProcess="true"'
    fmu = odd_fmu(tmp_path / "odd.fmu", outputs("y"), flag)
    twice = odd_ssp(tmp_path / "twice.ssp", {"a": fmu, "b": fmu}, {"a": ["y"], "b": ["y"]})
    done = run(twice, tmp_path / "twice")
    assert done.returncode == 2
    told = f"{twice}: component 'b' (resources/odd.fmu): 'a' and 'b' are both instances of it"
    assert told in " ".join(done.stderr.split())
    assert "--isolate" in done.stderr
    assert run(twice, tmp_path / "isolated", "--isolate").returncode == 0
    once = odd_ssp(tmp_path / "once.ssp", {"a": fmu}, {"a": ["y"]})
    assert run(once, tmp_path / "once").returncode == 0


def scenario_of(folder: Path, fmus: Sequence[Path], connect: str = "") -> Path:
    """A scenario without a trajectory, of FMUs by the names of their files."""
    named = "".join(f'{fmu.stem} = "{fmu}"\n' for fmu in fmus)
    folder.mkdir()
    text = f'purpose = "x"\nduration = 0.01\n[fmus]\n{named}[connect]\n{connect}\n'
    (folder / "scenario.toml").write_text(text)
    return folder


@pytest.mark.parametrize(
    ("giving", "taking"), [("Real", "Real"), ("Integer", "Real"), ("Real", "Integer")]
)
def test_check_refuses_the_connections_that_run_refuses_in_the_same_words(tmp_path, giving, taking):
    one = odd_fmu(tmp_path / "one.fmu", [("y", giving, "output", 100)])
    two = odd_fmu(tmp_path / "two.fmu", [("u", taking, "input", 0), ("z", "Real", "output", 101)])
    scenario = scenario_of(tmp_path / "x", [one, two], '"two.u" = "one.y"')
    assert agreed(scenario) == (taking == "Real")


def agreed(scenario: Path) -> bool:
    """Whether a scenario can be run; `check` must say the same, in the same words."""
    done = run_of(scenario)
    checked = command("check", scenario)
    told = " ".join(done.stderr.split())
    refused = " ".join(checked.stdout.split()).removeprefix("wrong ")
    if done.returncode == 0:
        assert checked.returncode == 0, checked.stdout
        return True
    assert (done.returncode, checked.returncode) == (2, 2), (told, refused)
    assert refused.removeprefix(f"{scenario}/scenario.toml: ") in told
    assert not (scenario / "run").exists()
    return False


def test_check_names_what_run_would_warn_of(tmp_path):
    experiment = '<DefaultExperiment stepSize="0.01"/>'
    one = odd_fmu(tmp_path / "one.fmu", outputs("y"), "", experiment, varies="false")
    two = odd_fmu(tmp_path / "two.fmu", outputs("y"))
    scenario = scenario_of(tmp_path / "x", [one, two])
    checked = command("check", scenario)
    said = " ".join(checked.stdout.split())
    assert checked.returncode == 0
    assert "its FMUs are not connected" in said
    assert "good" not in said
    warning = "one: supports a single step size, 0.01 s; steps of 0.001 s may be refused"
    assert warning in said
    assert warning in " ".join(run_of(scenario).stderr.split())


def run_of(scenario: Path) -> subprocess.CompletedProcess[str]:
    return command("run", scenario, "--out", scenario / "run", "--no-video")


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
def test_an_fmu_that_changes_the_working_directory_and_floods_with_messages_loses_nothing(
    tmp_path, isolate
):
    fmu = odd_fmu(tmp_path / "odd.fmu", outputs("y"))
    ssp = odd_ssp(tmp_path / "x.ssp", {"c": fmu}, {"c": ["y"]})
    done = run(ssp, Path("run"), "--plot", *isolate, cwd=tmp_path, ACT="chdir")
    assert done.returncode == 0, done.stderr
    assert Recording.open(tmp_path / "run").complete
    files = {p.name for p in (tmp_path / "run").iterdir()}
    assert files == {"recording.parquet", "scenario", "summary.json", "plot.png"}
    done = run(ssp, tmp_path / "flood", *isolate, ACT="chatter")
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if "Warning: c: " in line]
    assert len(lines) == 101
    assert lines[0].endswith("this is warning 0")
    assert lines[-1].endswith("further messages are left out")


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("negative", "at t = 0.002 s, in FMU 'c': fmi2DoStep returned -1, which is not a status"),
        ("negative-setup", "in FMU 'c': set up returned -1, which is not a status"),
    ],
)
def test_a_negative_status_is_a_failure(tmp_path, fault, told):
    fmu = odd_fmu(tmp_path / "odd.fmu", outputs("y"))
    ssp = odd_ssp(tmp_path / "x.ssp", {"c": fmu}, {"c": ["y"]})
    done = run(ssp, tmp_path / "run", ACT=fault)
    assert done.returncode == 1, done.stderr
    assert told in done.stderr
