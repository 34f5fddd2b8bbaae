"""Same inputs, same bits: whatever the machine, the folder, the language and the time of day."""

from __future__ import annotations

import hashlib
import os
import subprocess
from pathlib import Path

import pytest

from fault_support import run_command, write_scenario
from panda_cosim.fmus.sources.targets import build
from panda_cosim.result.recording import Recording

pytestmark = pytest.mark.fmu


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    """A short run in which the hand moves, is pushed, and numbers need all their digits."""
    build()
    push = "[[push]]\nstart = 0.1\nduration = 0.05\nforce = [7.7, -3.3, 1.1]\n"
    return write_scenario(tmp_path_factory.mktemp("scenario") / "short", 0.3, push)


@pytest.fixture(scope="module")
def expected(scenario, tmp_path_factory):
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
    "another user": {
        "PYTHONHASHSEED": 12345,
        "TZ": "Pacific/Chatham",
        "HOME": "/nonexistent",
        "PYTHONUNBUFFERED": 1,
        "PYTHONOPTIMIZE": 1,
    },
    "four threads, plain C locale": {
        "OMP_NUM_THREADS": 4,
        "OPENBLAS_NUM_THREADS": 4,
        "MKL_NUM_THREADS": 4,
        "LC_ALL": "C",
        "PYTHONUTF8": 0,
    },
}


@pytest.mark.parametrize("kind", SETTINGS)
def test_the_environment_changes_no_bit(tmp_path, scenario, expected, kind):
    assert run(scenario, tmp_path / "run", **SETTINGS[kind]) == expected


def test_runs_at_the_same_time_change_no_bit(tmp_path, scenario, expected):
    processes = [
        subprocess.Popen(
            run_command(scenario, tmp_path / f"{i}", realtime=float(i)), stdout=subprocess.DEVNULL
        )
        for i in range(3)
    ]
    assert [p.wait(60) for p in processes] == [0, 0, 0]
    assert {digest(tmp_path / f"{i}") for i in range(3)} == {expected}
