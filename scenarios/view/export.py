"""Writes the page of a run, on request with another run as a ghost."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ...fmus.atomic import replacing
from ...fmus.errors import InputError
from ...plant.parameters import PlantParameters
from ...plant.scene import load_scene
from ..files import model_file, read_integer
from ..pictures.motion import refuse_without_model
from ..recording import Recording
from .model import describe as describe_model
from .page import Contents, page
from .run import ROLES, Roles, RunData, Shown
from .run import describe as describe_run

if TYPE_CHECKING:
    from ..pictures.meshes import Meshes

VIEW_FILE: Final = "view.html"
SUMMARY_FILE: Final = "summary.json"
DEFAULT_SCENE: Final = "tabletop"  # if a recording does not name its scene


def write_view(runs: Sequence[Shown], path: Path) -> Path:
    """Write the page."""
    text = view_page(runs)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def view_page(runs: Sequence[Shown]) -> str:
    """Return the page as HTML."""
    return page(contents(runs))


def contents(runs: Sequence[Shown]) -> Contents:
    """Return the data of runs; the first is compared with the second, if any."""
    models: dict[str, dict[str, Any]] = {}
    documents = []
    for index, run in enumerate(runs):
        described = describe_model(run.model)
        key = hashlib.sha256(json.dumps(described).encode()).hexdigest()[:12]
        models[key] = described
        against = runs[1].source if index == 0 and len(runs) > 1 else None
        documents.append(describe_run(run, key, against))
    title = f"{documents[0]['title']} · panda-cosim"
    return Contents(title, [run.name for run in runs], documents, models)


def shown_run(
    folder: Path | str,
    *,
    name: str | None = None,
    model: Any = None,
    meshes: Meshes = "never",
    roles: Roles = ROLES,
) -> Shown:
    """Open a run to show."""
    recording = Recording.open(folder, in_order=True)
    place = recording.path.parent
    return show_source(
        recording,
        name or place.resolve().name,
        summary=read_summary(place / SUMMARY_FILE),
        model=model,
        meshes=meshes,
        roles=roles,
    )


def show_source(  # noqa: PLR0913 - options, by keyword
    source: RunData,
    name: str,
    *,
    summary: dict[str, Any],
    model: Any = None,
    meshes: Meshes = "never",
    roles: Roles = ROLES,
) -> Shown:
    """Return a run to show, with the models named in its recording; see `shown_run`."""
    if model is not None:
        return Shown(name, source, model, model, summary, roles)
    own = model_file(source)
    if own is not None:
        from ..pictures.meshes import load_model  # noqa: PLC0415 - not of our own plant

        return Shown(name, source, load_model(str(own)), None, summary, roles)
    refuse_without_model(source)
    physics = plant_model(source)
    scene = str(source.metadata.get("scene") or DEFAULT_SCENE)
    if meshes == "never":
        return Shown(name, source, physics, physics, summary, roles)
    from ..pictures.meshes import load_model  # noqa: PLC0415 - few ask for them

    look = load_model(scene, meshes)
    return Shown(name, source, look, physics, summary, roles)


def plant_model(source: RunData) -> Any:
    """Compile the plant's model with a recording's scene, block mass and friction."""
    given = source.metadata.get("parameters", {}).get("plant", {})
    values = {key: given[key] for key in ("block_mass", "block_friction") if key in given}
    scene = source.metadata.get("scene") or given.get("scene") or DEFAULT_SCENE
    try:
        return load_scene(PlantParameters(scene=scene, **values), drawn=True)
    except (TypeError, ValueError) as error:
        raise InputError(f"the recording's plant cannot be drawn: {error}") from error


def read_summary(path: Path) -> dict[str, Any]:
    """Return summary.json; empty if missing or unreadable."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"), parse_int=read_integer)
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
