"""What the tests of sweeps share: a short scenario and small sweeps of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pyarrow as pa

from fault_support import write_files
from panda_cosim.study.sweep.definition import Sweep
from panda_cosim.study.sweep.design import Design
from panda_cosim.study.sweep.row import command
from panda_cosim.study.sweep.store import Store, schema

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
MASS, NAME = "plant.block_mass", "plant.name<b>"
HEAVY = 1.09  # [kg] from which rows fail
FORCE = "push[1].force[2]"  # above about 25 N, tracking_max is missed


def short_scenario(folder: Path) -> Path:
    """Write a scenario of 0.1 s whose hand is pushed."""
    return write_files(folder, SETTINGS, "0,home,0,0,0,0.08", "0.1,home,0,0,0.005,0.08")


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


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """Return the table's rows without what differs from run to run."""
    table: pa.Table = Store(folder).table()
    return list(table.drop_columns(["wall_s"]).to_pylist())


Outcome = Callable[[Mapping[str, Any]], tuple[str, float | None]]


def pretended(folder: Path, sweep: Sweep, outcome: Outcome, rows: Sequence[int] = ()) -> Path:
    """Write a sweep's folder whose rows end as a function of their values says, without running.

    Args:
        folder: Where.
        sweep: What is varied; its scenarios are names alone.
        outcome: Returns status and margin of a row; of criterion `tracking_max`, and of `max_slip`
            twice that if it is not the second scenario.
        rows: Those that are there; none: all.
    """
    design = Design(sweep)
    definition = {name: getattr(sweep, name) for name in ("design", "seed", "samples", "criterion",
                                                          "goal")}  # fmt: skip
    criteria = ["margin", "margin.tracking_max", "margin.max_slip"]
    nominal = {name: dict.fromkeys(criteria[: 3 - i], 0.5) for i, name in enumerate(sweep.scenario)}
    columns = ["index", "scenario", "status", "missed", "error", "command", *criteria,
               "summary.limits.torque_share[1]", "wall_s", "reach_m"]  # fmt: skip
    origin = {"definition": definition | {"scenario": list(sweep.scenario)}, "scenarios": {},
              "vary": {key: asdict(each) for key, each in sweep.vary.items()}, "fmus": {},
              "versions": {"mujoco": "4"}}  # fmt: skip
    store = Store(folder)
    content = {"origin": origin, "keys": list(design.columns), "rows": len(design),
               "columns": columns, "nominal": nominal, "without_effect": []}  # fmt: skip
    store.write(content)
    store.add(
        [_row(sweep, design, i, outcome) for i in rows or range(len(design))],
        schema(design.values(0), columns),
    )
    return folder


def _row(sweep: Sweep, design: Design, index: int, outcome: Outcome) -> dict[str, Any]:
    values, name = design.values(index), sweep.scenario[design.scenario(index)]
    status, margin = outcome(values | {"scenario": name})
    slips = margin is not None and name == sweep.scenario[0]
    return values | {
        "index": index,
        "scenario": name,
        "status": status,
        "missed": "tracking_max" if status == "missed" else None,
        "command": command(name, values),
        "margin": margin,
        "margin.tracking_max": margin,
        "margin.max_slip": 2 * margin if slips else None,
        "summary.limits.torque_share[1]": 1.5 if index % 10 == 3 else 0.5,
        "wall_s": 0.1,
        "reach_m": 0.8,
    }


def made_up(folder: Path, rows: int, *, third: bool = False) -> Path:
    """Write a sweep's folder of two parts, whose rows fail above a mass."""

    def outcome(values: Mapping[str, Any]) -> tuple[str, float]:
        margin = HEAVY - values[MASS]
        return "success" if margin >= 0 else "missed", margin

    vary: Any = {MASS: {"uniform": [0.05, 2.0]}, NAME: {"uniform": [0.0, 1.0]}}
    vary |= {FORCE: {"uniform": [0.0, 1.0]}} if third else {}
    sweep = Sweep(scenario=("push",), design="random", samples=rows, seed=1, vary=vary)
    for part in (range(rows // 2), range(rows // 2, rows)):
        pretended(folder, sweep, outcome, part)
    return folder
