"""Sweeps whose runs hang or fail, whose disk is full, or that are sent elsewhere."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest
from fault_support import on_a_small_disk
from forked import command
from panda_cosim.fmus.sources.targets import build
from panda_cosim.scenarios.sweep.again import promote_row
from panda_cosim.scenarios.sweep.backend import Local
from panda_cosim.scenarios.sweep.definition import Sweep
from panda_cosim.scenarios.sweep.engine import sweep
from panda_cosim.scenarios.sweep.row import Job, Task
from panda_cosim.scenarios.sweep.scenarios import load_scenarios, pack
from panda_cosim.scenarios.sweep.store import Store
from sweep_support import FORCE, rows_of, short_scenario, short_sweep, write_sweep

pytestmark = pytest.mark.fmu
LAW = """\
import time as clock

class Hold:
    "Holds the arm where it is"
    sleep = 0.0  # s

    def update(self, time, qpos):
        clock.sleep(self.sleep)
        return [*qpos[:7], 255.0]
"""

# A criterion that this law misses; it takes no command that tracking could be measured by.
LAW_SECTIONS = """\
[fmus]
controller = "hold.py:Hold"
[[success.signal]]
signal = "plant.qpos[1]"
reduce = "max"
below = -1.0
"""


def law_scenario(folder: Path) -> Path:
    """Write the short scenario with a law of its own."""
    settings = short_scenario(folder) / "scenario.toml"
    before, _, pushes = settings.read_text(encoding="utf-8").partition("[success]")
    _, _, pushes = pushes.partition("[[push]]")
    text = f"{before}{LAW_SECTIONS}[[push]]{pushes}"
    settings.write_text(text, encoding="utf-8")
    (folder / "hold.py").write_text(LAW, encoding="utf-8")
    return folder


def test_a_law_that_hangs_costs_its_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panda_cosim.scenarios.sweep.backend.GRACE", 1.0)
    definition = Sweep(
        scenario=(str(law_scenario(tmp_path / "law")),),
        vary={"controller.sleep": {"values": [0.0, 120.0]}},  # type: ignore[dict-item]
        design="grid",
    )
    done = sweep(definition, tmp_path / "out", jobs=2, time_limit=3.0)
    rows = rows_of(done.folder)
    assert [row["status"] for row in rows] == ["missed", "timeout"]
    assert "killed" in rows[1]["error"]
    assert "its time limit of 3 s" in rows[1]["error"]


def test_a_scenario_is_sent_with_its_law(tmp_path: Path) -> None:
    folder = law_scenario(tmp_path / "law")
    definition = Sweep(
        scenario=(str(folder),),
        vary={FORCE: {"uniform": [0.0, 1.0]}},  # type: ignore[dict-item]
        samples=1,
    )
    scenarios = load_scenarios(definition)
    sent = tuple(map(pack, scenarios))
    shutil.rmtree(folder)
    with Local(Job(sent, {}), 1) as local:
        row = next(done for done in local.run([Task(0, 0, {FORCE: 0.5})]) if done).row
    assert row["status"] == "missed"
    assert str(folder) in row["command"]


def test_a_row_with_a_law_becomes_a_scenario_that_regress_takes(tmp_path: Path) -> None:
    vary = {FORCE: {"values": [0.5]}}
    law = str(law_scenario(tmp_path / "law"))
    out = sweep(Sweep(scenario=(law,), vary=vary, design="grid"), tmp_path / "out").folder  # type: ignore[arg-type]
    shutil.rmtree(law)  # the sweep has kept it
    files = promote_row(out, 0, tmp_path / "mine" / "held")
    assert tmp_path / "mine" / "held" / "hold.py" in files
    done = command("regress", "--scenarios", tmp_path / "mine", "--exact")
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_part_that_was_cut_short_is_run_again(tmp_path: Path) -> None:
    out = sweep(short_sweep(tmp_path, 4), tmp_path / "out", jobs=1).folder
    before = rows_of(out)
    part = Store(out).parts()[0]
    part.write_bytes(part.read_bytes()[:1000])
    sweep(short_sweep(tmp_path, 4), out, jobs=1)
    assert rows_of(out) == before


def test_a_full_disk_ends_in_order_and_the_sweep_goes_on(tmp_path: Path) -> None:
    build()
    disk, path = tmp_path / "disk", write_sweep(tmp_path, 16)
    script = (
        '"$@"; first=$?; mount -o remount,size=20m "$DISK"; "$@" || exit 78; '
        'cp -r "$DISK/out" "$KEEP"; exit $first'
    )
    program = str(Path(sys.executable).with_name("panda-cosim"))
    command = [program, "sweep", str(path), "--out", str(disk / "out"), "--jobs", "2"]
    ended = on_a_small_disk(disk, "100k", script, command, KEEP=str(tmp_path / "kept"))
    assert ended.returncode == 2, ended.stderr
    assert "cannot be written: " in ended.stderr
    assert "No space left on device" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert [row["index"] for row in rows_of(tmp_path / "kept")] == list(range(16))
