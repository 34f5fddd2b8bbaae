"""Pages: data, code and style in one HTML file that makes no requests.

Data are JSON in script elements of a type that no browser runs; the page's code inserts them as
text (`legible` in dom.ts). A content security policy allows only the page's own scripts, by their
digests, and no requests, so that nothing else would run even if a text got through as HTML.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, Final

from ...assets import SCENES
from ...assets.franka import DEFAULT_ROBOT, ROBOTS
from ...fmus.atomic import cache_folder, cached, write_whole
from ...fmus.build.identity import code_digest, digest
from ...fmus.errors import InputError, legible, shown
from ...plant.parameters import BLOCK, PlantParameters
from ...result.judging.summary import Summary
from ...result.recording import Recording
from ...result.recording.storage import Metadata
from ...task.files import model_file
from ..pictures.motion import has_model
from .columns import Json
from .run import Shown
from .run import describe as describe_run

Document = Mapping[str, Any]  # of a run, as `run.describe` returns it

TEMPLATE: Final = "template.html"
# Modules with which a page simulates, and licences of what is in them; .ci/engine.py makes them.
ENGINE: Final = "engine.json"
NOTICE: Final = "LICENSES-engine.txt"
VIEW_FILE: Final = "view.html"
TITLE: Final = 200  # [character]


def live_page(
    title: str, run: Mapping[str, object], engine: Mapping[str, object] | None = None
) -> str:
    """Return the page of a simulation: of a server, to which alone it connects, or its own."""
    data = data_element("live", run)
    if engine is None:
        return _view(title, data, "; connect-src 'self'")
    data += data_element("engine", engine)
    data += _text("worker", _code()["worker"]["deflated"]) + _text("licences", _part(NOTICE))
    for name, module in json.loads(_part(ENGINE)).items():
        data += _text(f'module="{name}"', module["deflated"])
    return _view(title, data, "; worker-src blob:", ["'wasm-unsafe-eval'"])


def _view(title: str, data: str, policy: str = "", scripts: Sequence[str] = ()) -> str:
    title = legible(title, TITLE)
    body = Template(_part("view.html")).substitute(title=escape(title))
    return document(title, body, data, ["view"], policy=policy, scripts=scripts)


def document(  # noqa: PLR0913 - the parts of a page
    title: str, body: str, data: str, code: Sequence[str], *, policy: str = "",
    scripts: Sequence[str] = (),
) -> str:  # fmt: skip
    """Return a page as HTML.

    Args:
        title: As text.
        body: As HTML, without scripts.
        data: Elements, see `data_element`.
        code: Names of bundles, which run in this order; each has a style sheet.
        policy: Added to the content security policy.
        scripts: Further sources of scripts in it.
    """
    known = _code()
    loader = f"<script>{known['loader']['text']}</script>"
    bundles = (_text(f'code="{name}"', known[name]["deflated"]) for name in code)
    sources = [f"'sha256-{known[name]['sha256']}'" for name in ("loader", *code)]
    # Inserted text is not searched for further placeholders.
    return Template(_part(TEMPLATE)).substitute(
        title=escape(title),
        scripts=" ".join((*sources, *scripts)),
        more=policy,
        style="\n".join(_part(f"{name}.css") for name in code),
        kind=code[0],
        body=body,
        data=data,
        code="\n".join((*bundles, loader)),
    )


def _text(label: str, text: str) -> str:
    """Return an element with code or text, which the loader or a bundle finds by its label."""
    return f'<script type="text/plain" data-{label}>{text}</script>'


def rendered(template: Path, **content: object) -> str:
    """Fill in the HTML template of a page's body; all texts in it become legible."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 - slow

    loader = FileSystemLoader(template.parent)
    env = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, finalize=shown)
    return env.get_template(template.name).render(content)


def data_elements(documents: Sequence[Document], models: Mapping[str, Json]) -> str:
    """Return the elements with runs and models; the page's code reads each when needed."""
    elements = [data_element(f"model:{key}", model) for key, model in models.items()]
    elements += [data_element(f"run:{run['name']}", run) for run in documents]
    return "\n".join(elements)


def data_element(name: str, value: object) -> str:
    """Return an element with JSON; `embedded` in embedded.ts reads it by its name."""
    # The name is JSON, too: HTML changes some characters of an attribute.
    label = escape(json.dumps(name))
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    text = text.replace("<", "\\u003c").replace("\u2028", "\\u2028")
    return f'<script type="application/json" data-view="{label}">{text}</script>'


@cache
def _part(name: str) -> str:
    return files(__package__).joinpath("page", name).read_text(encoding="utf-8")


@cache
def _code() -> dict[str, dict[str, str]]:
    """Return each bundle as it was built: its text, or deflated, and its digest, both in base64."""
    return dict(json.loads(_part("code.json")))


@dataclass(frozen=True)
class Inline:
    """A page for notebooks: Jupyter, JupyterLab, VS Code."""

    page: str = field(repr=False)  # as HTML
    height: int  # of the frame around it [px]

    def _repr_html_(self) -> str:
        """Return the page in a frame, isolated from the notebook's own scripts."""
        style = f"width:100%;height:{self.height:d}px;border:1px solid #8884;border-radius:8px"
        return (
            f'<iframe srcdoc="{escape(self.page)}" style="{style}" sandbox="allow-scripts" '
            'title="Run in 3D"></iframe>'
        )


def write_view(runs: Sequence[Shown], path: Path) -> Path:
    """Write the page."""
    write_whole(path, view_page(runs))
    return path


def view_page(runs: Sequence[Shown]) -> str:
    """Return the page as HTML; the second run is the ghost of the first."""
    documents, models = contents(runs)
    data = data_elements(documents, models)
    data += data_element("show", {"runs": [run.name for run in runs]})
    return _view(f"{documents[0]['title']} · panda-cosim", data)


def contents(runs: Sequence[Shown]) -> tuple[list[Document], dict[str, Json]]:
    """Return the runs' documents, and their models by key; the first run has all comparisons."""
    models: dict[str, Json] = {}
    documents: list[Document] = []
    for index, run in enumerate(runs):
        key = hashlib.sha256(json.dumps(run.model).encode()).hexdigest()[:12]
        models |= {key: run.model} if run.model else {}
        against = runs[1].source if index == 0 and len(runs) > 1 else None
        documents.append(describe_run(run, key, against))
    return documents, models


def shown_run(folder: Path | str, *, name: str | None = None) -> Shown:
    """Open a run to show."""
    recording = Recording.open(folder, in_order=True)
    name = name or recording.path.parent.resolve().name
    return show_source(recording, name, summary=Summary.of(recording))


def show_source(source: Recording, name: str, *, summary: Summary) -> Shown:
    """Return a run to show, with the model named in its recording, or with curves alone."""
    model = masses = None
    if own := model_file(source):
        from ...fmus.sources.model_fmu import load  # noqa: PLC0415 - imports MuJoCo
        from .model import describe  # noqa: PLC0415 - imports MuJoCo

        model = describe(load(own))
    elif has_model(source):
        model, masses = plant_model(source.metadata)
    return Shown(name, source, model, masses, summary)


def plant_model(metadata: Metadata) -> tuple[Json, list[float]]:
    """Return the plant's model with a recording's scene and robot, and the masses of its bodies."""
    parameters = plant_parameters(metadata)
    model = described_scene(parameters.scene, parameters.robot)
    given = {BLOCK: parameters.block_mass}
    return model, [given.get(body["name"], body["mass"]) for body in model["bodies"]]


def plant_parameters(metadata: Metadata) -> PlantParameters:
    """Return scene, robot and block of a recording of our plant."""
    plant = metadata.get("parameters", {}).get("plant", {})
    values = {key: plant[key] for key in ("robot", "block_mass") if key in plant}
    scene = metadata.get("scene") or plant.get("scene") or PlantParameters.scene
    if scene not in SCENES or values.get("robot", DEFAULT_ROBOT) not in ROBOTS:
        raise InputError("the recording's plant cannot be drawn: its scene or robot is not known")
    return PlantParameters(scene=scene, **values)


@lru_cache(maxsize=4)
def described_scene(scene: str, robot: str) -> Json:
    """Describe a scene of ours, once for each version of the code."""

    def make() -> bytes:
        from ...plant.scene import load_scene  # noqa: PLC0415 - imports MuJoCo
        from .model import describe  # noqa: PLC0415 - imports MuJoCo

        model = load_scene(PlantParameters(scene=scene, robot=robot), drawn=True)
        return json.dumps(describe(model)).encode()

    code = [Path(__file__).with_name(name).read_bytes() for name in ("model.py", "columns.py")]
    key = digest(scene, robot, code_digest(), *code)
    kept = cached(cache_folder() / "scenes" / f"{key[:24]}.json", make)
    return dict(json.loads(kept.read_bytes()))
