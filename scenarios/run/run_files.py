"""Content of a run's files: columns and metadata of the recording, and the summary."""

from __future__ import annotations

import json
import math
import platform
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from ...fmus.atomic import replacing
from ...fmus.master.system import OpenSystem
from ..recording import Column
from ..scenario.scenario import is_shipped
from ..system.assembly import Assembly
from .folders import SUMMARY_FILE
from .prepare import Prepared
from .summary import Summary

PACKAGES: Final = ("panda-cosim", "fmpy", "mujoco", "numpy", "pythonfmu")


def columns_of(assembly: Assembly) -> list[Column]:
    """Columns of the recording, with their units."""
    return [Column(name, unit, text) for name, (unit, text) in assembly.recorded().items()]


def metadata_of(prepared: Prepared, opened: OpenSystem) -> dict[str, Any]:
    """Metadata of the recording, as JSON holds it."""
    scenario, values, assembly = prepared.scenario, prepared.values, prepared.assembly
    ours: dict[str, Any] = {}
    if scenario.system:
        ours |= {"system": Path(scenario.system).name, "start_time": assembly.start_time}
    scene = values.get("plant", {}).get("scene")
    if isinstance(scene, str):  # from an .ssp file it is a number
        ours["scene"] = scene
    if not scenario.is_system:
        ours |= {
            "gains": scenario.gains,
            "interpolation": scenario.interpolation,
            "row_times": [row.time for row in scenario.table.rows],
            "row_names": [row.name for row in scenario.table.rows],
        }
    if scenario.folder is not None and not is_shipped(scenario):
        ours["scenario_folder"] = str(scenario.folder.resolve())  # where its reference is
    return {
        "scenario": scenario.name,
        "purpose": scenario.purpose,
        **ours,
        "coupling": scenario.coupling,
        "step_size": scenario.step,
        "duration": scenario.duration,
        "parameters": values,
        **provenance(opened),
    }


def provenance(opened: OpenSystem) -> dict[str, Any]:
    """FMUs, versions and platform of a recording, for its metadata."""
    return {
        "fmus": {
            name: {"guid": fmu.guid, "sha256": fmu.sha256, "model": fmu.description.modelName}
            for name, fmu in opened.fmus.items()
        },
        "versions": {
            "python": platform.python_version(),
            **{package: version(package) for package in PACKAGES},
        },
        "platform": f"{sys.platform} {platform.machine()}",
    }


def write_summary(folder: Path, summary: Summary) -> None:
    """Write summary.json."""
    text = json.dumps(json_values(summary.to_dict()), indent=2, allow_nan=False)
    with replacing(folder / SUMMARY_FILE) as path:
        path.write_text(text + "\n", encoding="utf-8")


def json_values(value: Any) -> Any:
    """Replace numbers that are not finite by null, as JSON cannot hold them."""
    if isinstance(value, dict):
        return {key: json_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
