"""What machines do to the commands: limits, full disks, odd environments, other users."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import pytest
from bounded import limited
from fault_support import on_a_small_disk, write_scenario
from forked import command
from panda_cosim.fmus.atomic import KEPT, TEMPORARY, cache_folder, replacing
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.reading import is_noexec
from panda_cosim.fmus.sources.targets import build
from panda_cosim.scenarios.cli.app import app, report
from panda_cosim.scenarios.recording import Recording
from panda_cosim.scenarios.run.package import build_all
from panda_cosim.scenarios.scenario.scenario import load_scenario
from panda_cosim.scenarios.view.page import Inline
from typer.testing import CliRunner

COMMAND = [Path(sys.executable).parent / "panda-cosim"]
QUIET = ("--no-video", "--no-view", "--no-plot")


@pytest.mark.fmu
def test_a_poor_machine_is_enough_for_a_run(tmp_path: Path) -> None:
    """20 open files, 2 GB of addresses, no home, no folder for temporary files, no output."""
    scenario = write_scenario(tmp_path / "scenario", 0.02)
    poor = {"HOME": "/nonexistent", "TMPDIR": "/nonexistent", "COLUMNS": "0", "TERM": "dumb"}
    run = [*COMMAND, "run", scenario, "--out", tmp_path / "run", *QUIET]
    done = subprocess.run(
        [*limited(NOFILE=20, AS=2_000_000_000), "sh", "-c", 'exec "$@" >&-', "sh", *run],
        env=os.environ | {"PANDA_COSIM_CACHE": str(cache_folder())} | poor,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert Recording.open(tmp_path / "run").complete


def built(out: Path, largest: int) -> subprocess.CompletedProcess[str]:
    """Run `build` where no file may be larger than this [bytes], as on a full disk."""
    return subprocess.run(
        [*limited(FSIZE=largest), *COMMAND, "build", "--out", out],
        env=os.environ | {"PANDA_COSIM_CACHE": str(cache_folder())},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.mark.fmu
def test_a_full_disk_leaves_no_cut_fmu(tmp_path: Path) -> None:
    build_all(load_scenario("pick_and_place"), tmp_path / "before")  # the cache has them all
    done = built(tmp_path / "out", largest=20_000)
    assert done.returncode == 2
    assert "cannot be written" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list((tmp_path / "out").glob("*"))


@pytest.mark.fmu
def test_a_system_that_cannot_be_written_to_its_end_leaves_the_old_one(tmp_path: Path) -> None:
    """Nor does one whose `build` is killed meanwhile."""
    build_all(load_scenario("pick_and_place"), tmp_path)
    system = tmp_path / "Panda.ssp"
    limit = system.stat().st_size - 1
    before, old = sorted(tmp_path.iterdir()), system.read_bytes()
    done = built(tmp_path, largest=limit)
    assert done.returncode == 2
    assert f"{system}: cannot be written: File too large" in " ".join(done.stderr.split())
    assert system.read_bytes() == old
    assert sorted(tmp_path.iterdir()) == before


def test_a_page_that_cannot_be_saved_to_its_end_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text("the old one")
    _, most = before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, most))
    try:
        with pytest.raises(InputError, match=r"page\.html: cannot be written: File too large"):
            Inline("x" * 60_000, 640).save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_text() == "the old one"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.fmu
def test_a_full_disk_is_reported_when_a_live_session_ends(tmp_path: Path) -> None:
    build()
    scenario, disk = write_scenario(tmp_path / "scenario", 5.0), tmp_path / "disk"
    until_failed = '"$@" & until [ -e "$DISK/run/summary.json" ]; do sleep 0.1; done; '
    ended = on_a_small_disk(
        disk, "60k", until_failed + "kill -INT $!; wait $!", [*COMMAND, "live", scenario,
        "--out", disk / "run"],
    )  # fmt: skip
    assert ended.returncode == 1, ended.stderr
    (line,) = [each for each in ended.stderr.splitlines() if each.startswith("Error: ")]
    assert "recording failed after" in line
    assert f"the recording up to then is in {disk / 'run'}" in line


@pytest.mark.parametrize("number", ["EMFILE", "ENOSPC", "ENOMEM"])
def test_a_limit_is_reported_in_one_line(number: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = getattr(errno, number)
    assert report(OSError(code, os.strerror(code))) == 1
    said = capsys.readouterr().err
    assert os.strerror(code) in said
    assert "unexpected" not in said


@pytest.mark.parametrize("given", ["", "relative", "./x"])
def test_the_cache_is_never_in_the_working_directory(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, given: str
) -> None:
    monkeypatch.delenv("PANDA_COSIM_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", given)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "panda-cosim"


def test_a_user_without_a_home_is_told_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PANDA_COSIM_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000)  # whom no table knows
    with pytest.raises(InputError, match="set PANDA_COSIM_CACHE"):
        cache_folder()


def test_a_place_without_libraries_is_known() -> None:
    mounts = [line.split() for line in Path("/proc/mounts").read_text().splitlines()]
    noexec = [mount[1] for mount in mounts if "noexec" in mount[3].split(",")]
    assert not noexec or is_noexec(Path(noexec[-1]))
    assert not is_noexec(Path(sys.executable).parent)


def test_doctor_sees_a_cache_that_a_run_refuses(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path / "cache"))
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    done = CliRunner().invoke(app, ["doctor"])
    assert done.exit_code == 1
    assert "others may write to it" in " ".join(done.stdout.split())


@pytest.mark.parametrize("age", [2 * KEPT, -2 * KEPT], ids=["old", "of the future"])
def test_what_a_killed_process_left_goes_a_week_later(tmp_path: Path, age: float) -> None:
    file, folder, new = (tmp_path / f"{TEMPORARY}{n}" for n in ("0.txt", "1", "2.txt"))
    file.touch()
    folder.mkdir()
    for left in (file, folder):
        os.utime(left, (time.time() - age,) * 2)
    new.touch()
    (tmp_path / ".mine").mkdir()
    with replacing(tmp_path / "x.txt") as partial:
        partial.write_text("x")
    assert {path.name for path in tmp_path.iterdir()} == {"x.txt", new.name, ".mine"}


def test_columns_that_are_none_do_not_empty_the_help() -> None:
    shown = command("--help", COLUMNS="0")
    assert shown.returncode == 0
    assert "mjcf2fmu" in shown.stdout


def test_a_terminal_that_cannot_show_a_character_ends_no_command(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path / "größer", 0.02)
    done = subprocess.run(
        [*COMMAND, "check", scenario],
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert "gr??er" in done.stdout + done.stderr
    assert "unexpected" not in done.stderr
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_eight_first_starts_at_once(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path / "scenario", 0.02)
    env = os.environ | {"PANDA_COSIM_CACHE": str(tmp_path / "cache")}
    started = [
        subprocess.Popen([*COMMAND, "run", scenario, "--out", tmp_path / f"{n}", *QUIET], env=env)
        for n in range(8)
    ]
    assert [process.wait(300) for process in started] == [0] * 8
    kept = {(tmp_path / f"{n}" / "recording.parquet").read_bytes() for n in range(8)}
    assert len(kept) == 1
    assert not list((tmp_path / "cache").rglob(".panda-cosim-*"))
