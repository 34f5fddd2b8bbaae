"""The doctor: it finds what is missing, and says how to get it."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest
from panda_cosim.scenarios.cli import machine
from panda_cosim.scenarios.cli.app import app
from panda_cosim.scenarios.cli.machine import Finding, examine
from typer.testing import CliRunner


def look(what: str) -> Finding:
    """Return the one finding about something."""
    (finding,) = [finding for finding in examine() if finding.what.startswith(what)]
    return finding


@pytest.fixture(autouse=True)
def _no_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trying OpenGL takes a second; the message has tests of its own."""
    monkeypatch.setenv("MUJOCO_GL", "disable")


def test_here_the_main_job_can_be_done() -> None:
    assert not [finding for finding in examine() if finding.state == "needed"]


def test_all_that_is_missing_has_a_remedy() -> None:
    assert all(finding.remedy for finding in examine() if finding.state != "ok")


@pytest.mark.parametrize(
    ("package", "state"),
    [("mujoco", "needed"), ("pillow", "optional"), ("control", "optional")],
)
def test_a_missing_package_is_named_with_the_command_that_gets_it(
    package: str, state: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = machine.version

    def version(name: str) -> str:
        if name == package:
            raise PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(machine, "version", version)
    finding = look(package)
    assert finding.state == state
    assert finding.remedy.startswith(f"pip install '{package}>=")


def test_a_package_that_is_too_old_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "version", lambda _: "0.9.99")
    assert look("mujoco").detail == "0.9.99 is too old"
    assert look("mujoco").state == "needed"


def test_a_requirement_for_another_system_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    listed = ["ghost>=1; sys_platform == 'plan9'", "spirit>=2; extra == 'test'", "numpy>=1"]
    monkeypatch.setattr(machine, "requires", lambda _: listed)
    told = {finding.what for finding in examine()}
    assert "numpy" in told
    assert not told & {"ghost", "spirit"}


def test_without_libraries_and_compiler_it_says_how_to_get_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(machine, "is_prebuilt", lambda *_: False)
    assert look("libraries of the FMUs").state == "ok"
    monkeypatch.setattr(machine, "can_compile", lambda _: False)
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


def test_missing_opengl_only_costs_the_pictures() -> None:
    finding = look("OpenGL")
    assert finding.state == "optional"
    assert "MUJOCO_GL=disable" in finding.detail


def test_missing_tools_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine.shutil, "which", lambda *_, **__: None)
    assert look("C compiler").state == "optional"
    assert "apt-get install gcc" in look("C compiler").remedy


def test_the_command_ends_with_0_if_the_main_job_can_be_done() -> None:
    result = CliRunner().invoke(app, ["doctor"])
    assert result.exit_code == 0
    assert "Scenarios can be run and recorded." in result.stdout


def test_the_command_ends_with_1_if_not(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [Finding("mujoco", "needed", "not installed", "pip install 'mujoco>=4'")]
    monkeypatch.setattr("panda_cosim.scenarios.cli.commands.doctor.examine", lambda: found)
    result = CliRunner().invoke(app, ["doctor"])
    assert result.exit_code == 1
    assert "MISSING" in result.stdout
    assert "cannot be run here: mujoco" in result.stderr


def test_it_starts_and_reports_where_numpy_cannot_be_imported() -> None:
    code = (
        "import sys; sys.modules['numpy'] = None\n"
        "from panda_cosim.scenarios.cli import main\n"
        "sys.argv = ['panda-cosim', 'doctor', '--json']; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=300
    )
    findings = json.loads(done.stdout)["findings"]
    assert any(f["what"] == "numpy" and f["state"] == "needed" for f in findings), done.stderr
    assert done.returncode == 1
    assert "scenarios cannot be run here" in done.stderr
