"""The Reference-FMUs of the Modelica Association: shown, and run to the values that FMPy gets.

REFERENCE_FMUS names their folder, which holds fmi2 and fmi3.
"""

from __future__ import annotations

import os
from pathlib import Path

import fmpy
import numpy as np
import pytest
from forked import command
from panda_cosim.scenarios.recording import Recording

FOLDER = Path(os.environ.get("REFERENCE_FMUS", "/nonexistent"))
FMUS = ["BouncingBall", "Dahlquist", "Feedthrough", "Resource", "Stair", "VanDerPol"]
STEP, TICKS = 0.1, 10  # s

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(not (FOLDER / "fmi2").is_dir(), reason="needs REFERENCE_FMUS"),
]


@pytest.mark.parametrize("name", FMUS)
@pytest.mark.parametrize("fmi", ["fmi2", "fmi3"])
def test_reference_fmus_run_as_in_fmpy(tmp_path: Path, fmi: str, name: str) -> None:
    path = FOLDER / fmi / f"{name}.fmu"
    assert command("info", path).returncode == 0
    (tmp_path / "scenario.toml").write_text(
        f'duration = {STEP * TICKS}\nstep = {STEP}\n[fmus]\nit = "{path}"\n'
    )
    out = tmp_path / "run"
    done = command("run", tmp_path, "--out", out, "--no-video", "--no-view", "--no-plot")
    assert done.returncode == 0, done.stderr
    recording = Recording.open(out)
    wanted = fmpy.simulate_fmu(
        path, stop_time=STEP * TICKS, output_interval=STEP, fmi_type="CoSimulation"
    )
    for column in wanted.dtype.names[1:]:
        if f"it.{column}" in recording:
            np.testing.assert_array_equal(recording[f"it.{column}"], wanted[column])
    assert len(list(recording)) > 1
