"""Writes the page of a run, on request with another run as a ghost."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final

from ...fmus.atomic import replacing
from ...fmus.errors import InputError
from ...plant.parameters import PlantParameters
from ...plant.scene import load_scene
from ..files import model_file, read_integer
from ..pictures.meshes import Meshes, load_model
from ..pictures.motion import DEFAULT_SCENE, refuse_without_model
from ..recording import Recording
from .model import describe as describe_model
from .page import Contents, page
from .run import RunData, Shown
from .run import describe as describe_run

VIEW_FILE: Final = "view.html"
SUMMARY_FILE: Final = "summary.json"
# Of runs with the same scene, and of one that was described while its FMUs stepped.
described_model = lru_cache(maxsize=2)(describe_model)
_drawn_scene = lru_cache(maxsize=2)(partial(load_scene, drawn=True))


def write_view(runs: Sequence[Shown], path: Path) -> Path:
    """Write the page."""
    with replacing(path) as temporary:
        temporary.write_text(view_page(runs), encoding="utf-8")
    return path


def view_page(runs: Sequence[Shown]) -> str:
    """Return the page as HTML."""
    return page(contents(runs))


def contents(runs: Sequence[Shown]) -> Contents:
    """Return the data of runs; the first is compared with the second, if any."""
    models: dict[str, dict[str, Any]] = {}
    documents = []
    for index, run in enumerate(runs):
        described = described_model(run.model)
        key = hashlib.sha256(json.dumps(described).encode()).hexdigest()[:12]
        models[key] = described
        against = runs[1].source if index == 0 and len(runs) > 1 else None
        documents.append(describe_run(run, key, against))
    title = f"{documents[0]['title']} · panda-cosim"
    return Contents(title, [run.name for run in runs], documents, models)


def shown_run(folder: Path | str, *, name: str | None = None, meshes: Meshes = "never") -> Shown:
    """Open a run to show."""
    recording = Recording.open(folder, in_order=True)
    place = recording.path.parent
    summary = read_summary(place / SUMMARY_FILE)
    return show_source(recording, name or place.resolve().name, summary=summary, meshes=meshes)


def show_source(
    source: RunData, name: str, *, summary: dict[str, Any], meshes: Meshes = "never"
) -> Shown:
    """Return a run to show, with the models named in its recording."""
    own = model_file(source)
    if own is not None:
        return Shown(name, source, load_model(str(own)), None, summary)
    refuse_without_model(source)
    physics = plant_model(source.metadata)
    scene = str(source.metadata.get("scene") or DEFAULT_SCENE)
    look = physics if meshes == "never" else load_model(scene, meshes)
    # Another engine's contact forces cannot be computed by the installed one.
    return Shown(name, source, look, None if "mujoco" in source.metadata else physics, summary)


def plant_model(metadata: Mapping[str, Any]) -> Any:
    """Return the plant's model with a recording's scene, block mass and friction."""
    plant = metadata.get("parameters", {}).get("plant", {})
    values = {key: plant[key] for key in ("robot", "block_mass", "block_friction") if key in plant}
    scene = metadata.get("scene") or plant.get("scene") or DEFAULT_SCENE
    try:
        return _drawn_scene(PlantParameters(scene=scene, **values))
    except (TypeError, ValueError) as error:
        raise InputError(f"the recording's plant cannot be drawn: {error}") from error


def read_summary(path: Path) -> dict[str, Any]:
    """Return summary.json; empty if missing or unreadable."""
    try:
        summary = json.loads(path.read_text(encoding="utf-8"), parse_int=read_integer)
    except (OSError, ValueError):
        return {}
    return summary if isinstance(summary, dict) else {}
