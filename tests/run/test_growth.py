"""Memory beside a run's length: a long run is judged and compared with few of its columns in it."""

import gc
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from panda_cosim import Recording, compare, load_scenario
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.result.judging.contacts import SIGNAL as UNWANTED
from panda_cosim.result.judging.summary import Summary
from panda_cosim.result.recording import Column, Recorder, storage
from panda_cosim.run.summary import summarize
from panda_cosim.study.compare.against_reference import compare_with_reference
from panda_cosim.study.compare.reference import Reference
from panda_cosim.study.sweep.store import Store
from panda_cosim.task.tolerances import Tolerances

STEP = 0.001  # s
SHORT, LONG = 2, 4  # blocks of rows
BLOCK_ROWS = 1024  # a sixteenth, which is as many times quicker
MOST = 9.0  # columns that are whole in memory; about 100 are judged and compared
SCENARIO = load_scenario("pick_and_place")
VERDICT = Summary()
COLUMNS = [
    Column("time", "s"),
    *(
        Column(f"{instance}.{scalar.name}", scalar.unit)
        for instance, interface in INTERFACES.items()
        for scalar in interface.scalars()
        if scalar.variable.causality == "output" or scalar.variable.name.endswith("_cmd")
    ),
]


@pytest.fixture(scope="module", autouse=True)
def blocks():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(storage, "BLOCK_ROWS", BLOCK_ROWS)
        yield


def record(folder: Path, blocks: int, shift: float) -> Path:
    """Record waves in stairs of 0.1 s; the fingers press on the block for half of the time."""
    with Recorder(folder, COLUMNS, {"step_size": STEP}) as recorder:
        for block in range(blocks):
            time = STEP * np.arange(block * BLOCK_ROWS, (block + 1) * BLOCK_ROWS)
            rows = np.sin(time[:, None] // 0.1 + shift * np.arange(len(COLUMNS)))
            rows[:, 0] = time
            rows[:, [column.name for column in COLUMNS].index(UNWANTED)] = 0.0
            recorder.append(rows)
        recorder.close(complete=True)
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two runs of each length."""
    place = tmp_path_factory.mktemp("runs")
    return {
        blocks: [record(place / f"{blocks}-{shift}", blocks, shift) for shift in (0.1, 0.2)]
        for blocks in (SHORT, LONG)
    }


def judge(first: Path, _: Path) -> None:
    assert summarize(Recording.open(first), SCENARIO).limits["reference_jerk_share"]


def compare_runs(first: Path, second: Path) -> None:
    assert len(compare(first, second).signals) > 100


def regress(first: Path, second: Path) -> None:
    reference = Reference.of(Recording.open(first), VERDICT, Tolerances())
    assert compare_with_reference(
        Recording.open(second), VERDICT, reference, Tolerances(), exact=True
    ).problems


def peak(function: Callable[[], object]) -> int:
    """Return how much memory a call takes [bytes], beside Arrow's."""
    gc.collect()
    tracemalloc.start()
    function()
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most


@pytest.mark.parametrize(
    "use", [judge, *(pytest.param(use, marks=pytest.mark.long) for use in (compare_runs, regress))]
)
def test_few_columns_of_a_long_run_are_in_memory(runs, use):
    use(*runs[SHORT])  # imports
    grown = peak(lambda: use(*runs[LONG])) - peak(lambda: use(*runs[SHORT]))
    assert grown / (8 * (LONG - SHORT) * BLOCK_ROWS) <= MOST


def test_a_sweep_that_goes_on_remembers_its_rows_in_a_few_bytes_each(tmp_path):
    store, rows = Store(tmp_path), 100_000
    store.results.mkdir()
    store.add([{"index": index} for index in range(rows)], pa.schema([("index", pa.int64())]))
    assert peak(lambda: np.testing.assert_array_equal(store.done()[-1], rows - 1)) < 20 * rows
