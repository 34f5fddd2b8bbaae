"""The doctor: it finds what is missing, and says how to get it."""

from __future__ import annotations

import json
import sys
from importlib.metadata import PackageNotFoundError

import pytest

from bounded import ran
from panda_cosim.cli.commands import doctor
from panda_cosim.cli.commands.doctor import Finding, examine


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
def test_a_package_that_is_missing_is_named_with_the_command_that_gets_it(
    package, state, monkeypatch
):
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
    monkeypatch.setattr(doctor, "can_compile", lambda _: False)
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
    command = [sys.executable, "-c", WITHOUT_NUMPY, "doctor", "--json"]
    done = ran(command, code=None)
    needed = [f["what"] for f in json.loads(done.stdout)["findings"] if f["state"] == "needed"]
    assert "numpy" in needed
    assert "scenarios cannot be run here" in done.stderr
    assert done.returncode == 1
