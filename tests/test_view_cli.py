"""The command `panda-cosim view`."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from forked import command
from panda_cosim.result.recording import Recording
from panda_cosim.task.scenario import shipped_scenarios
from regress_support import columns, record
from view_support import run_scenario_outside


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return run_scenario_outside(tmp_path_factory.mktemp("runs") / "first")


def view(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Call the command in a process of its own."""
    return command("view", *arguments)


def shown(path: Path) -> str:
    """What a page says that it shows first."""
    text = path.read_text(encoding="utf-8")
    found = re.search(r'data-view="&quot;show&quot;">(.*?)</script>', text)
    assert found is not None
    return found[1]


def test_the_page_lies_in_the_run_or_where_it_is_wanted(run, tmp_path):
    done = view(run)
    assert done.returncode == 0, done.stderr
    assert str(run / "view.html") in done.stdout
    assert shown(run / "view.html") == '{"runs":["first"]}'
    assert view(Recording.open(run).path, "--out", tmp_path / "a" / "b.html").returncode == 0
    assert (tmp_path / "a" / "b.html").is_file()


def test_a_scenario_of_ones_own_has_its_reference(tmp_path):
    own = shutil.copytree(shipped_scenarios()["push"], tmp_path / "own")
    run = run_scenario_outside(tmp_path / "run", scenario=own)
    out = tmp_path / "view.html"
    for against in ("reference", own):
        done = view(run, "--against", against, "--out", out)
        assert done.returncode == 0, done.stderr
        assert shown(out) == '{"runs":["run","reference"]}'
    (own / "reference.parquet").unlink()
    done = view(run, "--against", "reference", "--out", out)
    assert done.returncode == 2
    assert f"regress {own} --update" in " ".join(done.stderr.split())


def test_what_cannot_be_shown_is_one_line_and_nothing_is_written(run, tmp_path):
    record(tmp_path / "small", columns())  # one joint, of a scenario that is not shipped
    out = tmp_path / "view.html"
    for arguments, words in (
        ((tmp_path / "nothing",), "no such file"),
        ((tmp_path / "small",), "1 columns of plant.qpos"),
        ((run, "--against", tmp_path / "small"), "1 columns of plant.qpos"),
        ((tmp_path / "small", "--against", "reference"), "'small' is not one of the shipped ones"),
        (
            (run, "--against", tmp_path / "reference.parquet"),
            "no such file; must be",
        ),
    ):
        done = view(*arguments, "--out", out)
        assert done.returncode == 2, arguments
        assert words in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
        assert not out.exists()
