"""What the tests of sweeps share: a short scenario and small sweeps of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from panda_cosim.scenarios.sweep.definition import Loaded, Sweep, load_scenarios
from panda_cosim.scenarios.sweep.row import Job
from panda_cosim.scenarios.sweep.store import Store

SETTINGS = """\
duration = 0.1
[success]
tracking_max = 0.001
orientation_rms = 1.0
[[push]]
start = 0.02
duration = 0.05
force = [0.0, 20.0, 0.0]
"""
TABLE = "time,frame,x,y,z,grip\n0.0,home,0.0,0.0,0.0,0.08\n0.1,home,0.0,0.0,0.005,0.08\n"
MASS, NAME = "plant.block_mass", "plant.name<b>"
HEAVY = 1.09  # [kg] from which rows fail
FORCE = "push[1].force[2]"  # above about 25 N, tracking_max is missed


def short_scenario(folder: Path) -> Path:
    """Write a scenario of 0.1 s whose hand is pushed."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scenario.toml").write_text(SETTINGS, encoding="utf-8")
    (folder / "trajectory.csv").write_text(TABLE, encoding="utf-8")
    return folder


def short_sweep(folder: Path, samples: int = 12, **keys: Any) -> Sweep:
    """Return a sweep of the short scenario, some of whose rows miss a criterion."""
    vary = {FORCE: {"uniform": [0.0, 100.0]}, "plant.block_mass": {"values": [0.1, 0.2]}}
    scenario = (str(short_scenario(folder / "short")),)
    return Sweep(**{"scenario": scenario, "vary": vary, "samples": samples, "seed": 3, **keys})


def write_sweep(folder: Path, samples: int, more: str = "") -> Path:
    """Write the same as a TOML file."""
    short_scenario(folder / "short")
    path = folder / "sweep.toml"
    path.write_text(
        f'scenario = "short"\nsamples = {samples}\nseed = 3\n{more}'
        f'[vary."{FORCE}"]\nuniform = [0.0, 100.0]\n'
        '[vary."plant.block_mass"]\nvalues = [0.1, 0.2]\n',
        encoding="utf-8",
    )
    return path


def job(sweep: Sweep, fmus: dict[str, bytes], **options: Any) -> Job:
    """Return what the rows of a sweep share."""
    return Job(load_scenarios(sweep), fmus, **options)


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """Return the table's rows without what differs from run to run."""
    table: pa.Table = Store(folder).table()
    return list(table.drop_columns(["wall_s"]).to_pylist())


__all__ = ["FORCE", "Loaded", "job", "rows_of", "short_scenario", "short_sweep", "write_sweep"]


def made_up(folder: Path, rows: int, parts: int = 2) -> Path:
    """Write a sweep's folder whose rows fail above a mass."""
    drawn = np.random.default_rng(1)
    columns = ["index", "margin", "margin.tracking_max", "status", "missed", "error", "command",
               "scenario"]  # fmt: skip
    definition = {"design": "random", "seed": 1, "samples": rows, "scenario": ["push"],
                  "criterion": "", "goal": "fail"}  # fmt: skip
    origin = {"definition": definition, "vary": {MASS: {}, NAME: {}}, "versions": {"mujoco": "4"},
              "scenarios": {}, "fmus": {}}  # fmt: skip
    keys = [MASS, NAME]
    Store(folder).write(
        {"origin": origin, "keys": keys, "columns": columns, "nominal": {"push": {}}, "rows": rows}
    )
    for part, index in enumerate(np.array_split(np.arange(rows), parts)):
        mass, other = drawn.uniform(0.05, 2.0, len(index)), drawn.uniform(0, 1, len(index))
        bad = mass > HEAVY
        table = pa.table(
            {
                "index": index,
                MASS: mass,
                NAME: other,
                "margin": HEAVY - mass,
                "margin.tracking_max": HEAVY - mass,
                "scenario": ["push"] * len(index),
                "status": np.where(bad, "missed", "success"),
                "missed": pa.array(np.where(bad, "tracking_max", None), pa.string()),
                "error": pa.nulls(len(index), pa.string()),
                "command": [f"panda-cosim run push --set plant.block_mass={m!r}" for m in
                            mass.tolist()],
            }
        )  # fmt: skip
        pq.write_table(table, folder / "results" / f"part-{part:08d}.parquet")
    return folder
