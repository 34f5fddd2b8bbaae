"""The gallery of the site: all shipped scenarios and the reports, made by our commands."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Container
from contextlib import closing
from pathlib import Path

import numpy as np
from jinja2 import Template
from PIL import Image

from panda_cosim import Recording, load_scenario, shipped_scenarios
from panda_cosim.result.judging.criterion import bound_text, margin_text, quantity
from panda_cosim.result.judging.summary import Summary
from panda_cosim.result.pictures.motion import poses, scene_of
from panda_cosim.result.pictures.offscreen import OffscreenRenderer
from panda_cosim.run.prepare import prepare
from panda_cosim.task.client import MissingPackageError

# What the gallery begins with: tasks, then limits. Of each the camera, and the share of the run at
# which its picture is taken, so that no two look alike.
FIRST = {
    "pick_and_place": ("overview", 0.5), "stack_blocks": ("closeup", 0.85),
    "peg_in_hole": ("closeup", 0.7), "open_door": ("overview", 0.75), "draw_circle": ("front", 0.6),
    "wipe": ("closeup", 0.5), "push_block": ("front", 0.6),
    "place_and_pick_again": ("closeup", 0.35), "pick_and_place_fast_fr3": ("front", 0.45),
    "collision": ("overview", 0.4), "beyond_reach": ("front", 0.7), "heavy_block": ("closeup", 0.3),
}  # fmt: skip
CAMERAS = ("overview", "front", "closeup")  # of the others, in turn
VERDICTS = (0, 1, 3)  # exit codes
WRITTEN = (0, 2)  # of pages, which some scenarios cannot have
# Elements of a page that simulates by itself that are alike in all: its engine.
SHARED = "engine.js"
MODULES = re.compile(
    r'<script type="text/plain" data-(module|worker|licences)(?:="(\w+)")?>(.*?)</script>', re.S
)
ADD = """{
    const element = document.createElement("script");
    Object.assign(element, { type: "text/plain", textContent: text });
    element.dataset[key] = value;
    document.body.append(element);
}"""
# Pages beside those of the scenarios: title, text, what is shown, and the commands that make it.
REPORTS = {
    "pictures": (
        "Plot, contact sheet and video",
        "For papers and slides: what `run` draws beside the page in 3D.",
        ("run/plot.png", "run/contact_sheet.png", "run/video.mp4"),
        ("panda-cosim run pick_and_place --out run",),
    ),
    "laws": (
        "Two control laws compared",
        "For control engineers: the same task with the default gains, and with the published "
        "tutorial's law.",
        ("compared/compare.html",),
        (
            "panda-cosim run pick_and_place --no-video --out ours",
            "panda-cosim run pick_and_place --no-video --out published --set gains=tutorial",
            "panda-cosim compare ours published --out compared",
        ),
    ),
    "sweep": (
        "Report of a sweep",
        "For users who ask how robust a task is: 36 blocks that differ in mass and friction.",
        ("blocks/report.html",),
        (
            "panda-cosim sweep pick_and_place --vary plant.block_mass=0.1:3:6 "
            "--vary plant.block_friction=0.1:1:6 --out blocks",
            "panda-cosim sweep report blocks",
        ),
    ),
    "regression": (
        "Report of a regression",
        "For maintainers of a task: two scenarios against their references, with a gain 5 % too "
        "low.",
        ("report/report.html",),
        ("panda-cosim regress push tutorial --set controller.kp=7.6 --report report",),
    ),
}
SHOWN = """
{%- macro shown(path, title) %}
{% if path.endswith("html") %}<iframe class="page" src="{{ path }}"
 title="{{ title }}" loading="lazy"></iframe>

[Open it on a page of its own]({{ path }})
{% elif path.endswith("mp4") %}<video class="wide" controls src="{{ path }}"></video>
{% else %}![{{ title }}]({{ path }}){ .wide }
{% endif %}{% endmacro -%}
---
hide: [toc]
---

"""
REPORT = Template(
    SHOWN
    + """# {{ title }}

{{ text }}
{% for path in paths %}{{ shown(path, title) }}{% endfor %}
```sh
{{ lines | join("\\n") }}
```
"""
)
SCENARIO = Template(
    SHOWN
    + """# {{ name }}

For authors of scenarios, an example: {{ purpose[0] | lower }}{{ purpose[1:] }}.
{%- if reason %} It is meant to fail: {{ reason }}.{% endif %}
{{ shown(name ~ "/view.html", name) }}
{% if plays %}
[Simulate it in this browser: push, drag and tune]({{ name }}/play.html)
{% endif %}
```sh
panda-cosim run {{ name }}
```

| criterion | measured | required | margin | |
| --- | --- | --- | --- | --- |
{%- for it in criteria %}
| `{{ it.name }}` | {{ it.reason or quantity(it.value, it.unit) }} | {{ bound_text(it) }} |
{{- " " }}{{ margin_text(it) }} | {{ it.word if it.ok else "**" ~ it.word ~ "**" }} |
{%- endfor %}
"""
)
SCENARIO.globals |= {f.__name__: f for f in (bound_text, margin_text, quantity)}
FIGURE = Template(
    '<figure><a href="gallery/{{ name }}.html">'
    '<img src="gallery/{{ name }}.png" alt="{{ title }}" loading="lazy" width="480" height="360">'
    "</a><figcaption><b>{{ title }}</b>. {{ text }}</figcaption></figure>"
)


def gallery(docs: Path) -> str:
    """Run all shipped scenarios and the reports; a page for each, and a grid of pictures."""
    folder = docs / "gallery"
    folder.mkdir()
    figures, links = [], []
    shipped = shipped_scenarios()
    for number, name in enumerate(dict.fromkeys((*FIRST, *shipped))):
        scenario = load_scenario(shipped[name])
        try:
            prepare(scenario)
        except MissingPackageError as missing:
            print(f"{name}: left out: {missing}", flush=True)
            continue
        _run(f"panda-cosim run {name} --no-video --out {name}", folder)
        summary = Summary.open(folder / name)
        if not summary.as_expected:
            raise SystemExit(f"{name}: not as expected")
        look = FIRST.get(name, (CAMERAS[number % 3], 0.2 + 0.06 * (number % 11)))
        _thumbnail(Recording.open(folder / name), folder / f"{name}.png", *look)
        purpose = scenario.purpose
        reason = summary.expect_reason
        plays = _page(name, folder)
        text = SCENARIO.render(
            name=name, purpose=purpose, reason=reason, criteria=summary.criteria, plays=plays
        )
        (folder / f"{name}.md").write_text(text)
        title = name.replace("_", " ").capitalize()
        figures.append(FIGURE.render(name=name, title=title, text=purpose))
    for name, (title, text, paths, lines) in REPORTS.items():
        for line in lines:
            _run(line, folder)
        page = REPORT.render(title=title, text=text, paths=paths, lines=lines)
        (folder / f"{name}.md").write_text(page)
        links.append(f"- [{title}](gallery/{name}.md)")
    for path in folder.rglob("*.*"):
        if path.suffix not in (".html", ".js", ".md", ".mp4", ".png"):
            path.unlink()  # data of the runs, which no page shows
    grid = "\n".join(figures)
    return "\n".join([f'<div class="gallery">\n{grid}\n</div>\n\n## Reports\n', *links])


def _page(name: str, folder: Path) -> bool:
    """Write a scenario's page that simulates by itself, unless a page cannot."""
    page = folder / name / "play.html"
    if _run(f"panda-cosim live {name} --page {name}/play.html", folder, WRITTEN):
        return False
    page.write_text(shared(page.read_text(encoding="utf-8"), folder / SHARED), encoding="utf-8")
    return True


def shared(page: str, script: Path) -> str:
    """Return a page whose modules are in a script beside its folder, which all pages load."""
    code = f"for (const [key, value, text] of {json.dumps(MODULES.findall(page))}) {ADD}"
    script.write_text(code, encoding="utf-8")
    digest = "sha256-" + base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
    tag = f'<script src="../{script.name}" integrity="{digest}"></script>'
    first = page.index(MODULES.search(page)[0])
    page = page[:first] + tag + MODULES.sub("", page[first:])
    return page.replace("script-src ", f"script-src '{digest}' ", 1)


def _run(line: str, folder: Path, codes: Container[int] = VERDICTS) -> int:
    done = subprocess.run(
        [sys.executable, "-m", "panda_cosim", *shlex.split(line)[1:]],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    print(f"{line}: {done.returncode}", flush=True)
    if done.returncode not in codes:
        raise SystemExit(done.stderr)
    return done.returncode


def _thumbnail(recording: Recording, path: Path, camera: str, share: float) -> None:
    at = recording.time[[int(share * (recording.rows - 1))]]
    with closing(OffscreenRenderer(scene_of(recording), 480, 360, camera)) as renderer:
        (image,) = renderer.frames(poses(recording, at))
    Image.fromarray(np.asarray(image)).quantize(128).save(path, optimize=True)
