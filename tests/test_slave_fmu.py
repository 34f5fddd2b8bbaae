"""A user's own PythonFMU slave as an FMU: it runs, and what cannot be packaged is told."""

from __future__ import annotations

import shutil
from pathlib import Path

import fmpy
import pytest
from fmpy.validation import validate_fmu
from fmu_support import in_process
from native_python import SLAVES
from panda_cosim.fmus.errors import CosimError, InputError
from panda_cosim.fmus.packaging.slave_fmu import slave_fmu
from panda_cosim.scenarios.cli.app import app
from typer.testing import CliRunner


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("decay.py", "my_helper.py"):
        shutil.copy(SLAVES / name, tmp_path)
    return tmp_path


def simulate(path: str) -> list[float]:
    """Run it for ten steps of 10 ms with u = 1; returns x."""
    result = fmpy.simulate_fmu(path, stop_time=0.1, step_size=0.01, output_interval=0.01)
    return [float(x) for x in result["x"]]


@pytest.mark.fmu
@pytest.mark.parametrize("fmi", ["2", "3"])
@pytest.mark.parametrize("name", ["decay.py", "decay.py:Decay"])
def test_a_slave_becomes_an_fmu_that_runs(folder: Path, fmi: str, name: str) -> None:
    out = folder / "out"
    words = ["build", "--slave", str(folder / name), "--fmi", fmi, "--out", str(out)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    fmu = str(out / "Decay.fmu")
    assert validate_fmu(fmu) == []
    x = [0.0]
    for _ in range(10):
        x.append(x[-1] + 2 * 1.0 * 0.01 * 3)
    assert in_process(simulate, fmu) == pytest.approx(x, rel=1e-12)


def test_a_changed_helper_is_another_fmu(folder: Path) -> None:
    before = slave_fmu(folder / "decay.py")
    (folder / "my_helper.py").write_text("def double(x):\n    return 3 * x\n")
    assert slave_fmu(folder / "decay.py").token != before.token


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("class A: pass", "must have one subclass of Fmi2Slave, or name one of: A"),
        ("def (", "not valid Python"),
        (None, "cannot be read: No such file"),
    ],
)
def test_a_file_without_a_slave_is_refused(tmp_path: Path, source: str | None, told: str) -> None:
    path = tmp_path / "mine.py"
    if source is not None:
        path.write_text(source)
    with pytest.raises(InputError, match=told):
        slave_fmu(path)


def test_a_slave_that_cannot_be_made_is_reported_with_its_reason(folder: Path) -> None:
    path = folder / "decay.py"
    path.write_text(path.read_text().replace("super().__init__(**kwargs)", "1 / 0"))
    with pytest.raises(CosimError, match="Decay cannot be instantiated: ZeroDivisionError"):
        slave_fmu(path)
