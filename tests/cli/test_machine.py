"""What machines do to the commands: limits, full disks, odd environments, other users."""

import errno
import json
import os
import re
import shutil
import subprocess
import sys
import time
from importlib import import_module
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from zipfile import ZipFile

import pytest

from bounded import limited, ran
from fault_support import write_scenario
from forked import QUIET
from panda_cosim import InputError, Recording, load_scenario
from panda_cosim.cli.app import report
from panda_cosim.cli.commands import doctor
from panda_cosim.cli.commands.build import build_of
from panda_cosim.cli.commands.doctor import Finding, examine
from panda_cosim.fmus.atomic import KEPT, TEMPORARY, cache_folder, replacing, temporary_folder
from panda_cosim.fmus.extras import needing
from panda_cosim.fmus.sources.targets import Target

COMMAND = [Path(sys.executable).parent / "panda-cosim"]


def test_a_poor_machine_is_enough_for_a_run(tmp_path):
    """20 open files, 2 GB of addresses, no home, no folder for temporary files, no output."""
    scenario = write_scenario(tmp_path / "scenario", 0.02)
    poor = {"HOME": "/nonexistent", "TMPDIR": "/nonexistent", "COLUMNS": "0", "TERM": "dumb"}
    run = [*COMMAND, "run", scenario, "--out", tmp_path / "run", *QUIET]
    ran(
        [*limited(NOFILE=20, AS=2_000_000_000), "sh", "-c", 'exec "$@" >&-', "sh", *run],
        env=os.environ | {"PANDA_COSIM_CACHE": str(cache_folder())} | poor,
    )
    assert Recording.open(tmp_path / "run").complete


ENVIRONMENTS: dict[str, dict[str, str]] = {
    "plain": {},
    "another user": {"PYTHONHASHSEED": "12345", "TZ": "Pacific/Chatham", "HOME": "/nonexistent",
                     "PYTHONUNBUFFERED": "1", "PYTHONOPTIMIZE": "1"},
    "four threads, plain C locale": {"OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "4",
                                     "MKL_NUM_THREADS": "4", "LC_ALL": "C", "PYTHONUTF8": "0"},
}  # fmt: skip


def test_neither_the_environment_nor_runs_at_the_same_time_change_a_bit(tmp_path):
    """The hand moves and is pushed, by numbers that need all their digits."""
    push = "[[push]]\nstart = 0.1\nduration = 0.05\nforce = [7.7, -3.3, 1.1]\n"
    scenario = write_scenario(tmp_path / "short", 0.3, push)
    cache = {"PANDA_COSIM_CACHE": str(cache_folder())}
    started = [
        subprocess.Popen([*COMMAND, "run", scenario, "--out", tmp_path / name, *QUIET],
                         env=os.environ | cache | variables, stdout=subprocess.DEVNULL)
        for name, variables in ENVIRONMENTS.items()
    ]  # fmt: skip
    assert [process.wait(120) for process in started] == [0] * len(started)
    assert len({Recording.open(tmp_path / name).sha256() for name in ENVIRONMENTS}) == 1


@pytest.mark.parametrize("duration", [0.02, 3.0])
def test_a_disk_that_is_full_from_the_start_is_the_error(tmp_path, duration):
    scenario = write_scenario(tmp_path / "scenario", duration)
    done = ran(
        [*limited(FSIZE=8192), *COMMAND, "run", scenario, "--out", tmp_path / "run", *QUIET],
        env=os.environ | {"PANDA_COSIM_CACHE": str(cache_folder())},
        code=1,
    )
    words = "recording failed after 0 rows, which are kept: File too large"
    assert words in " ".join(done.stderr.split())
    assert not list((tmp_path / "run").glob("recording.*"))


def test_a_build_that_does_not_come_to_its_end_leaves_all_the_old_files(tmp_path):
    """Whole, with their reference experiments; nor does one that is killed meanwhile."""
    build_of(load_scenario("pick_and_place"), tmp_path, Target()).write(overwrite=False)
    system = tmp_path / "Panda.ssp"
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for path in tmp_path.glob("*.fmu"):
        assert "extra/org.fmi-standard.fmi-ls-ref/references.csv" in ZipFile(path).namelist()
    limit = len(before[system.name]) - 1
    done = ran(
        [*limited(FSIZE=limit), *COMMAND, "build", "--out", tmp_path],
        env=os.environ | {"PANDA_COSIM_CACHE": str(cache_folder())},
        code=2,
    )
    assert f"{system}: cannot be written: File too large" in " ".join(done.stderr.split())
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("number", ["EMFILE", "ENOSPC", "ENOMEM"])
def test_a_limit_is_reported_in_one_line(number, capsys):
    code = getattr(errno, number)
    assert report(OSError(code, os.strerror(code))) == 1
    said = capsys.readouterr().err
    assert os.strerror(code) in said
    assert "unexpected" not in said


@pytest.mark.parametrize("given", ["", "relative", "./x"])
def test_the_cache_is_never_in_the_working_directory(monkeypatch, tmp_path, given):
    monkeypatch.delenv("PANDA_COSIM_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", given)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "panda-cosim"


def test_a_user_without_a_home_is_told_what_to_set(monkeypatch):
    for name in ("PANDA_COSIM_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000)  # whom no table knows
    with pytest.raises(InputError, match="set PANDA_COSIM_CACHE"):
        cache_folder()


@pytest.mark.parametrize("age", [2 * KEPT, -2 * KEPT], ids=["old", "of the future"])
def test_what_a_killed_process_left_goes_a_week_later_and_what_is_in_use_stays(tmp_path, age):
    file, folder, new = (tmp_path / f"{TEMPORARY}{n}" for n in ("0.txt", "1", "2.txt"))
    file.touch()
    folder.mkdir()
    new.touch()
    (tmp_path / ".mine").mkdir()
    with temporary_folder(tmp_path) as used:
        for left in (file, folder, used):
            os.utime(left, (time.time() - age,) * 2)
        with replacing(tmp_path / "x.txt") as partial:
            partial.write_text("x")
        names = {path.name for path in tmp_path.iterdir()}
    assert names == {"x.txt", new.name, ".mine", used.name}
    assert not used.exists()


def test_a_terminal_that_cannot_show_a_character_ends_no_command(tmp_path):
    scenario = write_scenario(tmp_path / "größer", 0.02)
    done = ran([*COMMAND, "check", scenario], env=os.environ | {"PYTHONIOENCODING": "ascii"})
    assert "gr??er" in done.stdout + done.stderr
    assert "unexpected" not in done.stderr


# The doctor: it finds what is missing, and says how to get it.


def look(what: str) -> Finding:
    """Return the one finding about something."""
    (finding,) = [finding for finding in examine() if finding.what.startswith(what)]
    return finding


@pytest.fixture(autouse=True)
def _no_drawing(monkeypatch):
    """Trying OpenGL takes a second; the message has tests of its own."""
    monkeypatch.setenv("MUJOCO_GL", "disable")


def test_here_the_main_job_can_be_done_and_all_that_is_missing_has_a_remedy():
    findings = examine()
    assert not [finding for finding in findings if finding.state == "needed"]
    assert all(finding.remedy for finding in findings if finding.state != "ok")


@pytest.mark.parametrize(("package", "state"), [("mujoco", "needed"), ("pillow", "optional")])
def test_a_missing_package_is_named_with_the_command_that_gets_it(package, state, monkeypatch):
    def no_version(name: str) -> str:
        if name == package:
            raise PackageNotFoundError(name)
        return "0.0.1"

    monkeypatch.setattr(doctor, "version", no_version)
    finding = look(package)
    assert (finding.state, finding.detail) == (state, "not installed")
    assert finding.remedy.startswith(f"pip install '{package}>=")


def test_without_libraries_and_compiler_it_says_how_to_get_one(monkeypatch):
    monkeypatch.setattr(doctor, "is_prebuilt", lambda *_: False)
    assert look("libraries of the FMUs").state == "ok"
    monkeypatch.setattr(doctor, "compiler", lambda _: ())
    finding = look("libraries of the FMUs")
    assert finding.state == "needed"
    assert "panda-cosim[cross]" in finding.remedy


def test_a_cache_that_cannot_be_written_is_reported(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path / "file" / "cache"))
    finding = look("FMU cache")
    assert finding.state == "needed"
    assert "PANDA_COSIM_CACHE" in finding.remedy


WITHOUT_NUMPY = """
import sys
sys.modules["numpy"] = None
from panda_cosim.cli import main
main()
"""


def test_it_starts_and_reports_where_numpy_cannot_be_imported():
    done = ran([sys.executable, "-c", WITHOUT_NUMPY, "doctor", "--json"], code=1)
    needed = [f["what"] for f in json.loads(done.stdout)["findings"] if f["state"] == "needed"]
    assert "numpy" in needed
    assert "scenarios cannot be run here" in done.stderr


@pytest.mark.parametrize(
    ("package", "extra", "last"), [("ompl", "route", 13), ("toppra", "retime", 14)]
)
def test_a_package_without_a_release_for_this_python_names_one(package, extra, last, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    for minor, must in ((last, f"pip install 'panda-cosim[{extra}]'"), (last + 1, f"3.{last} or")):
        monkeypatch.setattr(sys, "version_info", (3, minor, 0))
        with pytest.raises(InputError, match=re.escape(must)), needing(package, extra, "this"):
            import_module(package)
        found = [finding.remedy for finding in examine() if finding.what.startswith(package)]
        assert found == ([f"Python 3.{last}"] if minor > last else [])


ROUNDING = """

import functools

noise, exact = np.random.default_rng(0), Impedance.update


@functools.wraps(exact)
def rounded(self, *values, **named):
    return exact(self, *values, **named) * (1 + 1e-15 * noise.standard_normal(8))


Impedance.update = rounded
"""


def test_a_reference_holds_however_a_numpy_law_is_rounded(tmp_path):
    """As another numpy or processor would round it: by some units in the last place."""
    folder = tmp_path / "scenarios" / "draw_circle"
    shutil.copytree(load_scenario("draw_circle").folder, folder)
    with (folder / "impedance.py").open("a") as law:
        law.write(ROUNDING)
    ran([sys.executable, "-m", "panda_cosim", "regress", "--scenarios", folder.parent])
