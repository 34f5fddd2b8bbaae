"""The Reference-FMUs of the Modelica Association: shown, and run to the values that FMPy gets.

REFERENCE_FMUS names their folder, which holds fmi2 and fmi3.
"""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pyarrow.parquet as pq
import pytest

from fmu_support import REFERENCE_FMUS, in_process, needs_reference_fmus
from forked import QUIET, command
from panda_cosim import Recording, Scenario, Session

FMUS = ["BouncingBall", "Dahlquist", "Feedthrough", "Resource", "Stair", "VanDerPol"]
STEP, TICKS = 0.1, 10  # s
TIMES = STEP * np.arange(TICKS + 1)
WIDER = {  # input by the output that feeds it
    "Int16": "Int8", "Int32": "UInt16", "UInt32": "UInt8", "Int64": "UInt32",
    "Float32_continuous": "Int16", "Float32_discrete": "UInt16", "Float64_continuous": "Int32",
    "Float64_discrete": "Float32_discrete",
}  # fmt: skip

pytestmark = needs_reference_fmus


def write(folder: Path, fmus: Mapping[str, str], more: str = "") -> Path:
    lines = [f'{name} = "{REFERENCE_FMUS / fmu}.fmu"' for name, fmu in fmus.items()]
    head = f"duration = {STEP * TICKS}\nstep = {STEP}\n[fmus]\n"
    (folder / "scenario.toml").write_text(head + "\n".join(lines) + f"\n{more}")
    return folder


def run(folder: Path, *arguments: str) -> Recording:
    command("run", folder, "--out", folder / "run", *QUIET, *arguments, code=0)
    return Recording.open(folder / "run")


def in_fmpy(fmu: str, step: float = STEP, **more: Any) -> Any:
    kind = {"fmi_type": "CoSimulation", "output_interval": step}
    return fmpy.simulate_fmu(REFERENCE_FMUS / f"{fmu}.fmu", stop_time=STEP * TICKS, **kind, **more)


def assert_equal(recording: Recording, name: str, wanted: Any) -> None:
    """All columns that FMPy records are recorded, with the same values."""
    for column in wanted.dtype.names[1:]:
        np.testing.assert_array_equal(recording[f"{name}.{column}"], wanted[column], column)


@pytest.mark.parametrize("name", FMUS)
@pytest.mark.parametrize("fmi", ["fmi2", "fmi3"])
def test_reference_fmus_run_as_in_fmpy(tmp_path, fmi, name):
    assert command("info", REFERENCE_FMUS / fmi / f"{name}.fmu").returncode == 0
    recording = run(write(tmp_path, {"it": f"{fmi}/{name}"}))
    assert_equal(recording, "it", in_fmpy(f"{fmi}/{name}"))
    assert len(recording.columns) > 1


def test_state_space_takes_matrices_as_in_fmpy(tmp_path):
    values = {"A": [-1.0, 0.5, 0.0, 0.25, -2.0, 0.0, 0.0, 0.1, -3.0], "D": [0.1] * 9,
              "x0": [3.0, 4.0, 5.0], "u": [1.0, -1.0, 0.5]}  # fmt: skip
    parameters = "\n".join(f"{n} = {v}" for n, v in values.items() if n != "u")
    text = f'[parameters.it]\n{parameters}\n[inputs]\n"it.u" = {values["u"]}\n'
    recording = run(write(tmp_path, {"it": "fmi3/StateSpace"}, text))
    assert_equal(recording, "it", in_fmpy("fmi3/StateSpace", start_values=values))


# Steps and couplings.


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
def test_an_fmu_steps_in_multiples_of_the_system_s_step(tmp_path, isolate):
    recording = run(write(tmp_path, {"it": "fmi3/VanDerPol"}, "[steps]\nit = 5\n"), *isolate)
    wanted = in_fmpy("fmi3/VanDerPol", step=5 * STEP)
    for row in range(TICKS + 1):  # its outputs are held between its steps
        assert recording["it.x0"][row] == wanted["x0"][row // 5]


@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_slow_and_fast_fmus_are_coupled(tmp_path, coupling):
    """A acts within its tick with Gauss-Seidel, as it feeds b; b sees what holds at its begin."""
    ends = '[connect]\n"b.Float64_continuous_input" = "a.Float64_continuous_output"\n'
    table = '[inputs]\nfile = "inputs.csv"\n'
    steps = "[steps]\na = 2\nb = 4\n"
    folder = write(tmp_path, dict.fromkeys("ab", "fmi3/Feedthrough"), ends + table + steps)
    write_csv(tmp_path / "inputs.csv", "a", {"Float64_continuous_input": np.arange(11.0)})
    recording = run(folder, "--coupling", coupling)
    fed = recording["a.Float64_continuous_output"].tolist()
    assert fed == [0, 0, 0, 0, 2, 2, 4, 4, 6, 6, 8]  # each in the row of its instant
    seen = 4.0 if coupling == "gauss-seidel" else fed[4]
    wanted = [*[0.0] * 8, *[seen] * 3]
    assert recording["b.Float64_continuous_output"].tolist() == wanted


def test_an_algebraic_loop_is_named(tmp_path):
    ends = "".join(f'"{to}.Int8_input" = "{of}.Int8_output"\n' for to, of in ("ab", "ba"))
    folder = write(tmp_path, dict.fromkeys("ab", "fmi3/Feedthrough"), f"[connect]\n{ends}")
    said = " ".join(command("check", folder).stdout.split())
    for of, to in ("ab", "ba"):  # it may begin anywhere
        for part in (
            f"{of}.Int8_input -> {of}.Int8_output",
            f"{of}.Int8_output -> {to}.Int8_input",
        ):
            assert part in said.partition("algebraic loop ")[2]
    done = command("run", folder, "--out", tmp_path / "run", *QUIET)
    assert "algebraic loop" in done.stderr


def test_a_loop_without_a_solution_names_the_time_and_the_output(tmp_path):
    """The first of y = D u is y[1] = u[1] + 2, and u[1] = y[1]."""
    text = (f'coupling = "iterated"\n[fmus]\nit = "{REFERENCE_FMUS}/fmi3/StateSpace.fmu"\n'
            '[connect]\n"it.u[1]" = "it.y[1]"\n[parameters.it]\nD = [1, 1, 0, 0, 0, 0, 0, 0, 0]\n'
            "C = 0.0\n")  # fmt: skip
    (tmp_path / "scenario.toml").write_text(f"duration = 1.0\nstep = 1.0\n{text}")
    done = command("run", tmp_path, "--out", tmp_path / "run", *QUIET, code=1)
    assert "at t = 0.000 s, in FMU 'it', variable y[1]: coupling" in done.stderr


# Feedthrough, whose outputs are its inputs, in all types.


def inputs(fmi: str) -> dict[str, Sequence[Any]]:
    """A value of each input at each instant, in its type."""
    random, columns = np.random.default_rng(5), {}
    path = REFERENCE_FMUS / fmi / "Feedthrough.fmu"
    for variable in fmpy.read_model_description(path).modelVariables:
        if variable.causality == "input":
            columns[variable.name] = _values(random, variable.type)
    return columns


def _values(random: np.random.Generator, kind: str) -> Any:
    if kind in ("Real", "Float64", "Float32"):
        return random.normal(size=TICKS + 1).astype("f4" if kind == "Float32" else "f8")
    if kind == "Boolean":
        return random.integers(0, 2, TICKS + 1).astype(bool)
    if kind == "Enumeration":
        return random.integers(1, 3, TICKS + 1)
    if kind in ("String", "Binary"):
        texts = [random.bytes(int(size)) for size in random.integers(0, 9, TICKS + 1)]
        return texts if kind == "Binary" else [f'{text.hex()}, "ü"' for text in texts]
    limits = np.iinfo("int32" if kind == "Integer" else kind.lower())
    return random.integers(limits.min, limits.max, TICKS + 1, limits.dtype, endpoint=True)


def write_csv(path: Path, fmu: str, columns: Mapping[str, Sequence[Any]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", *(f"{fmu}.{name}" for name in columns)])
        for time, *row in zip(TIMES, *columns.values(), strict=True):
            texts = (each.hex() if isinstance(each, bytes) else each for each in row)
            writer.writerow([time, *(str(each).lower() if isinstance(each, np.bool_) else each
                                     for each in texts)])  # fmt: skip


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
@pytest.mark.parametrize("fmi", ["fmi2", "fmi3"])
def test_inputs_of_all_types_are_driven_from_a_csv_as_in_fmpy(tmp_path, fmi, isolate):
    columns = inputs(fmi)
    write(tmp_path, {"it": f"{fmi}/Feedthrough"}, '[inputs]\nfile = "inputs.csv"\n')
    write_csv(tmp_path / "inputs.csv", "it", columns)
    recording = run(tmp_path, *isolate)
    numbers = {n: v for n, v in columns.items() if isinstance(v, np.ndarray)}
    kinds = [("time", "f8"), *((name, values.dtype) for name, values in numbers.items())]
    rows = np.array(list(zip(TIMES, *numbers.values(), strict=True)), np.dtype(kinds))
    assert_equal(recording, "it", in_fmpy(f"{fmi}/Feedthrough", input=rows))
    for name, values in columns.items():
        assert recording[f"it.{name}"].tolist() == list(values)
        held = [values[0], *values[:-1]]  # an output is that of the step before
        assert recording[f"it.{name.replace('input', 'output')}"].tolist() == held


@pytest.mark.parametrize("isolate", [(), ("--isolate",)], ids=["plain", "isolate"])
@pytest.mark.parametrize("wider", [False, True], ids=["alike", "wider"])
def test_all_types_are_connected(tmp_path, wider, isolate):
    columns = inputs("fmi3")
    kinds = [name.removesuffix("_input") for name in columns]
    sources = WIDER if wider else {kind: kind for kind in kinds}
    ends = (f'"b.{to}_input" = "a.{of}_output"' for to, of in sources.items())
    text = "[connect]\n" + "\n".join(ends) + '\n[inputs]\nfile = "inputs.csv"\n'
    write(tmp_path, dict.fromkeys("ab", "fmi3/Feedthrough"), text)
    write_csv(tmp_path / "inputs.csv", "a", columns)
    recording = run(tmp_path, *isolate)
    for to, of in sources.items():
        given = list(columns[f"{of}_input"])
        assert recording[f"a.{of}_output"].tolist() == [given[0], *given[:-1]]
        assert recording[f"b.{to}_output"].tolist()[1:] == given[:-1]  # a acts within the tick


@pytest.mark.parametrize(
    ("to", "of", "asks"),
    [
        ("Float32_discrete", "Float64_discrete", True), ("Int8", "UInt8", True),
        ("Float64_discrete", "Int64", True), ("Int32", "Boolean", True),
        ("Boolean", "Int32", True), ("Enumeration", "Float32_discrete", True),
        ("String", "Int32", False), ("Binary", "String", False), ("Int64", "UInt64", True),
    ],
)  # fmt: skip
def test_a_type_that_loses_values_must_be_asked_for(tmp_path, to, of, asks):
    fmus = dict.fromkeys("ab", "fmi3/Feedthrough")
    write(tmp_path, fmus, f'[connect]\n"b.{to}_input" = "a.{of}_output"\n')
    done = command("check", tmp_path, code=2)
    message = f"type {of.partition('_')[0]} feeds type {to.partition('_')[0]}, which must be able"
    said = " ".join(done.stdout.split())
    assert message in said
    assert (f'"b.{to}_input" = "convert(a.{of}_output)"' in said) == asks


def test_types_are_converted_where_that_is_asked_for(tmp_path):
    text = """[connect]
"b.Int8_input" = "convert(a.Float64_discrete_output)"
"b.Int16_input" = "convert(a.Float64_continuous_output)"
"b.Int64_input" = "convert(a.Boolean_output)"
"b.Boolean_input" = "convert(a.Int32_output)"
[inputs]
"a.Float64_discrete_input" = -2.6
"a.Float64_continuous_input" = 3.5
"a.Boolean_input" = true
"a.Int32_input" = 7
"""
    folder = write(tmp_path, dict.fromkeys("ab", "fmi3/Feedthrough"), text)
    recording = run(folder)
    for name, value in {"Int8": -3.0, "Int16": 4.0, "Int64": 1, "Boolean": 1.0}.items():
        assert recording[f"b.{name}_output"][1:].tolist() == [value] * TICKS
    done = command("run", folder, "--out", tmp_path / "2", *QUIET,
                   "--set", "inputs.a.Float64_discrete_input=200", code=2)  # fmt: skip
    assert "in FMU 'b', variable Int8_input: value 200.0 is out of the range of Int8" in done.stderr


def test_inputs_are_varied(tmp_path):
    criterion = '[[success.signal]]\nsignal = "it.Int64_output"\nreduce = "final"\nabove = 2.5\n'
    values = '[inputs]\n"it.Int64_input" = 1\n'
    write(tmp_path, {"it": "fmi3/Feedthrough"}, values + criterion)
    done = command("sweep", tmp_path, "--vary", "inputs.it.Int64_input=2,3",
                   "--out", tmp_path / "sweep")  # fmt: skip
    assert done.returncode in (0, 3), done.stderr
    rows = pq.read_table(tmp_path / "sweep" / "results").to_pylist()
    succeeded = {row["inputs.it.Int64_input"]: row["status"] == "success" for row in rows}
    assert succeeded == {2.0: False, 3.0: True}


def test_columns_of_the_trajectory_s_table_drive_inputs(tmp_path):
    table = "it.Int8_input,time,it.Float64_continuous_input\n5,0,1\n7,0.5,2\n"
    (write(tmp_path, {"it": "fmi3/Feedthrough"}) / "trajectory.csv").write_text(table)
    recording = run(tmp_path)
    assert recording["it.Int8_input"].tolist() == [5] * 5 + [7] * 6
    wanted = np.minimum(1.0 + 2.0 * TIMES, 2.0)
    np.testing.assert_allclose(recording["it.Float64_continuous_input"], wanted, rtol=1e-15)
    command("run", tmp_path / "run" / "scenario", "--out", tmp_path / "again", *QUIET, code=0)
    again = Recording.open(tmp_path / "again")
    assert again["it.Int8_output"].tolist() == recording["it.Int8_output"].tolist()


@pytest.mark.parametrize(("csv_text", "message"), [
    ("time,it.Int8_input\n0,200\n", "it.Int8_input: row 1: value 200; must be a who"),
    ("time,it.Int8_input\n1,1\n0,2\n", "line 3: time: value '0'; must be a number, and not"),
    ("time,it.Int_input\n0,1\n", "it.Int_input: no such input of Feedthrough; did you mean"),
    ("time,that.Int8_input\n0,1\n", "[inputs] 'that.Int8_input': no FMU 'that'; valid: it"),
    ("t,it.Int8_input\n0,1\n", "line 1: columns: value 't,it.Int8_input'; must be time"),
    ("time,it.UInt8_input\n0,1\n", "it.UInt8_input: is in [inputs], too; must be one element"),
])  # fmt: skip
def test_a_bad_table_of_inputs_is_refused_in_one_line(tmp_path, csv_text, message):
    (tmp_path / "inputs.csv").write_text(csv_text)
    values = '[inputs]\nfile = "inputs.csv"\n"it.UInt8_input" = 1\n'
    done = command("run", write(tmp_path, {"it": "fmi3/Feedthrough"}, values), *QUIET, code=2)
    assert message in done.stderr


def set_inputs(folder: str) -> list[list[Any]]:
    """Set inputs of all kinds in a session; returns the rows of their outputs."""
    values = {"UInt64": 2**64 - 1, "Boolean": True, "String": "new", "Binary": "ff",
              "Enumeration": "Option 2", "Float32_continuous": 0.5}  # fmt: skip
    with Session(Scenario.read(folder), Path(folder) / "session") as session:
        session.step(2)
        for name, value in values.items():
            session.set(f"it.{name}_input", value)
        session.finish()
    recording = Recording.open(Path(folder) / "session")
    return [[str(x) for x in recording[f"it.{name}_output"][1:5]] for name in values]


def test_inputs_of_all_types_are_set_in_a_session_and_replayed(tmp_path):
    write(tmp_path, {"it": "fmi3/Feedthrough"})
    outputs = in_process(set_inputs, str(tmp_path))
    wanted = [("0", 2**64 - 1), ("0.0", 1.0), ("Set me!", "new"), (b"foo", b"\xff"), (1, 2),
              (0.0, 0.5)]  # fmt: skip
    assert outputs == [[str(old), str(old), str(new), str(new)] for old, new in wanted]
    command("replay", tmp_path / "session", "--out", tmp_path / "again", *QUIET, code=0)
