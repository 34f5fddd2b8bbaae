"""Sweeps whose runs hang, and whose law is gone."""

import shutil
from functools import partial
from pathlib import Path

import pytest

import dask_jobs
from fault_support import write_files
from fmu_support import in_process
from forked import command
from panda_cosim import InputError, Sweep, sweep
from panda_cosim.study.sweep import backend
from panda_cosim.study.sweep.again import promote_row, show_row
from sweep_support import rows_of, short_sweep

pytestmark = pytest.mark.usefixtures("forked_workers")
LAW = """\
import time as clock

class Hold:
    sleep = 0.0  # s
    def update(self, time, qpos):
        clock.sleep(self.sleep)
        return [*qpos[:7], 255.0]
"""
# A criterion that this law misses; it takes no command that tracking could be measured by.
SETTINGS = """\
duration = 0.1
fmus.controller = "hold.py:Hold"
success.signal = [{signal = "plant.qpos[1]", reduce = "max", below = -1.0}]
"""


def law_sweep(folder: Path, key: str, values: list[float]) -> Sweep:
    """Return a sweep of a scenario with a law of its own."""
    write_files(folder, SETTINGS)
    (folder / "hold.py").write_text(LAW)
    vary = {key: {"values": values}}
    return Sweep(scenario=(str(folder),), vary=vary, design="grid")  # type: ignore[arg-type]


def test_a_law_that_hangs_costs_its_row(tmp_path, monkeypatch):
    monkeypatch.setattr(backend, "GRACE", 1.0)  # s
    definition = law_sweep(tmp_path / "law", "controller.sleep", [0.0, 120.0])
    rows = rows_of(sweep(definition, tmp_path / "out", jobs=2, time_limit=3.0).folder)
    assert [row["status"] for row in rows] == ["missed", "timeout"]
    assert "its time limit of 3 s" in rows[1]["error"]


def test_a_row_with_a_law_becomes_a_scenario_that_regress_takes(tmp_path):
    definition = law_sweep(tmp_path / "law", "plant.block_mass", [0.2])
    out = sweep(definition, tmp_path / "out").folder
    shutil.rmtree(tmp_path / "law")  # the sweep has kept it
    kept = next(out.glob("scenarios/*/*/hold.py"))
    kept.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n{LAW}", encoding="utf-8")
    for act in (partial(show_row, out, 0), partial(promote_row, out, 0, tmp_path / "mine")):
        with pytest.raises(InputError, match=r"scenarios/0/law: has changed; must be as it was sw"):
            act()
    assert not (tmp_path / "ran").exists()
    kept.write_text(LAW, encoding="utf-8")
    files = promote_row(out, 0, tmp_path / "mine" / "held", known_limit=True)
    assert tmp_path / "mine" / "held" / "hold.py" in files
    command("regress", "--scenarios", tmp_path / "mine", "--exact", code=0)


pytest.importorskip("distributed")


@pytest.mark.long
def test_a_local_cluster_gives_the_table_of_the_pool_though_a_worker_is_killed(tmp_path):
    pytest.importorskip("cryptography")
    sweep(short_sweep(tmp_path, 8), tmp_path / "pool", jobs=1)
    out = tmp_path / "out"
    assert in_process(dask_jobs.local_cluster, str(tmp_path), str(out), 8, timeout=540) == 1
    assert rows_of(out) == rows_of(tmp_path / "pool")


def test_a_cluster_that_is_not_there_is_reported(tmp_path):
    places = str(tmp_path), str(tmp_path / "out")
    said, seconds = in_process(dask_jobs.nowhere, *places, timeout=540)
    assert said.startswith("--dask tcp://127.0.0.1:9")
    assert seconds < 60
