"""The master's step in C and in Python: the same bits, and the same errors."""

import hashlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cosim_jobs
from fmu_support import in_process, needs_compiler
from panda_cosim import Options, SimulationError, load_scenario, shipped_scenarios
from panda_cosim.fmus.interface.tables import Connection
from panda_cosim.fmus.master.kernel import load_stepper
from panda_cosim.fmus.master.step import Stepper
from panda_cosim.fmus.master.system import open_system
from panda_cosim.fmus.master.wiring import System
from panda_cosim.run.execution import Execution
from panda_cosim.run.prepare import prepare
from panda_cosim.run.stopping import StopRequest
from toy_fmu import INDICES, toy_fmu

pytestmark = needs_compiler
TICK = 0.001  # [s]
ELEMENTS = st.sampled_from(INDICES)
STEPPERS: dict[str, Callable[[], Any]] = {"in C": load_stepper, "in Python": lambda: None}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("toys")
    for fmi in (2, 3):
        toy_fmu(folder / f"{fmi}.fmu", fmi)
    return folder


@st.composite
def systems(draw: st.DrawFn) -> dict[str, Any]:
    """Some toys of either version, whose inputs are fed by outputs, from outside, or not."""
    versions = draw(st.lists(st.sampled_from([2, 3]), min_size=1, max_size=4))
    instances = [f"toy{i}" for i in range(len(versions))]
    ends = st.tuples(st.sampled_from(instances), ELEMENTS.map("u{}".format))
    fed = draw(st.lists(ends, unique=True, max_size=12))
    outside = [name for name in fed if draw(st.booleans())]
    sources = st.tuples(st.sampled_from(instances), ELEMENTS.map("y{}".format))
    conversions = st.sampled_from([(), (0.1, 0.0), (1.0, -0.3), (1 / 3, 0.7)])
    return {
        "versions": versions,
        "external": outside,
        "connections": [
            (draw(sources), name, *draw(conversions)) for name in fed if name not in outside
        ],
        "outputs": {name: [f"y{i}" for i in draw(st.permutations(INDICES))] for name in instances},
        "start": {name: {"k": draw(st.sampled_from([-1.5, 0.3, 0.9]))} for name in instances},
        "coupling": draw(st.sampled_from(["gauss-seidel", "jacobi"])),
        "steps": draw(st.lists(st.integers(1, 400), min_size=1, max_size=3)),
    }


def run(folder: str, plans: list[dict[str, Any]]) -> list[list[str]]:
    """The rows of each plan, in hexadecimal digits, and its error, by both steppers."""
    return [[_run(Path(folder), plan, STEPPERS[stepper]) for stepper in STEPPERS] for plan in plans]


def isolated(folder: str, plan: dict[str, Any]) -> str:
    """The same, with a process for each toy."""
    return _run(Path(folder), plan, STEPPERS["in C"], isolate=True)


def _run(
    folder: Path, plan: dict[str, Any], stepper: Callable[[], Any], isolate: bool = False
) -> str:
    instances = [f"toy{i}" for i in range(len(plan["versions"]))]
    rows: list[str] = []
    system = System(
        {n: folder / f"{v}.fmu" for n, v in zip(instances, plan["versions"], strict=True)},
        [Connection(tuple(s), tuple(t), *linear) for s, t, *linear in plan["connections"]],
        [tuple(name) for name in plan["external"]],
        plan["outputs"],
        not_finite=[tuple(name) for name in plan.get("not_finite", ())],
    )
    count = sum(plan["steps"])
    given_values = np.random.default_rng(1).normal(size=(count + 1, len(system.external)))
    given_values[plan.get("spoilt", count) :] *= np.nan
    with (
        patch("panda_cosim.fmus.master.kernel.load_stepper", stepper),
        patch("panda_cosim.fmus.master.kernel.changed", lambda _: ()),  # in C in any case
        open_system(system, plan["start"], stop=1.0 + count * TICK, coupling=plan["coupling"],
                    isolate=isolate) as opened,
    ):  # fmt: skip
        master = opened.master
        try:
            master.begin(lambda block: rows.append(block.tobytes().hex()))
            for steps in plan["steps"]:
                master.step(steps, given_values)
            master.end(given_values[:1])
            rows.append(f"{master.ended}, {master.steps} steps" if master.ended else "")
        except SimulationError as error:
            rows.append(f"{error}, {master.steps} steps")
    return "".join(rows)


@settings(max_examples=3, deadline=None)
@given(st.lists(systems(), min_size=10, max_size=10))
def test_both_give_the_same_bits(folder, plans):
    for in_c, in_python in in_process(run, str(folder), json.loads(json.dumps(plans))):
        assert in_c == in_python


def plan(version: int, **changes: Any) -> dict[str, Any]:
    """Two toys in a row, the first of a version."""
    return {
        "versions": [version, 2], "external": [["toy0", "u[1,1]"]],
        "connections": [[["toy0", "y[2,1]"], ["toy1", "u[1,2]"]]],
        "outputs": {"toy0": [f"y{i}" for i in INDICES], "toy1": ["y[1,2]"]},
        "start": {"toy0": {}}, "coupling": "gauss-seidel", "steps": [700],
    } | changes  # fmt: skip


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("act", ["warn", "discard", "error", "end", "early"])
def test_both_end_alike(folder, version, act):
    acting = plan(version, start={"toy0": {"act": act}})
    [[in_c, in_python]] = in_process(run, str(folder), [acting])
    assert in_c == in_python
    if version == 3 or act == "discard":
        assert in_c == in_process(isolated, str(folder), acting)
    ends = version == 3 and act == "end"  # with its third step, which the others finish
    assert ("at t = 0.002 s, in FMU 'toy0'" in in_c) == (act in {"discard", "error"} or ends)
    assert in_c.endswith(", 3 steps") == ends


def test_isolated_fmus_that_step_at_once_end_as_one_after_the_other_does(folder):
    """The second has been asked for its step when the first one fails."""
    acting = plan(2, start={"toy0": {"act": "error"}}, coupling="jacobi", versions=[2, 3, 2])
    [[in_c, in_python]] = in_process(run, str(folder), [acting])
    assert in_c == in_python == in_process(isolated, str(folder), acting)
    assert "at t = 0.002 s, in FMU 'toy0'" in in_c


def test_both_end_at_a_value_that_is_not_finite(folder):
    spoilt = plan(2, spoilt=301)
    [[in_c, in_python]] = in_process(run, str(folder), [spoilt])
    assert in_c == in_python
    assert (
        "at t = 0.301 s, in FMU 'toy0', variable u[1,1]: value nan is not finite, 301 steps" in in_c
    )


@pytest.mark.parametrize("allowed", [False, True])
def test_both_allow_the_same_values_that_are_not_finite(folder, allowed):
    """Outputs of the first toy overflow where its input is large; the other's follow."""
    free = [(toy, f"y{i}") for toy in ("toy0", "toy1") for i in INDICES] if allowed else []
    start = {"toy0": {"k": 1.5e308}}
    overflowing = plan(2, start=start, not_finite=free)
    [[in_c, in_python]] = in_process(run, str(folder), [overflowing])
    assert in_c == in_python
    assert ("inf is not finite" in in_c) != allowed
    assert (np.float64(np.inf).tobytes().hex() in in_c) == allowed


def shipped(names: list[str], stepper: Stepper) -> list[tuple[str, str, str]]:
    """Each scenario's name, what has stepped it, and a digest of all columns."""
    done = []
    for name in names:
        prepared = prepare(load_scenario(name), Options(master=stepper))
        in_c_in_any_case = patch("panda_cosim.fmus.master.kernel.changed", lambda _: ())
        with in_c_in_any_case, Execution(prepared, writes=False) as execution:
            execution.advance(execution.ticks, StopRequest())
            run = execution.close()
        digest = hashlib.sha256()
        for column in run.recording.columns:
            digest.update(np.ascontiguousarray(run.recording[column]).tobytes())
        done.append((name, run.summary.stepped_by, digest.hexdigest()))
    return done


@pytest.mark.parametrize(
    "share", [0, *(pytest.param(share, marks=pytest.mark.long) for share in range(1, 8))]
)
def test_both_give_the_same_bits_over_all_shipped_scenarios(share):
    names = [name for name in sorted(shipped_scenarios()) if not load_scenario(name).client]
    names = names[share::8]
    in_c, in_python = (in_process(shipped, names, stepper) for stepper in get_args(Stepper))
    assert [(name, digest) for name, _, digest in in_c] == [(n, d) for n, _, d in in_python]
    assert {by for _, by, _ in in_python} == {"fmpy"}
    assert "kernel" in {by for _, by, _ in in_c}


# The co-simulation over real FMUs is the plain loop of the same objects, bit for bit.


@pytest.mark.parametrize(
    ("scenario", "coupling", "steps"),
    [
        ("pick_and_place", "gauss-seidel", 2000),
        ("tutorial", "gauss-seidel", 1500),
        ("tutorial", "jacobi", 600),
    ],
)
def test_the_run_over_fmus_equals_the_plain_loop_bit_for_bit(scenario, coupling, steps):
    result = in_process(cosim_jobs.compare, scenario, coupling, steps)
    assert result["columns"], "every output and command is recorded once"
    assert result["differing"] == []
    assert result["repeats"], "and so does a second run"
    assert result["rows"] == steps + 1
    assert result["moved"] > 0.01, "and the hand has moved [m]"


@pytest.mark.skipif(sys.platform == "win32", reason="no resource module")
def test_memory_does_not_grow_with_the_length_of_a_run():
    short, longer = in_process(cosim_jobs.memory_of_runs, [2_000, 20_000])
    assert longer - short <= 5.0  # [MB]


@pytest.mark.long
def test_the_bench_compares_ways_that_do_the_same():
    """It raises where they end elsewhere; its numbers are no matter of a test's machine."""
    result = in_process(cosim_jobs.short_bench)
    numbers = result["json"]
    assert numbers["format"] == 4
    assert set(numbers["steps"]) == {"physics", "bare", "lists", "master", "fmpy"}
    assert set(numbers["ratios"]) == {"c/a", "c/a'", "d/a", "b/c", "cold run"}
    assert numbers["ratios"]["cold run"]["median"] == pytest.approx(2.5)
    for spread in (*numbers["steps"].values(), *numbers["ratios"].values()):
        assert 0.0 < spread["low"] <= spread["median"] <= spread["high"]
    for text in ("(a) mj_step", "(a') mj_step", "c/a", "c/a'", "at most 1.1", "numpy"):
        assert text in result["text"]
