"""Systems of other people's FMUs: nothing of their files is changed or dropped in silence."""

import json
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from bounded import line_of, running
from fault_support import run_command
from fmu_support import compiler, members, needs_compiler, pack
from forked import command
from odd_fmu import Variable, odd_fmu, odd_ssp
from panda_cosim import Recording, Scenario, Session
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.master.ssp_reader import system_from_ssp
from toy_fmu import toy_fmu

pytestmark = needs_compiler


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory):
    """A cache for these FMUs alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PANDA_COSIM_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


def run(ssp: Path, out: Path, *arguments: str, **more: Any) -> str:
    """Run a system; returns what is told."""
    return command("run", "--system", ssp, "--out", out, "--no-video", *arguments, **more).stderr


def recorded(ssp: Path, out: Path, *arguments: str) -> Recording:
    run(ssp, out, *arguments, code=0)
    return Recording.open(out)


def outputs(*names: str) -> list[Variable]:
    return [(name, "Real", "output", 120 + k) for k, name in enumerate(names)]


NAMES = ("hand_xpos[3]", "y", "y[1]", "pipe[1].T[2]", "pipe[2].T[1]", "a[1,2]", "a[2]", "a[0]",
         "x y", "$x$", "ü", "time")  # fmt: skip


def test_a_recording_of_any_names_can_be_opened(tmp_path):
    fmu = odd_fmu(tmp_path / "odd.fmu", outputs(*NAMES))
    ssp = odd_ssp(tmp_path / "odd.ssp", {"c": fmu}, {"c": NAMES})
    recording = recorded(ssp, tmp_path / "run")
    for name in NAMES:
        assert recording[f"c.{name}"].tolist() == [float(n) for n in range(11)]
    for name, out in (("export", ["all.csv"]), ("plot", [])):
        command(name, tmp_path / "run", *out, cwd=tmp_path, code=0)


def test_names_that_would_be_one_column_are_refused(tmp_path):
    one = odd_fmu(tmp_path / "one.fmu", outputs("b.c"))
    other = odd_fmu(tmp_path / "other.fmu", outputs("c"))
    ssp = odd_ssp(tmp_path / "x.ssp", {"a": one, "a.b": other}, {"a": ["b.c"], "a.b": ["c"]})
    told = run(ssp, tmp_path / "run", code=2)
    assert "'a' and 'a.b': 'b.c' and 'c' would both be column a.b.c of the rec" in told
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
def test_integers_booleans_and_text_are_recorded(tmp_path, isolate):
    own = [("p", "Real"), ("n", "Integer"), ("b", "Boolean")]
    given = [("y", "Real"), ("count", "Integer"), ("z", "Real"), ("on", "Boolean"),
             ("said", "String")]  # fmt: skip
    variables: list[Variable] = [(name, kind, "parameter", 0) for name, kind in own]
    variables += [(name, kind, "output", 100 + (name == "z")) for name, kind in given]
    fmu = odd_fmu(tmp_path / "odd.fmu", variables)
    parameters = (
        '<ssv:Parameter name="p"><ssv:Real value="0.5"/></ssv:Parameter>'
        '<ssv:Parameter name="n"><ssv:Integer value="-2147483648"/></ssv:Parameter>'
        '<ssv:Parameter name="b"><ssv:Boolean value="true"/></ssv:Parameter>'
    )
    names = {"c": [name for name, _ in given]}
    ssp = odd_ssp(tmp_path / "odd.ssp", {"c": fmu}, names, {"c": parameters})
    recording = recorded(ssp, tmp_path / "run", *isolate)
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
    recording = recorded(ssp, tmp_path / "run")
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
    told = " ".join(run(twice, tmp_path / "twice", code=2).split())
    where = f"{twice}: component 'b' (resources/odd.fmu)"
    assert f"{where}: 'a' and 'b' are both instances of it" in told
    assert "--isolate" in told
    recorded(twice, tmp_path / "isolated", "--isolate")
    recorded(odd_ssp(tmp_path / "once.ssp", {"a": fmu}, {"a": ["y"]}), tmp_path / "once")


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
    done, checked = run_of(scenario), command("check", scenario)
    code = 0 if taking == "Real" else 2
    assert (done.returncode, checked.returncode) == (code, code), (done.stderr, checked.stdout)
    if code:
        refused = " ".join(checked.stdout.split()).removeprefix("wrong ")
        assert refused.removeprefix(f"{scenario}/scenario.toml: ") in " ".join(done.stderr.split())
        assert not (scenario / "run").exists()


def test_check_names_what_run_would_warn_of(tmp_path):
    experiment = '<DefaultExperiment stepSize="0.01"/>'
    one = odd_fmu(tmp_path / "one.fmu", outputs("y"), "", experiment, varies="false")
    two = odd_fmu(tmp_path / "two.fmu", outputs("y"))
    scenario = scenario_of(tmp_path / "x", [one, two])
    said = " ".join(command("check", scenario, code=0).stdout.split())
    assert "its FMUs are not connected" in said
    assert "good" not in said
    warning = "one: supports a single step size, 0.01 s; steps of 0.001 s may be refused"
    assert warning in said
    assert warning in " ".join(run_of(scenario).stderr.split())


def run_of(scenario: Path) -> subprocess.CompletedProcess[str]:
    return command("run", scenario, "--out", scenario / "run", "--no-video")


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
def test_an_fmu_that_changes_the_directory_and_talks_a_lot_loses_nothing(tmp_path, isolate):
    fmu = odd_fmu(tmp_path / "odd.fmu", outputs("y"))
    ssp = odd_ssp(tmp_path / "x.ssp", {"c": fmu}, {"c": ["y"]})
    run(ssp, Path("run"), "--plot", *isolate, cwd=tmp_path, ACT="chdir", code=0)
    assert Recording.open(tmp_path / "run").complete
    files = {p.name for p in (tmp_path / "run").iterdir()}
    assert files == {"recording.parquet", "scenario", "summary.json", "plot.png"}
    told = run(ssp, tmp_path / "flood", *isolate, ACT="chatter", code=0)
    first, *others, last = (line for line in told.splitlines() if "Warning: c: " in line)
    assert (first[-17:], len(others)) == ("this is warning 0", 99)
    assert last.endswith("further messages are left out")


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
    assert told in run(ssp, tmp_path / "run", ACT=fault, code=1)


# Values to start from.
def values_of_x(folder: Path, causality: str) -> list[float]:
    """Set x, which y follows, in a section, by an .ssv and by key; return y at the starts."""
    fmu = odd_fmu(folder / "odd.fmu", [("x", "Real", causality, 0), ("y", "Real", "output", 100)])
    value = '<ssv:Parameter name="x"><ssv:Real value="2"/></ssv:Parameter>'
    odd_ssp(folder / "odd.ssp", {"c": fmu}, {"c": ["y"]}, {"c": value})
    parameters = "[parameters.c]\nx = 2.0\n"
    systems = {
        "section": f'duration = 0.01\n[fmus]\nc = "{fmu}"\n{parameters}',
        "ssv": f'duration = 0.01\nsystem = "{folder}/odd.ssp"\n',
    }
    starts = []
    for name, text in systems.items():
        (folder / name).mkdir()
        (folder / name / "scenario.toml").write_text(text)
        scenario = Scenario.read(folder / name)
        for changes in ({}, {"c.x": 3.0}):
            with Session(scenario.changed(changes)) as session:
                starts.append(float(session.state()["c.y"]))
    return starts


@pytest.mark.own_process
@pytest.mark.parametrize("causality", ["local", "output", "calculatedParameter"])
@pytest.mark.parametrize("initial", ["exact", "approx"])
def test_all_that_fmi_lets_start_from_a_value_can_be_set(tmp_path, causality, initial):
    assert values_of_x(tmp_path, f"{causality} {initial}") == [2.0, 3.0, 2.0, 3.0]


@pytest.mark.own_process
@pytest.mark.parametrize("causality", ["local", "output", "local calculated"])
def test_what_the_fmu_computes_alone_cannot_be_set(tmp_path, causality):
    with pytest.raises(InputError, match=r"c\.x: (no such parameter|of causality output)"):
        values_of_x(tmp_path, causality)
    fmu, ssp = tmp_path / "odd.fmu", tmp_path / "odd.ssp"
    value = '<ssv:Parameter name="x"><ssv:Real value="2"/></ssv:Parameter>'
    with pytest.raises(InputError, match=r"c\.x: causality .*; must be parameter or input, or ini"):
        system_from_ssp(odd_ssp(ssp, {"c": fmu}, {}, {"c": value}))


# What FMUs say.
def toy_scenario(folder: Path, act: str, fmi: int = 2, duration: float = 0.01) -> Path:
    """A scenario of one toy."""
    folder.mkdir()
    toy_fmu(folder / "toy.fmu", fmi)
    text = f'duration = {duration}\n[fmus]\na = "toy.fmu"\n[parameters.a]\nact = "{act}"\n'
    (folder / "scenario.toml").write_text(text)
    return folder


@pytest.mark.parametrize("how", ["kernel", "fmpy", "isolate"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_failure_tells_what_the_fmu_said_in_the_call_and_warned_before(tmp_path, fmi, how):
    folder = toy_scenario(tmp_path / "toys", "explain", fmi)
    options = ["--isolate"] if how == "isolate" else ["--master", how]
    words = ("run", folder, "--out", tmp_path / "run", "--no-video", "--log", "a", *options)
    *before, error = command(*words, code=1).stderr.splitlines()
    said = "step 3 is small; singular matrix; see the manual"
    name = f"fmi{fmi}DoStep"
    assert f"at t = 0.002 s, in FMU 'a': {name} returned Error: {said}; the record" in error
    warnings = [line for line in before if line.startswith(("Warning: a: step", "Warning: a err"))]
    assert warnings[:3] == [f"Warning: a: step {k} is small" for k in (1, 2, 3)]
    assert warnings[3] == "Warning: a error: singular matrix"
    # With --log, as it comes.
    logged = [line for line in before if line.startswith("a: [")]
    assert logged[:4] == [
        "a: [OK] factorizes", "a: [Warning] step 1 is small",
        "a: [OK] factorizes", "a: [Warning] step 2 is small",
    ]  # fmt: skip


def test_log_names_an_fmu(tmp_path):
    done = command("run", toy_scenario(tmp_path / "toys", ""), "--log", "b", code=2)
    assert "--log: value 'b'; must be one of a" in done.stderr


@pytest.mark.parametrize("options", [[], ["--isolate"]])
def test_what_an_fmu_prints_is_in_no_result(tmp_path, options):
    folder = toy_scenario(tmp_path / "toys", "print")
    done = command("run", folder, "--out", tmp_path / "run", "--no-video", "--json", *options)
    assert json.loads(done.stdout)["exit_code"] == 0
    assert [f"{k} steps" in done.stderr for k in (1, 10)] == [True, True]


# What cannot be opened.
def test_a_library_that_another_one_lacks_is_named(tmp_path):
    folder, tool = toy_scenario(tmp_path / "toys", ""), compiler()
    assert tool
    for name, more in (("libabsent.so", []), ("toy.so", ["-L.", "-labsent", "-Wl,--no-as-needed"])):
        source = tmp_path / "empty.c"
        source.write_text("int nothing;")
        command_line = [tool, "-shared", "-fPIC", *more[-1:], source, "-o", name, *more[:-1]]
        subprocess.run(command_line, cwd=tmp_path, check=True, timeout=300)
    binary = {"binaries/linux64/toy.so": (tmp_path / "toy.so").read_bytes()}
    pack(folder / "toy.fmu", members(folder / "toy.fmu") | binary)
    said = "its library needs libabsent.so, which is not on this machine"
    done = command("run", folder, "--out", tmp_path / "run", "--no-video", code=2)
    assert said in done.stderr
    assert said in " ".join(command("check", folder, code=2).stdout.split())
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)]
)
def test_an_fmu_that_takes_over_signals_does_not_keep_them_from_ending_a_run(tmp_path, number):
    folder, out = toy_scenario(tmp_path / "toys", "ignore", duration=60.0), tmp_path / "run"
    command_line = run_command(folder, out, realtime=1.0)
    with running(command_line, stdout=subprocess.PIPE) as process:
        line_of(process)  # it steps
        process.send_signal(number)
        assert process.wait(30) == 128 + number
    assert Recording.open(out).reason == f"stopped by {number.name}"
