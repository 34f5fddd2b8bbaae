"""A Dask cluster gives the same table as this machine's pool, also where workers are lost."""

import pytest

from fmu_support import in_process
from panda_cosim.study.sweep.engine import sweep
from sweep_support import rows_of, short_sweep

distributed = pytest.importorskip("distributed")
import dask_jobs  # noqa: E402 - needs it

pytestmark = pytest.mark.usefixtures("forked_workers")
SAMPLES = 8


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """A folder with the sweep on this machine's pool."""
    folder = tmp_path_factory.mktemp("dask")
    sweep(short_sweep(folder, SAMPLES), folder / "pool", jobs=1)
    return folder


def test_a_local_cluster_gives_the_table_of_the_pool_though_a_worker_is_killed(base, tmp_path):
    pytest.importorskip("cryptography")
    out = tmp_path / "out"
    assert in_process(dask_jobs.local_cluster, str(base), str(out), SAMPLES, timeout=540) == 1
    assert rows_of(out) == rows_of(base / "pool")


def test_a_cluster_that_is_not_there_is_reported(base, tmp_path):
    said, seconds = in_process(dask_jobs.nowhere, str(base), str(tmp_path / "out"), timeout=540)
    assert said.startswith("--dask tcp://127.0.0.1:9")
    assert seconds < 60
