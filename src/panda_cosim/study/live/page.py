"""The page of a running simulation: the view's code, a model, the first row, and the path."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from ...fmus.errors import InputError, one_line
from ...fmus.interface.plant import FORCE_MAX, FORCES
from ...fmus.master.step import SWITCHED
from ...fmus.sources.model_fmu import load
from ...plant.parameters import PlantParameters
from ...plant.scene import load_scene
from ...result.view.facts import CURVES, column_bounds, shown_curves
from ...result.view.model import describe as describe_model
from ...result.view.page import live_page
from ...result.view.run import by_role
from ...run.folder import SCENARIO_FOLDER
from ...run.session import Session
from ...task.files import MODEL_FILE
from ...task.rotations import about_z, rotate
from ...task.tolerances import flattened, signal_of

PUSH: Final = "plant.push_force"
POINTS: Final = 2000  # of a curved path
BLOCK: Final = {"obj": "block_force"}  # of our own plant
SWING: Final = 10.0  # [rad/s] natural frequency of a free body on the drag's spring
LOAD: Final = 60.0  # [m/s^2] largest acceleration of a free body by a drag
ERROR: Final = "tracking error"  # which the page computes
_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
HAND: Final[dict[str, object]] = _TABLES["hand"]


def page_of(session: Session, engine: Mapping[str, object] | None = None) -> str:
    """Return the page of a session as HTML; with an `engine_of` it, it simulates by itself."""
    columns, model = list(session.numbers()), _model(session)
    values = dict(flattened(session.parameters))
    bounds = column_bounds(session.scenario.robot) if session.is_panda else {}
    content = {
        "name": session.scenario.name,
        "about": _about(session),
        "model": describe_model(model),
        "masses": model.body_mass.tolist() if session.is_panda else None,
        "signals": list(_signals(session)),
        "columns": columns,
        "roles": by_role(columns),
        "bounds": {name: pair for name, pair in bounds.items() if name in columns},
        "duration": session.scenario.duration,
        "row": list(session.numbers().values()),
        "tunables": [
            {
                "name": name,
                "reference": scalar.value_reference,
                "start": values[name],
                "unit": scalar.unit,
                "words": scalar.variable.description,
                "minimum": scalar.minimum,
                "maximum": scalar.maximum,
                "kind": scalar.variable.kind,
                "choices": scalar.variable.choices,
            }
            for name, scalar in session.tunables.items()
        ],
        "couplings": list(SWITCHED),
        "pushes": list(_pushes(session, model)),
        "plan": plan(session),
    }
    return live_page(f"{session.scenario.name} live", content, engine)


def _pushes(session: Session, model: Any) -> Iterator[dict[str, object]]:
    """Yield the bodies that can be dragged: arm, block, and all with an input `NAME_force`."""
    given = session.inputs  # from outside
    if PUSH in given:
        yield HAND
    for body in range(1, model.nbody):
        name = model.body(body).name
        force = BLOCK.get(name, re.sub(r"\W+", "_", name) + "_force")
        signal = f"plant.{force}"
        if name in FORCES and signal in given:
            yield {**HAND, "signal": signal, "bodies": [name]}
        elif name and f"{signal}[3]" in given:
            mass = float(model.body_subtreemass[body])
            spring = {"stiffness": mass * SWING**2, "damping": mass * SWING}
            limit = min(LOAD * mass, FORCE_MAX)
            yield {"signal": signal, "bodies": [name], **spring, "limit": limit}


def _model(session: Session) -> Any:
    """Return the plant's model: the scene's, or the one in its FMU."""
    if not session.is_panda:
        kept = session.folder / SCENARIO_FOLDER / MODEL_FILE
        if not kept.is_file():
            raise InputError(
                f"{session.scenario.name}: no FMU in it holds a MuJoCo model, so there is nothing "
                "to show; `panda-cosim run` records it"
            )
        return load(kept)
    plant: Any = session.parameters["plant"]
    drawn = ("scene", "robot", "block_mass", "block_friction")
    return load_scene(PlantParameters(**{key: plant[key] for key in drawn}), drawn=True)


def _about(session: Session) -> dict[str, object]:
    scenario, curves = session.scenario, (*CURVES[:2], *_TABLES["curves"].items(), *CURVES[2:])
    columns = dict.fromkeys((*session.signals, ERROR), "")
    hint = ["drag the hand, the block or a waypoint"] if session.is_panda else []
    return {
        "title": f"{scenario.name.replace('_', ' ')}, live",
        "purpose": one_line(scenario.purpose),
        "facts": [f"{scenario.duration:.2f} s", *hint],
        "verdict": {"state": "plain", "words": "in real time"},
        # Of others, the page's code takes the first signals.
        "curves": shown_curves(curves, columns) if session.is_panda else [],
        **{key: [] for key in ("notes", "criteria", "limits", "moments", "waypoints")},
    }


def _signals(session: Session) -> Iterator[dict[str, object]]:
    """Yield the recorded signals that are numbers, as a run's page has them."""
    numbers = session.numbers()
    recorded = session.prepared.assembly.recorded(session.scenario.coupling)[1:]  # without time
    columns = [column for column in recorded if column.name in numbers]
    for signal, group in groupby(columns, key=lambda column: signal_of(column.name)):
        own = list(group)
        names, units = [column.name for column in own], [column.unit for column in own]
        yield {"name": signal, "columns": names, "units": units, "words": own[0].description}


def plan(session: Session) -> dict[str, object]:
    """Return the commanded path and its waypoints in the world, as `Plan` in live/link.ts."""
    if not session.scenario.is_commanded:
        return {"time": [], "points": [], "waypoints": []}
    path = session.trajectory
    is_curved = path.interpolation == "spline"  # else straight from row to row
    times = np.linspace(path.times[0], path.times[-1], POINTS) if is_curved else path.times
    points = path.sample(times)[:, :3]
    rows = zip(path.times.tolist(), path.positions.tolist(), session.table.rows, strict=True)
    return {
        "time": times.round(6).tolist(),
        "points": points.round(6).ravel().tolist(),
        "waypoints": [
            {"time": time, "label": getattr(row, "name", "") or str(number), "place": place}
            for number, (time, place, row) in enumerate(rows, start=1)
        ],
    }


def offset_of(session: Session, row: int, place: ArrayLike) -> list[float]:
    """Return a row's position in its own frame for a hand origin (3,) [m] in the world."""
    table = session.table.rows[row]
    way = np.asarray(place, dtype=np.float64) - session.trajectory.positions[row]
    if table.frame == "target" and session.scenario.align:
        (way,) = rotate(about_z(-session.start_pose.grasp_yaw)[None], way[None])
    offset: list[float] = (np.asarray(table.position) + way).round(6).tolist()
    return offset
