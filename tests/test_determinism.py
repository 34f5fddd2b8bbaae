"""Same inputs, same bits: whatever the machine, the folder, the language and the time of day."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from fault_support import run_command, write_scenario
from panda_cosim.fmus.sources.targets import build
from panda_cosim.scenarios.recording import Recording

pytestmark = pytest.mark.fmu

# Set for the C library as a host with a user interface does; Python alone leaves LC_NUMERIC as C.
WITH_LOCALE = """
import locale, sys
locale.setlocale(locale.LC_ALL, "")
assert locale.localeconv()["decimal_point"] == ",", locale.localeconv()
sys.argv = sys.argv[1:]
exec(sys.argv[0])
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run in which the hand moves, is pushed, and numbers need all their digits."""
    build()
    push = "[[push]]\nstart = 0.1\nduration = 0.05\nforce = [7.7, -3.3, 1.1]\n"
    return write_scenario(tmp_path_factory.mktemp("scenario") / "short", 0.3, push)


@pytest.fixture(scope="module")
def expected(scenario: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    return run(scenario, tmp_path_factory.mktemp("first") / "run")


def run(
    scenario: Path | str, out: Path, command: list[str] | None = None, **settings: object
) -> str:
    """Run in a process of its own; return the hash of all columns, bit for bit."""
    environment = os.environ | {k: str(v) for k, v in settings.items() if k.isupper()}
    subprocess.run(
        command or run_command(scenario, out),
        env=environment,
        cwd=str(settings.get("cwd", ".")),
        check=True,
        stdout=subprocess.DEVNULL,
        timeout=120,
    )
    return digest(out)


def digest(out: Path) -> str:
    recording = Recording.open(out)
    assert recording.complete
    content = hashlib.sha256(" ".join(recording.columns).encode())
    for block in recording.blocks():
        content.update(block.tobytes())
    return content.hexdigest()


SETTINGS: dict[str, dict[str, object]] = {
    "again": {},
    "another user": {
        "PYTHONHASHSEED": 12345,
        "TZ": "Pacific/Chatham",
        "HOME": "/nonexistent",
        "PYTHONUNBUFFERED": 1,
        "PYTHONOPTIMIZE": 1,
    },
    "four threads": {"OMP_NUM_THREADS": 4, "OPENBLAS_NUM_THREADS": 4, "MKL_NUM_THREADS": 4},
    "plain C locale": {"LC_ALL": "C", "PYTHONUTF8": 0},
}


@pytest.mark.parametrize("kind", SETTINGS)
def test_the_environment_changes_no_bit(
    tmp_path: Path, scenario: Path, expected: str, kind: str
) -> None:
    assert run(scenario, tmp_path / "run", **SETTINGS[kind]) == expected


def test_the_working_directory_changes_no_bit(
    tmp_path: Path, scenario: Path, expected: str
) -> None:
    """Nor do modules that happen to lie there, of the same names as this project's."""
    here = tmp_path / "with blank and \u00fc"
    here.mkdir()
    for name in ("plant", "controller", "fmus", "scenarios", "assets", "numpy", "mujoco"):
        (here / f"{name}.py").write_text("raise SystemExit('the wrong module')\n")
    for name in ("trajectory.csv", "scenario.toml", "panda.xml"):
        (here / name).write_text("not this one\n")
    assert run(scenario, tmp_path / "run", cwd=here) == expected


@pytest.fixture
def comma_locale(tmp_path: Path) -> dict[str, str]:
    """Settings for a locale with a decimal comma: the system's German, or one made here."""
    names = subprocess.run(
        ["locale", "-a"], capture_output=True, text=True, check=False, timeout=300
    ).stdout
    german = next((n for n in names.split() if n.lower().startswith("de_de.utf")), None)
    if german:
        return {"LC_ALL": german}
    tool = shutil.which("localedef")
    if tool is None:
        pytest.skip("needs a German locale, or localedef to make one")
    source = Path("/usr/share/i18n/locales/de_DE")
    locale = tmp_path / "locales" / "de_DE.UTF-8"
    locale.parent.mkdir()
    subprocess.run(
        [tool, "-c", "-i", str(source), "-f", "UTF-8", str(locale)],
        check=False,
        capture_output=True,
        timeout=300,
    )
    if not locale.exists():
        pytest.skip("localedef finds no source of the German locale")
    return {"LOCPATH": str(locale.parent), "LC_ALL": "de_DE.UTF-8"}


def test_a_decimal_comma_changes_no_bit(
    tmp_path: Path, scenario: Path, expected: str, comma_locale: dict[str, str]
) -> None:
    first, *options, code, given, out, how = run_command(scenario, tmp_path / "run")
    command = [first, *options, WITH_LOCALE, code, given, out, how]
    assert run(scenario, tmp_path / "run", command, **comma_locale) == expected


def test_runs_at_the_same_time_change_no_bit(tmp_path: Path, scenario: Path, expected: str) -> None:
    processes = [
        subprocess.Popen(
            run_command(scenario, tmp_path / f"{i}", realtime=float(i)), stdout=subprocess.DEVNULL
        )
        for i in range(3)
    ]
    assert [p.wait(60) for p in processes] == [0, 0, 0]
    assert {digest(tmp_path / f"{i}") for i in range(3)} == {expected}
