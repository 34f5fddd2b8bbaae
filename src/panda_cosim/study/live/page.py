"""The page of a running simulation: the view's code, a model, the first row, and the path."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from ...fmus.errors import InputError, one_line
from ...fmus.interface.plant import FORCE_MAX, FORCES
from ...fmus.master.step import SWITCHED
from ...fmus.sources.model_fmu import load
from ...plant.parameters import PlantParameters
from ...plant.scene import load_scene
from ...run.folder import SCENARIO_FOLDER
from ...run.session import Session
from ...show.view.facts import column_bounds, shown_curves
from ...show.view.model import describe as describe_model
from ...show.view.page import live_page
from ...show.view.run import ROLES
from ...task.files import MODEL_FILE
from ...task.rotations import about_z, rotate

PUSH: Final = "plant.push_force"
POINTS: Final = 2000  # of a curved path
HAND: Final = {
    "signal": PUSH,
    "bodies": ["hand", "left_finger", "right_finger"],  # the force acts on the first
    "stiffness": 120.0,  # [N/m] of the drag's spring
    "damping": 0.0,  # [N.s/m]: the arm damps itself
    "limit": 80.0,  # [N]
}
BLOCK: Final = {"obj": "block_force"}  # of our own plant
SWING: Final = 10.0  # [rad/s] natural frequency of a free body on the drag's spring
LOAD: Final = 60.0  # [m/s^2] largest acceleration of a free body by a drag
ERROR: Final = "tracking error"  # which the page computes
CURVES: Final = (
    ("Tracking error", [ERROR]),
    ("Fingers on the block", ["plant.contact_force"]),
    ("Push on the hand", [f"{PUSH}[{i}]" for i in (1, 2, 3)]),
    ("Push on the block", [f"plant.block_force[{i}]" for i in (1, 2, 3)]),
    ("Position of the hand", [f"plant.hand_xpos[{i}]" for i in (1, 2, 3)]),
    ("Joint velocities", [f"plant.qvel[{i}]" for i in range(1, 8)]),
    ("Joint torques", [f"plant.actuator_force[{i}]" for i in range(1, 8)]),
)


def page_of(session: Session, engine: Mapping[str, object] | None = None) -> str:
    """Return the page of a session as HTML; with an `engine_of` it, it simulates by itself."""
    columns, model = list(session.numbers()), _model(session)
    values = {f"{i}.{n}": v for i, own in session.parameters.items() for n, v in own.items()}
    bounds = column_bounds(session.scenario.robot) if session.is_panda else {}
    content = {
        "name": session.scenario.name,
        "about": _about(session),
        "model": describe_model(model),
        "masses": model.body_mass.tolist() if session.is_panda else None,
        "signals": _signals(session),
        "columns": columns,
        "roles": {
            role: [column for column in columns if column.partition("[")[0] == signal]
            for role, signal in ROLES.items()
        },
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
    columns = dict.fromkeys((*session.signals, ERROR), "")
    scenario, curves = session.scenario, shown_curves(CURVES, columns)
    hint = ["drag the hand, the block or a waypoint"] if session.is_panda else []
    return {
        "title": f"{scenario.name.replace('_', ' ')}, live",
        "purpose": one_line(scenario.purpose),
        "facts": [f"{scenario.duration:.2f} s", *hint],
        "verdict": {"state": "plain", "words": "in real time"},
        "curves": curves if session.is_panda else [],  # the page's code takes the first signals
        **{key: [] for key in ("notes", "criteria", "limits", "moments", "waypoints")},
    }


def _signals(session: Session) -> list[dict[str, object]]:
    numbers, signals = session.numbers(), []
    recorded = session.prepared.assembly.recorded(session.scenario.coupling)[1:]  # without time
    columns = [column for column in recorded if column.name in numbers]
    for signal, group in groupby(columns, key=lambda column: column.name.partition("[")[0]):
        own = list(group)
        about = {"unit": own[0].unit, "units": [column.unit for column in own]}
        about |= {"columns": [column.name for column in own], "words": own[0].description}
        signals.append({"name": signal, **about})
    return signals


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
