"""Events and ends: event mode, FMUs that end the simulation, values that are not finite."""

import re
from pathlib import Path

import fmpy
import numpy as np
import pytest

from fmu_support import needs_compiler, pack
from forked import QUIET, command
from panda_cosim import Recording
from toy_fmu import library, toy_fmu

pytestmark = needs_compiler
SOURCE = Path(__file__).parents[1] / "c_fmu" / "events.c"
STEP, TICKS = 0.1, 10  # s
WAYS = [(), ("--master", "fmpy"), ("--isolate",)]
DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="events" instantiationToken="events">
<CoSimulation modelIdentifier="events" canHandleVariableCommunicationStepSize="true" {events}/>
<ModelVariables>
<Float64 name="x" valueReference="0" causality="output"/>
<Int32 name="n" valueReference="1" causality="input" start="0"/>
<Int32 name="seen" valueReference="2" causality="output"/>
<Int32 name="updates" valueReference="3" causality="output"/>
<Float64 name="rough" valueReference="4" causality="output"/>
<Int32 name="act" valueReference="5" causality="parameter" variability="fixed" start="0"/>
</ModelVariables>
<ModelStructure><Output valueReference="0"/></ModelStructure>
</fmiModelDescription>
"""


def events_fmu(path: Path, *, has_events: bool, source: Path = SOURCE) -> Path:
    text = DESCRIPTION.format(events='hasEventMode="true"' if has_events else "")
    binary = f"binaries/{fmpy.platform_tuple}/events.so"
    return pack(path, {"modelDescription.xml": text, binary: library(source)})


def run(folder: Path, text: str, *arguments: str, code: int = 0) -> str:
    """Run a scenario of one second; returns what is told."""
    head = f"duration = {TICKS * STEP}\nstep = {STEP}\n"
    (folder / "scenario.toml").write_text(head + text)
    done = command("run", folder, "--out", folder / "run", *QUIET, *arguments, code=code)
    return " ".join((done.stdout + done.stderr).split())


def events(folder: Path, more: str = "", *, act: int = 0, has_events: bool = True) -> str:
    """A scenario of the FMU, whose value that is not finite is allowed."""
    events_fmu(folder / "events.fmu", has_events=has_events)
    fmus = f'[fmus]\nf = "events.fmu"\n[parameters.f]\nact = {act}\n'
    return f'not_finite = ["f.rough"]\n{fmus}{more}'


def grown(time: float) -> float:
    """1 for the first quarter of a second, then twice as much in each."""
    whole, rest = divmod(time + 1e-12, 0.25)
    return 0.25 * (2.0**whole - 1.0) + rest * 2.0**whole


@pytest.mark.parametrize("way", WAYS, ids=["plain", "fmpy", "isolated"])
@pytest.mark.parametrize("has_events", [False, True])
def test_events_within_and_at_the_end_of_steps_are_met(tmp_path, way, has_events):
    """Two updates at each of four events, and one after initialization; without, FMUs do it."""
    run(tmp_path, events(tmp_path, has_events=has_events), *way)
    recording = Recording.open(tmp_path / "run")
    np.testing.assert_allclose(recording["f.x"], [grown(t) for t in recording.time], atol=1e-9)
    assert recording["f.updates"].tolist() == (
        [1, 1, 1, 3, 3, 5, 5, 5, 7, 7, 9] if has_events else [0] * 11
    )


@pytest.mark.parametrize("way", WAYS, ids=["plain", "fmpy", "isolated"])
def test_a_discrete_input_that_changes_is_an_event(tmp_path, way):
    (tmp_path / "in.csv").write_text("time,f.n\n0,0\n0.3,0\n0.3,7\n0.6,7\n0.6,2\n")
    run(tmp_path, events(tmp_path, '[inputs]\nfile = "in.csv"\n'), *way)
    recording = Recording.open(tmp_path / "run")
    assert recording["f.n"].tolist() == [0, 0, 0, 7, 7, 7, 2, 2, 2, 2, 2]
    assert recording["f.seen"].tolist() == [0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 2]


@pytest.mark.parametrize("has_events", [False, True])
def test_an_event_that_cannot_be_handled_is_an_error(tmp_path, has_events):
    """Without event mode, or because discrete states never settle."""
    act = 4 if has_events else 3
    told = run(tmp_path, events(tmp_path, act=act, has_events=has_events), code=1)
    wanted = "do not settle" if has_events else "needs an event handled"
    assert f"at t = {0.25 if has_events else 0.3:.3f} s, in FMU 'f': " in told
    assert wanted in told


@pytest.mark.parametrize("way", WAYS, ids=["plain", "fmpy", "isolated"])
@pytest.mark.parametrize(
    ("act", "has_events", "last", "alone"),
    [(1, False, 0.3, 0.35), (1, True, 0.3, 0.35), (2, True, 0.5, 0.5), (5, False, 0.3, 0.3)],
)
@pytest.mark.parametrize("is_alone", [False, True])
def test_an_fmu_of_fmi_3_ends_the_simulation(tmp_path, way, act, last, alone, has_events, is_alone):
    """In good order: incomplete, judged, with its last row, and never as a success."""
    text = events(tmp_path, act=act, has_events=has_events)
    if not is_alone:
        toy_fmu(tmp_path / "toy.fmu", 3)
        text = text.replace("[fmus]\n", '[fmus]\na = "toy.fmu"\nz = "toy.fmu"\n')
    text += '[[success.signal]]\nsignal = "f.x"\nreduce = "max"\nbelow = 100\n'
    told = run(tmp_path, text, *way, code=3)
    end = 0.35 if act == 1 else last
    assert "No success, as the run ended early" in told
    assert f"in FMU 'f': the FMU asks to end the simulation, at {end:g} s" in told
    recording = Recording.open(tmp_path / "run")
    assert not recording.complete
    assert recording.time[-1] == pytest.approx(alone if is_alone else last)
    assert recording["f.x"][-1] == pytest.approx(grown(recording.time[-1]))


@pytest.mark.parametrize("way", WAYS, ids=["plain", "fmpy", "isolated"])
def test_an_fmu_of_fmi_2_discards_its_last_step(tmp_path, way):
    """It says that it has terminated, in the middle of the step from 0.2 s."""
    toy_fmu(tmp_path / "toy.fmu", 2)
    told = run(tmp_path, '[fmus]\nf = "toy.fmu"\n[parameters.f]\nact = "terminate"\n', *way, code=3)
    assert "in FMU 'f': the FMU asks to end the simulation, at 0.25 s: 100 % as it was told" in told
    assert Recording.open(tmp_path / "run").time.tolist() == pytest.approx([0.0, 0.1, 0.2, 0.25])


def test_a_value_that_is_not_finite_is_allowed_by_name(tmp_path):
    text = events(tmp_path, has_events=False).replace('"events', '"../events')
    folder = tmp_path / "refused"
    folder.mkdir()
    told = run(folder, text.replace("f.rough", "f.rouhg"), code=2)
    assert re.search("not_finite: 'f.rouhg': .* no output of this name; .*you mean 'rough'", told)
    told = run(folder, text.replace('"f.rough"', ""), code=1)
    assert "at t = 0.000 s, in FMU 'f', variable rough: value nan is not finite" in told
    judged = '[[success.signal]]\nsignal = "f.rough"\nreduce = "max"\nbelow = 2\n'
    told = run(tmp_path, text.replace("../", "") + judged, code=3)
    assert "is not finite" in told
    recording = Recording.open(tmp_path / "run")
    assert np.isnan(recording["f.rough"]).tolist() == [True, True, *[False] * 9]


@pytest.mark.parametrize("way", [*WAYS, ("--coupling", "jacobi")])
def test_a_row_holds_the_values_of_its_instant_also_of_an_fmu_that_feeds_another(tmp_path, way):
    """The output of the first one is the time plus its input, which is 0."""
    for name in ("a", "b"):
        toy_fmu(tmp_path / f"{name}.fmu", 2)
    alone = '[fmus]\na = "a.fmu"\n'
    run(tmp_path, alone, *way)
    wanted = Recording.open(tmp_path / "run")
    (tmp_path / "run").rename(tmp_path / "alone")
    run(tmp_path, f'{alone}b = "b.fmu"\n[connect]\n"b.u[1,1]" = "a.y[2,1]"\n', *way)
    found = Recording.open(tmp_path / "run")
    assert np.ptp(wanted["a.y[2,1]"]) > 0.0
    for name in (name for name in found.columns if name.startswith("a.y")):
        np.testing.assert_array_equal(found[name], wanted[name])


def test_an_output_is_left_out_by_name_unless_it_feeds_another(tmp_path):
    toy_fmu(tmp_path / "a.fmu", 2)
    fmus = '[fmus]\na = "a.fmu"\nb = "a.fmu"\n[connect]\n"b.u[1,1]" = "a.y[2,1]"\n'
    run(tmp_path, f'left_out = ["a.y[1,2]"]\n{fmus}')
    columns = Recording.open(tmp_path / "run").columns
    assert "a.y[1,2]" not in columns
    assert {"a.y[2,1]", "b.y[1,2]"} <= {*columns}
    told = run(tmp_path, f'left_out = ["a.y"]\n{fmus}', code=2)
    assert "left_out: a.y[2,1]: feeds b.u[1,1]; must be an output that feeds nothing" in told


def test_an_fmu_that_refuses_the_event_mode_that_it_declares_is_run_without(tmp_path):
    source = SOURCE.read_text(encoding="utf-8").replace(
        "    model *m = calloc(1, sizeof *m);",
        "    if (events) return NULL;\n    model *m = calloc(1, sizeof *m);",
    )
    (tmp_path / "refusing.c").write_text(source)
    text = events(tmp_path)
    events_fmu(tmp_path / "events.fmu", has_events=True, source=tmp_path / "refusing.c")
    told = run(tmp_path, text)
    assert "Warning: f: it refuses the event mode that it declares, and is run without" in told
    assert Recording.open(tmp_path / "run")["f.updates"].tolist() == [0] * (TICKS + 1)
