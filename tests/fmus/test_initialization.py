"""Initialization: values go along the connections, until they agree, before the first step."""

from collections.abc import Mapping
from pathlib import Path

import fmpy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_support import needs_compiler, pack
from panda_cosim import Options, load_scenario
from panda_cosim.fmus.interface.tables import Connection
from panda_cosim.fmus.master.fmu_file import read_fmu
from panda_cosim.fmus.master.order import stepping_order
from panda_cosim.fmus.master.system import open_system
from panda_cosim.fmus.master.wiring import System
from panda_cosim.run.prepare import prepare
from panda_cosim.study.check.diagnosis import rehearse
from toy_fmu import library

pytestmark = [pytest.mark.own_process, needs_compiler]
SOURCE = Path(__file__).parents[1] / "c_fmu" / "start.c"
NAMES = ("u", "y", "x0", "g", "c", "tolerance")
CAUSALITIES = {"u": "input", "g": "parameter", "c": "parameter"}
SETTLED = 1e-9  # relative error of a loop's values
ALL = "abcd"


def start_fmu(path: Path, fmi: int, experiment: str = "", g: float = 1.0) -> Path:
    """Write the FMU of c_fmu/start.c; its description may say another start value of g."""
    scalars, starts = [], {"u": 0.0, "g": g, "c": 0.0}
    for reference, name in enumerate(NAMES):
        start = f' start="{starts[name]}"' if name in starts else ""
        causality = CAUSALITIES.get(name, "output")
        kind = ' variability="tunable"' if causality == "parameter" else ""
        about = f'name="{name}" valueReference="{reference}" causality="{causality}"{kind}'
        scalars.append(
            f"<ScalarVariable {about}><Real{start}/></ScalarVariable>"
            if fmi == 2
            else f"<Float64 {about}{start}/>"
        )
    token = "guid" if fmi == 2 else "instantiationToken"
    platform = fmpy.platform if fmi == 2 else fmpy.platform_tuple
    text = (
        f'<fmiModelDescription fmiVersion="{fmi}.0" modelName="start" {token}="start">'
        f'<CoSimulation modelIdentifier="start"/>{experiment}'
        f"<ModelVariables>{''.join(scalars)}</ModelVariables><ModelStructure/>"
        "</fmiModelDescription>"
    )
    binary = f"binaries/{platform}/start.so"
    return pack(path, {"modelDescription.xml": text, binary: library(SOURCE)})


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmus")
    return {fmi: start_fmu(folder / f"start{fmi}.fmu", fmi) for fmi in (2, 3)}


def at_start(
    fmus: Mapping[str, Path],
    feeds: Mapping[str, str],
    values: Mapping[str, Mapping[str, float]],
    *,
    isolate: bool = False,
) -> tuple[dict[str, float], list[str]]:
    """What each FMU had as its input when it left initialization, and warnings."""
    connections = [Connection((source, "y"), (target, "u")) for target, source in feeds.items()]
    order = stepping_order({name: read_fmu(file) for name, file in fmus.items()}, connections)
    ordered = {name: fmus[name] for name in order}
    system = System(ordered, connections, outputs={name: ["y", "x0"] for name in order})
    said: list[str] = []
    with open_system(
        system, values, stop=1.0, isolate=isolate, on_message=lambda *texts: said.append(texts[2])
    ) as opened:
        opened.master.begin(lambda _rows: None)
        row = dict(zip(opened.master.columns, opened.master.latest()[1:], strict=True))
    return {name: row[name, "x0"] for name in fmus}, said


GAINS = st.floats(-3.0, 3.0).filter(lambda g: abs(g) > 1e-2)
SYSTEMS = st.dictionaries(st.sampled_from(ALL), st.sampled_from(ALL))


@settings(max_examples=25, deadline=None)
@given(
    feeds=SYSTEMS,
    gains=st.tuples(*[GAINS] * 4),
    biases=st.tuples(*[st.floats(-5.0, 5.0)] * 4),
    kinds=st.tuples(*[st.sampled_from([2, 3])] * 4),
)
def test_inputs_have_their_values_before_initialization_ends(files, feeds, gains, biases, kinds):
    """Chains are exact; loops, which may also grow from pass to pass, to a tolerance."""
    fmus = {name: files[fmi] for name, fmi in zip(ALL, kinds, strict=True)}
    values = {n: {"g": g, "c": c} for n, g, c in zip(ALL, gains, biases, strict=True)}
    matrix = np.zeros((4, 4))
    for target, source in feeds.items():
        matrix[ALL.index(target), ALL.index(source)] = 1.0
    if abs(np.linalg.det(np.eye(4) - matrix * gains)) < 1e-2:
        return  # a loop without a solution
    found, said = at_start(fmus, feeds, values)
    expected = np.linalg.solve(np.eye(4) - matrix * gains, matrix @ np.array(biases))
    assert [text for text in said if "settle" in text] == []
    scale = max(1.0, float(np.abs(expected).max()))
    for name, value in zip(ALL, expected, strict=True):
        assert found[name] == pytest.approx(value, rel=SETTLED, abs=SETTLED * scale)
        chain = [name]
        while chain[-1] in feeds and feeds[chain[-1]] not in chain:
            chain.append(feeds[chain[-1]])
        if chain[-1] not in feeds:  # no loop
            exact = 0.0
            for each in reversed(chain[1:]):
                exact = values[each]["g"] * exact + values[each]["c"]
            assert found[name] == exact


@pytest.mark.parametrize("isolate", [False, True])
def test_a_loop_that_does_not_settle_is_told_and_has_its_start_values(files, isolate):
    fmus, feeds = {"a": files[2], "b": files[3]}, {"a": "b", "b": "a"}
    values = {"a": {"c": 1.0}, "b": {"c": 2.0}}
    found, said = at_start(fmus, feeds, values, isolate=isolate)
    assert found == {"a": 2.0, "b": 1.0}
    assert [text for text in said if "settle" in text] == [
        "initialization: y does not settle between FMUs; start values are used"
    ]
    values["b"]["g"] = -0.5  # a.u = b.y = 2 - (a.u + 1) / 2
    found, said = at_start(fmus, feeds, values, isolate=isolate)
    assert found["a"] == pytest.approx(1.0, rel=SETTLED)
    assert not any("settle" in text for text in said)


def run(folder: Path, text: str, **options: bool) -> dict[str, float]:
    """The first row of a scenario of the FMU f.fmu."""
    (folder / "scenario.toml").write_text(f"duration = 0.01\n{text}")
    recording = rehearse(prepare(load_scenario(folder), Options(**options))).recording
    return {name: float(recording[name][0]) for name in recording.columns}


@pytest.mark.parametrize("fmi", [2, 3])
def test_inputs_over_time_have_their_first_values(tmp_path, fmi):
    start_fmu(tmp_path / "f.fmu", fmi)
    (tmp_path / "in.csv").write_text("time,f.u\n-1.0,1.0\n1.0,3.0\n")
    row = run(tmp_path, '[inputs]\nfile = "in.csv"\n[fmus]\nf = "f.fmu"\n')
    assert row["f.x0"] == 2.0


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_is_stated_is_sent_even_if_the_description_says_the_same(tmp_path, fmi):
    """The FMU's own value is 1, its description says 4."""
    start_fmu(tmp_path / "f.fmu", fmi, g=4.0)
    fmus = '[inputs]\n"f.u" = 1.0\n[fmus]\nf = "f.fmu"\n'
    assert run(tmp_path, fmus)["f.y"] == 1.0
    assert run(tmp_path, f"{fmus}[parameters.f]\ng = 4.0\n")["f.y"] == 4.0
    assert run(tmp_path, f"{fmus}[parameters.f]\ng = 3.0\n")["f.y"] == 3.0


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("isolate", [False, True])
def test_the_tolerance_is_the_description_s_or_the_scenario_s(tmp_path, fmi, isolate):
    fmus = '[fmus]\nf = "f.fmu"\n'
    start_fmu(tmp_path / "f.fmu", fmi)
    assert run(tmp_path, fmus, isolate=isolate)["f.tolerance"] == -1.0
    assert run(tmp_path, f"tolerance = 1e-3\n{fmus}", isolate=isolate)["f.tolerance"] == 1e-3
    start_fmu(tmp_path / "f.fmu", fmi, '<DefaultExperiment tolerance="1e-7"/>')
    assert run(tmp_path, fmus, isolate=isolate)["f.tolerance"] == 1e-7
    assert run(tmp_path, f"tolerance = 1e-3\n{fmus}", isolate=isolate)["f.tolerance"] == 1e-3
