"""FMUs in Python hosts of other versions."""

import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from bounded import ran
from panda_cosim.fmus.build.platforms import this_platform
from panda_cosim.fmus.sources.targets import Kind, Target, build

HOST = Path(__file__).with_name("bare_host.py")
STEPS = 50
pytestmark = pytest.mark.skipif(
    this_platform() != "linux64", reason="the host opens Linux libraries"
)


@pytest.fixture(scope="module")
def others():
    """Pythons of this machine besides the one that runs the tests."""
    names = ["/usr/bin/python3", *(f"python3.{minor}" for minor in range(8, 16))]
    found = [path for path in map(shutil.which, names) if path]
    works = [
        p for p in found if not subprocess.run([p, "-c", ""], check=False, timeout=300).returncode
    ]
    others = [path for path in works if Path(path).resolve() != Path(sys.executable).resolve()]
    return others or pytest.skip("there is no other Python")


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    """Unpacked FMUs by kind and model."""
    folder, found = tmp_path_factory.mktemp("fmus"), {}
    kinds: Sequence[Kind] = ("native", "python")
    for kind in kinds:
        for path in build(target=Target(kind)).values():
            found[kind, path.stem] = folder / kind / path.stem
            zipfile.ZipFile(path).extractall(folder / kind / path.stem)
    return found


def run(python: str, fmu: Path) -> subprocess.CompletedProcess[str]:
    return ran([python, HOST, fmu, fmu.name, str(STEPS)], code=None)


@pytest.fixture(scope="module")
def expected(fmus):
    """Outputs of each model, in the Python that runs the tests."""
    return {model: run(sys.executable, fmus["native", model]).stdout for _, model in fmus}


@pytest.mark.parametrize("model", ["PandaPlant", "PandaController"])
def test_native_fmus_give_the_same_bits_in_every_python(fmus, expected, others, model):
    assert len(expected[model].split()) > 30
    for python in others:
        done = run(python, fmus["native", model])
        assert (done.returncode, done.stdout) == (0, expected[model]), f"{python}: {done.stderr}"


def test_an_fmu_in_python_runs_in_another_python_or_says_why_not(fmus, expected, others):
    for python in others:
        done = run(python, fmus["python", "PandaPlant"])
        if done.returncode:
            assert done.returncode == 2, f"{python}: {done.stderr}"
            reasons = ("or newer is needed", "cannot be imported", "is too old")
            assert any(reason in done.stderr for reason in reasons), f"{python}: {done.stderr}"
            assert len(done.stderr.splitlines()) == 1
        else:
            assert done.stdout == expected["PandaPlant"], python
