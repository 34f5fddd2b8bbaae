"""The doctor: it finds what is missing, and says how to get it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest
from panda_cosim.scenarios.cli.commands import doctor
from panda_cosim.scenarios.cli.commands.doctor import Finding, examine


def look(what: str) -> Finding:
    """Return the one finding about something."""
    (finding,) = [finding for finding in examine() if finding.what.startswith(what)]
    return finding


@pytest.fixture(autouse=True)
def _no_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trying OpenGL takes a second; the message has tests of its own."""
    monkeypatch.setenv("MUJOCO_GL", "disable")


def test_here_the_main_job_can_be_done_and_all_that_is_missing_has_a_remedy() -> None:
    findings = examine()
    assert not [finding for finding in findings if finding.state == "needed"]
    assert all(finding.remedy for finding in findings if finding.state != "ok")


@pytest.mark.parametrize(
    ("package", "state"),
    [("mujoco", "needed"), ("pillow", "optional"), ("control", "optional")],
)
def test_a_package_that_is_missing_or_too_old_is_named_with_the_command_that_gets_it(
    package: str, state: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_version(name: str) -> str:
        if name == package:
            raise PackageNotFoundError(name)
        return "0.0.1"

    monkeypatch.setattr(doctor, "version", no_version)
    finding = look(package)
    assert (finding.state, finding.detail) == (state, "not installed")
    assert finding.remedy.startswith(f"pip install '{package}>=")
    assert look("numpy").detail == "0.0.1 is too old"


def test_a_requirement_for_another_system_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    listed = ["ghost>=1; sys_platform == 'plan9'", "spirit>=2; extra == 'test'", "numpy>=1"]
    monkeypatch.setattr(doctor, "requires", lambda _: listed)
    findings = {finding.what for finding in examine()}
    assert "numpy" in findings
    assert not findings & {"ghost", "spirit"}


def test_without_libraries_and_compiler_it_says_how_to_get_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(doctor, "is_prebuilt", lambda *_: False)
    assert look("libraries of the FMUs").state == "ok"
    monkeypatch.setattr(doctor, "can_compile", lambda _: False)
    finding = look("libraries of the FMUs")
    assert finding.state == "needed"
    assert "panda-cosim[cross]" in finding.remedy


def test_a_cache_that_cannot_be_written_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("PANDA_COSIM_CACHE", str(tmp_path / "file" / "cache"))
    finding = look("FMU cache")
    assert finding.state == "needed"
    assert "PANDA_COSIM_CACHE" in finding.remedy


def test_what_only_pictures_or_tests_need_is_optional(monkeypatch: pytest.MonkeyPatch) -> None:
    assert look("OpenGL").state == "optional"
    assert "MUJOCO_GL=disable" in look("OpenGL").detail
    monkeypatch.setenv("PATH", "")
    assert look("C compiler").state == "optional"
    assert "apt-get install gcc" in look("C compiler").remedy


@pytest.mark.parametrize(("missing", "exit_code"), [("numpy", 1), ("nothing", 0)])
def test_it_starts_and_reports_where_numpy_cannot_be_imported(missing: str, exit_code: int) -> None:
    code = (
        f"import sys; sys.modules['{missing}'] = None\n"
        "from panda_cosim.scenarios.cli import main\n"
        "main()"
    )
    command = [sys.executable, "-c", code, "doctor"]
    environment = os.environ | {"COLUMNS": "200"}
    table, listed = (
        subprocess.run([*command, *options], capture_output=True, text=True, check=False,
                       timeout=300, env=environment)
        for options in ([], ["--json"])
    )  # fmt: skip
    findings = json.loads(listed.stdout)["findings"]
    needed = [f["what"] for f in findings if f["state"] == "needed"]
    assert ("numpy" in needed) == (missing == "numpy"), listed.stderr
    assert ("MISSING" in table.stdout) == (missing == "numpy")
    assert ("can be run and recorded." in table.stdout) == (missing != "numpy")
    assert ("scenarios cannot be run here" in table.stderr) == (missing == "numpy")
    assert (table.returncode, listed.returncode) == (exit_code, exit_code)
