"""Sweeps that run: their table, their resumption, and what becomes of rows that fail."""

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from scipy.stats import beta

from bounded import children, wait_until
from forked import QUIET, command
from panda_cosim import InputError, Recording, load_scenario, sweep
from panda_cosim.fmus.atomic import TEMPORARY, cache_folder
from panda_cosim.fmus.sources.targets import build
from panda_cosim.study.sweep.again import promote_row, show_row
from panda_cosim.study.sweep.backend import Local
from panda_cosim.study.sweep.packed import load_scenarios
from panda_cosim.study.sweep.report import write_report
from panda_cosim.study.sweep.row import Job, Task
from panda_cosim.study.sweep.store import Store
from sweep_support import FORCE, rows_of, short_sweep, write_sweep

pytestmark = pytest.mark.usefixtures("forked_workers")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A sweep that nothing disturbed."""
    folder = tmp_path_factory.mktemp("whole")
    sweep(short_sweep(folder, 40, keep="failures"), folder / "out", jobs=1)
    return folder


def start(folder: Path) -> subprocess.Popen[str]:
    program, out = Path(sys.executable).with_name("panda-cosim"), ("--out", folder / "out")
    arguments = [program, "sweep", folder / "sweep.toml", *out, "--jobs", "1"]
    return subprocess.Popen(arguments, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def test_a_table_has_a_row_for_each_sample(whole):
    """And for each failure a recording."""
    rows, store = rows_of(whole / "out"), Store(whole / "out")
    assert [row["index"] for row in rows] == list(range(40))
    assert {row["status"] for row in rows} == {"success", "missed"}
    for row in rows:
        assert row["margin"] == min(row["margin.tracking_max"], row["margin.orientation_rms"])
        assert (row["margin"] >= 0) == (row["status"] == "success")
        assert (row["missed"] is None) == (row["status"] == "success")
        # The hand moves more under a larger force, and the bound is 1 mm.
        assert row["summary.tracking.max_mm"] > 0.0
        assert row["processor"]
        folder = store.run_folder(row["index"])
        assert folder.exists() == (row["status"] != "success")
        if folder.exists():
            assert Recording.open(folder).sha256() == row["recording_sha256"]


def test_the_command_repeats_a_row_in_memory_bit_for_bit(whole, tmp_path):
    row = next(row for row in rows_of(whole / "out") if row["status"] == "success")
    program, *words = shlex.split(row["command"])
    assert program == "panda-cosim"
    command(*words, *QUIET, "--out", tmp_path, code=0)
    assert Recording.open(tmp_path).sha256() == row["recording_sha256"]


def test_a_sweep_is_judged_by_its_success_rate(whole, tmp_path):
    """By the share itself or, with a confidence, by what the rows prove at it."""
    good = sum(row["status"] == "success" for row in rows_of(whole / "out"))
    share, proved = good / 40, float(beta.ppf(0.05, good, 40 - good + 1))
    sweep_ = ("sweep", write_sweep(whole, 40), "--out", whole / "out")
    for required, more, code in (
        (share, (), 0),
        (share + 1e-6, (), 3),
        (proved - 1e-6, ("--confidence", 0.95), 0),
        (proved + 1e-6, ("--confidence", 0.95), 3),
    ):
        junit = tmp_path / f"{required}{code}.xml"
        done = command(*sweep_, "--min-success", required, *more, "--junit", junit, code=code)
        assert f"{'missed' if code else 'ok    '}  success rate" in done.stdout
        (suite,) = ET.parse(junit).getroot()
        assert (suite.get("tests"), suite.get("failures")) == ("1", "1" if code else "0")
    in_file = write_sweep(whole, 40, "min_success = 1.0\n")
    assert command("sweep", in_file, "--out", whole / "out").returncode == 3


def test_a_killed_sweep_and_a_killed_worker_give_the_same_table(whole, tmp_path):
    text = write_sweep(whole, 40).read_text(encoding="utf-8")
    text = text.replace('"short"', f'"{whole / "short"}"')
    (tmp_path / "sweep.toml").write_text(text, encoding="utf-8")
    results = tmp_path / "out" / "results"
    process = start(tmp_path)
    wait_until(lambda: any(results.glob("part-*")), process)
    process.kill()
    process.communicate(timeout=60)
    there = len(Store(tmp_path / "out").parts())
    assert len(Store(tmp_path / "out").done()) < 40
    process = start(tmp_path)
    wait_until(lambda: len(list(results.glob("part-*"))) > there, process)
    for worker in children(process.pid)[:1]:
        os.kill(worker, signal.SIGKILL)
    told, errors = process.communicate(timeout=300)
    assert rows_of(tmp_path / "out") == rows_of(whole / "out"), errors
    assert "(95 %, Clopper-Pearson)" in told


def test_ctrl_c_keeps_what_was_done_and_leaves_no_process_and_no_folder(tmp_path):
    write_sweep(tmp_path, 400)
    before = set(cache_folder().glob(f"{TEMPORARY}*"))
    process = start(tmp_path)
    wait_until(lambda: any((tmp_path / "out" / "results").glob("part-*")), process)
    workers = children(process.pid)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert 0 < len(Store(tmp_path / "out").done()) < 400
    time.sleep(0.5)
    assert not [worker for worker in workers if Path(f"/proc/{worker}").exists()]
    left = set(cache_folder().glob(f"{TEMPORARY}*")) - before  # or those of other tests, which end
    wait_until(lambda: not any(folder.exists() for folder in left))


def test_a_changed_definition_is_refused_and_named(whole):
    for keys, named in (
        ({"samples": 41}, r"samples 40 -> 41"),
        ({"seed": 4}, "seed"),
        ({"vary": {FORCE: {"uniform": [0.0, 101.0]}}}, r"vary\.push\[1\]\.force\[2\]"),
    ):
        definition = short_sweep(whole, **{"samples": 40, "keep": "failures", **keys})
        with pytest.raises(InputError, match=f"holds another sweep: .*{named}"):
            sweep(definition, whole / "out")


def test_a_search_finds_failures_sooner_than_drawing_and_goes_on(tmp_path):
    pytest.importorskip("optuna")
    vary = {FORCE: {"uniform": [0.0, 150.0]}}
    definition = short_sweep(tmp_path, 30, design="search", vary=vary)
    out = sweep(definition, tmp_path / "out", jobs=1).folder
    rows = rows_of(out)
    assert [row["index"] for row in rows] == list(range(30))
    assert sum(row["status"] == "missed" for row in rows[15:]) > 15 / 2
    # Half of the table is lost, and the search goes on from the other.
    for part in Store(out).parts()[1:]:
        part.unlink()
    before = Store(out).done().tolist()
    assert 0 < len(before) < 30
    assert sum(sweep(definition, out, jobs=1).counts.values()) == 30
    again = rows_of(out)
    assert [again[index] for index in before] == [rows[index] for index in before]


def test_a_folder_takes_one_sweep_at_a_time(tmp_path):
    definition, refused = short_sweep(tmp_path, 4), []

    def begin_another(*_: int) -> None:
        if not refused:
            with pytest.raises(InputError, match="another sweep is running there") as told:
                sweep(definition, tmp_path / "out", jobs=1)
            refused.append(told)

    done = sweep(definition, tmp_path / "out", jobs=1, progress=begin_another)
    assert refused
    assert sum(done.counts.values()) == 4
    assert sum(sweep(definition, tmp_path / "out", jobs=1).counts.values()) == 4


def test_a_search_is_by_a_criterion_that_the_runs_have(tmp_path):
    keys = {"design": "search", "vary": {FORCE: {"uniform": [0.0, 150.0]}}}
    there = "must be one of tracking_max, orientation_rms; did you mean 'tracking_max'"
    mistyped = short_sweep(tmp_path, 2, criterion="traking_max", **keys)
    with pytest.raises(InputError, match=f"criterion: value 'traking_max'; {there}"):
        sweep(mistyped, tmp_path / "out", jobs=1)
    assert not (tmp_path / "out").exists()
    pytest.importorskip("optuna")
    definition = short_sweep(tmp_path, 2, criterion="tracking_max", **keys)
    out = sweep(definition, tmp_path / "out", jobs=1).folder
    assert "margin.tracking_max" in write_report(out).read_text(encoding="utf-8")


def test_a_row_is_shown_against_the_unvaried_scenario(whole):
    missed = next(row for row in rows_of(whole / "out") if row["status"] == "missed")
    path = show_row(whole / "out", missed["index"])
    assert path.relative_to(whole / "out") == Path(f"shown/{missed['index']:07d}/view.html")
    text = path.read_text(encoding="utf-8")
    assert f"run:row {missed['index']}" in text
    assert "short unvaried" in text


def test_a_row_becomes_a_scenario_that_regress_takes(whole, tmp_path):
    missed = next(row for row in rows_of(whole / "out") if row["status"] == "missed")
    mine = tmp_path / "mine"
    promote = ("sweep", "promote", whole / "out")
    limit = command(*promote, missed["index"], mine / "limit", "--expect", "failure")
    assert "A known limit" in limit.stdout, limit.stderr
    made = load_scenario(mine / "limit")
    assert made.push[0].force[1] == missed[FORCE]
    assert made.expect == "failure"
    assert missed["missed"] in made.expect_reason
    good = next(row for row in rows_of(whole / "out") if row["status"] == "success")
    refused = command(*promote, good["index"], mine / "other", "--expect", "failure")
    assert "status success; must be missed" in refused.stderr
    assert "A regression test" in command(*promote, good["index"], mine / "good").stdout
    regress = ("regress", "--jobs", 1, "--scenarios", mine)
    done = command(*regress, "--exact", code=0)
    assert "2 of 2 scenarios match their references" in done.stdout
    assert "A red test" in command(*promote, missed["index"], mine / "red").stdout
    assert load_scenario(mine / "red").expect == "success"
    done = command(*regress, code=1)
    assert re.search(f"red +missed +{missed['missed']}", done.stdout)
    with pytest.raises(InputError, match=r"has no row 4711; must be one of its .* rows, from 0 to"):
        promote_row(whole / "out", 4711, tmp_path / "other")


def test_a_run_that_cannot_start_is_a_row_with_its_reason(tmp_path):
    tasks = [Task(0, 0, {"table.rows[2].time": 0.0}), Task(1, 0, {FORCE: 1.0})]
    fmus = {name: path.read_bytes() for name, path in build().items()}
    with Local(Job(load_scenarios(short_sweep(tmp_path)), fmus), 1) as local:
        rows = {done.task.index: done.row for done in local.run(tasks) if done is not None}
    assert (rows[0]["status"], rows[0]["margin"]) == ("failed", None)
    assert "time: value 0.0; must be at least" in rows[0]["error"]
    assert "unexpected" not in rows[0]["error"]
    assert rows[1]["status"] == "success"
