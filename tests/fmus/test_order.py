"""The order of stepping: who feeds comes first, and no order of lines has an effect."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmu_support import compiler
from forked import command
from odd_fmu import odd_ssp
from panda_cosim import InputError, Recording, load_scenario
from panda_cosim.fmus.interface.tables import Connection
from panda_cosim.fmus.master.fmu_file import read_fmu
from panda_cosim.fmus.master.order import late, stepping_order
from panda_cosim.fmus.master.ssp_reader import system_from_ssp
from panda_cosim.run.prepare import prepare
from panda_cosim.study.check.diagnosis import rehearse
from toy_fmu import toy_fmu


@dataclass(frozen=True)
class Fmu:
    """What the order depends on; outputs are `state`, of no input, and `y`."""

    is_model: bool = False
    independent: tuple[str, ...] = ("state",)


def wires(*pairs: str) -> list[Connection]:
    """Connections, as `a>b`, or `a:state>b` from an output that depends on no input."""
    rows = []
    for pair in pairs:
        source, target = pair.split(">")
        instance, _, output = source.partition(":")
        rows.append(Connection((instance, output or "y"), (target, f"u_{instance}")))
    return rows


def order(*pairs: str, models: str = "") -> str:
    connections = wires(*pairs)
    names = {end[0] for c in connections for end in (c.source, c.target)}
    return "".join(stepping_order({n: Fmu(n in models) for n in names}, connections))


@pytest.mark.parametrize(
    ("pairs", "models", "expected"),
    [
        ("b>a", "", "ba"),
        ("c>b b>a", "", "cba"),
        ("a>b b>a", "", "ab"),  # a loop, by name
        ("c>b b>a a>c", "", "acb"),
        ("a>b b>a", "a", "ba"),  # cut behind the model
        ("a:state>b b>a", "", "ba"),  # cut behind the output that depends on no input
        ("a:state>b a>b b>a", "", "ab"),  # another one does
        ("a>b b>a b:state>c c>a", "a", "bca"),
        ("a>b", "a", "ba"),  # its rows hold the instant that they belong to
        ("a>s s>c c>a", "a", "sca"),  # sensors, controller, plant
        ("a>a b>a", "", "ba"),
    ],
)
def test_who_feeds_comes_first(pairs, models, expected):
    assert order(*pairs.split(), models=models) == expected


PAIRS = st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5), st.booleans()), max_size=12)


@given(pairs=PAIRS, models=st.sets(st.integers(0, 5)), data=st.data())
def test_no_order_has_an_effect_and_only_loops_and_models_are_late(pairs, models, data):
    lines = [f"n{a}{':state' * free}>n{b}" for a, b, free in pairs]
    fmus = {f"n{i}": Fmu(i in models) for i in range(6)}
    connections = wires(*lines)
    found = stepping_order(fmus, connections)
    shuffled = data.draw(st.permutations(connections))
    names = data.draw(st.permutations(list(fmus)))
    assert stepping_order({name: fmus[name] for name in names}, shuffled) == found
    feeds = {(c.source[0], c.target[0]) for c in connections}
    for source, target in feeds:
        is_late = found.index(source) >= found.index(target)
        assert not is_late or fmus[source].is_model or reaches(feeds, target, source)
        if fmus[source].is_model and not reaches(feeds, target, source):
            assert is_late
    held = {text.partition(".")[0] for text in late(found, connections, "gauss-seidel")}
    assert held == {s for s, t in feeds if found.index(s) >= found.index(t)}
    assert late(found, connections, "iterated") == []


def reaches(feeds: set[tuple[str, str]], start: str, end: str) -> bool:
    seen, todo = {start}, [start]
    while todo:
        name = todo.pop()
        todo += (new := {t for s, t in feeds if s == name} - seen)
        seen |= new
    return end in seen


# Systems that are run.

LINES = ['a = "a.fmu"', 'plant = "b.fmu"', 'c = "c.fmu"']
CONNECT = ['"a.u" = "plant.y"', '"plant.u" = "c.y"', '"c.u" = "a.y"']
INPUTS = ['"a.u[1,1]" = 1.0', '"c.u[2,1]" = -2.0']


def text(fmus: Sequence[str], connect: Sequence[str], more: str = "") -> str:
    elements = [line.replace(".u", ".u[1,2]").replace(".y", ".y[1,1]") for line in connect]
    parts = ["duration = 0.02", more, "[fmus]", *fmus, "[connect]", *elements]
    return "\n".join([*parts, "[inputs]", *INPUTS])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    if compiler() is None:
        pytest.skip("no C compiler")
    made = tmp_path_factory.mktemp("loop")
    for name in "abc":
        toy_fmu(made / f"{name}.fmu", 3 if name == "b" else 2)
    return made


def rows(folder: Path, content: str) -> tuple[tuple[str, ...], bytes]:
    (folder / "scenario.toml").write_text(content)
    recording = rehearse(prepare(load_scenario(folder))).recording
    values = np.column_stack([recording[name] for name in recording.columns])
    return recording.columns, values.tobytes()


@pytest.mark.own_process
@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_all_permutations_of_lines_give_the_same_bits(folder, coupling):
    more = f'coupling = "{coupling}"'
    expected = rows(folder, text(LINES, CONNECT, more))
    for fmus in permutations(LINES):
        assert rows(folder, text(fmus, CONNECT, more)) == expected
    INPUTS.reverse()
    for connect in permutations(CONNECT):
        assert rows(folder, text(LINES, connect, more)) == expected


@pytest.mark.own_process
def test_the_order_can_be_stated(folder):
    stated = 'order = ["c", "plant", "a"]'
    assert rows(folder, text(LINES, CONNECT, stated)) != rows(folder, text(LINES, CONNECT))
    (folder / "scenario.toml").write_text(text(LINES, CONNECT, stated))
    assembly = prepare(load_scenario(folder)).assembly
    assert [*assembly.interfaces] == ["c", "plant", "a"]
    assert assembly.late("gauss-seidel") == ["a.y[1,1] -> c.u[1,2]"]
    for wrong in ('["a", "c"]', '["a", "a", "plant", "c"]', '["a", "plant", "d"]'):
        (folder / "scenario.toml").write_text(text(LINES, CONNECT, f"order = {wrong}"))
        with pytest.raises(InputError, match="must name each FMU once: a, c, plant"):
            prepare(load_scenario(folder))


def test_it_is_shown(folder, tmp_path):
    (folder / "scenario.toml").write_text(text(LINES, CONNECT))
    said = "FMUs are stepped in the order a, c, plant; a step late: plant.y[1,1] -> a.u[1,2]"
    assert said in " ".join(command("check", folder).stdout.split())
    shown = command("info", folder).stdout
    assert "FMUs are stepped in the order a, c, plant" in shown
    assert shown.count("a step late") == 1
    drawing = command("info", folder, "--markdown").stdout
    assert '  3 -.->|"u[1,2]"| 1\n  1 -->|"u[1,2]"| 2\n' in drawing
    command("run", folder, "--no-video", "--out", tmp_path / "run")
    metadata = Recording.open(tmp_path / "run").metadata
    assert metadata["order"] == ["a", "c", "plant"]
    assert metadata["late"] == ["plant.y[1,1] -> a.u[1,2]"]


@pytest.mark.own_process
@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_all_permutations_of_elements_give_the_same_bits(folder, tmp_path, coupling):
    found, ends = set(), permutations(["ab", "bc", "ca"])
    for i, (names, pairs) in enumerate(zip(permutations("abc"), ends, strict=True)):
        made = tmp_path / str(i)
        made.mkdir()
        fmus = {name: folder / f"{name}.fmu" for name in names}
        outputs = dict.fromkeys(names, ["y[1,1]", "y[2,1]"][:: (-1) ** i])
        connections = [(a, "y[1,1]", b, "u[1,2]") for a, b in pairs]
        experiment = '<ssd:DefaultExperiment stopTime="0.02"/>'
        odd_ssp(made / "x.ssp", fmus, outputs, None, experiment, connections=connections)
        found.add(rows(made, f'system = "x.ssp"\nduration = 0.02\ncoupling = "{coupling}"\n'))
    assert len(found) == 1


def test_a_model_is_known_by_its_description_and_goes_last(tmp_path):
    """Whatever its name; written as an .ssp file, the system states its order."""
    scenario = tmp_path / "mine"
    scenario.mkdir()
    model = '<mujoco><worldbody><body><joint name="j" axis="0 1 0"/><geom size="0.1"/></body>'
    model += '</worldbody><actuator><motor name="m" joint="j"/></actuator></mujoco>'
    (scenario / "arm.xml").write_text(model)
    (scenario / "law.py").write_text(
        'class Law:\n    "Brakes"\n    def update(self, time, qvel):\n        return -qvel\n'
    )
    (scenario / "scenario.toml").write_text(
        'duration = 0.02\n[fmus]\na_model = "arm.xml"\nz_law = "law.py:Law"\n'
    )
    command("build", "--scenario", scenario, "--out", tmp_path / "fmus", code=0)
    prepared = prepare(load_scenario(scenario))
    assert [*prepared.assembly.interfaces] == ["z_law", "a_model"]
    written = system_from_ssp(tmp_path / "fmus" / "Panda.ssp")
    assert [*written.system.fmus] == ["z_law", "a_model"]
    made = tmp_path / "model.fmu"
    command("mjcf2fmu", scenario / "arm.xml", "--fmi", "3", "--out", made, code=0)
    assert read_fmu(made).is_model
