"""FMUs in Python hosts of other versions."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from bounded import ran
from panda_cosim.fmus.build.platforms import this_platform
from panda_cosim.fmus.sources.targets import Kind, Target, build

HOST = Path(__file__).parents[1] / "bare_host.py"
REASONS = ("or newer is needed", "cannot be imported", "is too old")
KINDS: tuple[Kind, ...] = ("native", "python")


def run(python: str, fmu: Path) -> subprocess.CompletedProcess[str]:
    return ran([python, HOST, fmu, fmu.name, "50"], code=None)


@pytest.fixture(scope="module")
def others():
    """Pythons of this machine besides the one that runs the tests."""
    names = ["/usr/bin/python3", *(f"python3.{minor}" for minor in range(8, 16))]
    found = [path for path in map(shutil.which, names) if path]
    works = [p for p in found if not ran([p, "-c", ""], code=None).returncode]
    others = [path for path in works if Path(path).resolve() != Path(sys.executable).resolve()]
    return others or pytest.skip("there is no other Python")


@pytest.mark.skipif(this_platform() != "linux64", reason="the host opens Linux libraries")
@pytest.mark.parametrize("model", ["PandaPlant", "PandaController"])
def test_an_fmu_gives_the_same_bits_in_another_python_or_says_why_not(others, model, tmp_path):
    for kind in KINDS:
        (path,) = (p for p in build(target=Target(kind)).values() if p.stem == model)
        zipfile.ZipFile(path).extractall(tmp_path / kind / model)
    native, in_python = (tmp_path / kind / model for kind in KINDS)
    expected = run(sys.executable, native).stdout
    assert len(expected.split()) > 30
    for python in others:
        done = run(python, native)
        assert (done.returncode, done.stdout) == (0, expected), f"{python}: {done.stderr}"
        done = run(python, in_python)
        if done.returncode:
            assert done.returncode == 2, f"{python}: {done.stderr}"
            assert any(reason in done.stderr for reason in REASONS), f"{python}: {done.stderr}"
            assert len(done.stderr.splitlines()) == 1
        elif model == "PandaPlant":
            assert done.stdout == expected, python
