"""Small recordings with references, for tests of comparison and report."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from panda_cosim.result.judging.summary import Summary
from panda_cosim.result.recording import Column, Recorder, Recording
from panda_cosim.task.rotations import Array

STEP = 0.001  # s
ROWS = 401
UNITS = {"time": "s", "plant.qpos[1]": "rad", "plant.contact_force": "N", "plant.jac[1,1]": "m",
         "controller.dq[1]": "rad", "controller.dq[2]": "rad"}  # fmt: skip
METADATA: dict[str, Any] = {
    "scenario": "small", "step_size": STEP, "versions": {"numpy": "1"}, "platform": "x",
    "fmus": {"plant": {"model": "PandaPlant", "guid": "{1}"}},
    "parameters": {"plant": {"block_mass": 0.18}},
}  # fmt: skip
CONTENT: dict[str, Any] = {  # of a summary.json
    "success": True,
    "criteria": [{"name": "tracking_rms", "value": 0.1, "bound": 0.2, "unit": "m", "ok": True}],
    "tracking": {"rms_mm": 100.0, "max_mm": 150.0},
    "limits": {"torque_share": [0.1, 0.2]},
    "timing": {"simulated_s": 0.4, "wall_s": 1.0},
}
MISSED = [{**CONTENT["criteria"][0], "value": 0.3, "ok": False}]
MISSED_CONTENT: dict[str, Any] = {**CONTENT, "success": False, "criteria": MISSED}
SUMMARY, NO_SUCCESS = map(Summary.read, (CONTENT, MISSED_CONTENT))


def columns(rows: int = ROWS) -> dict[str, Array]:
    """Return smooth signals, one of them with a step."""
    time = STEP * np.arange(rows)
    return {
        "time": time,
        "plant.qpos[1]": np.sin(3 * time),
        "plant.contact_force": np.where(time > 0.2, 30.0, 0.0),
        "plant.jac[1,1]": np.cos(3 * time),
        "controller.dq[1]": 1e-5 * np.sin(7 * time),
        "controller.dq[2]": 1e-5 * np.cos(7 * time),
    }


def record(
    folder: Path,
    values: Mapping[str, Array],
    units: Mapping[str, str] | None = None,
    metadata: Mapping[str, Any] | None = None,
    reason: str | None = None,
) -> Recording:
    """Write a recording and open it."""
    units = {**UNITS, **(units or {})}
    described = [Column(name, units.get(name, "1"), f"what {name} is") for name in values]
    recorder = Recorder(folder, described, {**METADATA, **(metadata or {})})
    recorder.append(np.column_stack(list(values.values())))
    recorder.close(complete=reason is None, reason=reason)
    return Recording.open(folder)
