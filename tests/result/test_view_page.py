"""The view in a browser: what it shows, and how it reacts to the user."""

import json
import time
from dataclasses import replace
from functools import partial
from html import escape
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import mujoco
import numpy as np
import pytest

from browser import Page, find_browser
from crafted_texts import CRAFTED, HEBREW, HIDDEN, ODD
from fake_recording import FakeRecording
from panda_cosim import Recording
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.scene import load_scene
from panda_cosim.result.judging.definitions import DEFINITIONS
from panda_cosim.result.judging.summary import Summary
from panda_cosim.result.view.model import describe as describe_model
from panda_cosim.result.view.page import show_source, shown_run, write_view
from panda_cosim.result.view.run import Shown
from view_support import MODEL, run_scenario_outside

PLACE_TOLERANCE = 5e-6  # [m] of a body in the page
TURN_TOLERANCE = 0.01  # [deg]
VIEWER = "PandaView.viewer"
STAGE = f"{VIEWER}.stage"
READY = "window.PandaView !== undefined && PandaView.firstPicture > 0"
NOW = f"{VIEWER}.clock.time"

pytestmark = pytest.mark.skipif(find_browser() is None, reason="no Chromium here")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("view")


@pytest.fixture(scope="module")
def run(folder):
    """The pick and place."""
    return run_scenario_outside(folder / "run")


@pytest.fixture(scope="module")
def view(run, folder):
    """Its page."""
    return write_view([shown_run(run)], folder / "view.html")


@pytest.fixture(scope="module")
def compared(run, folder):
    """Its page, with a run as a ghost whose block stood elsewhere."""
    other = run_scenario_outside(folder / "other", "--set", "plant.block_pos[1]=0.46")
    return write_view([shown_run(run), shown_run(other)], folder / "compared.html")


def show(page: Page, path: Path, **how: Any) -> None:
    """Open a view and wait for its first picture."""
    page.open(path, **{"width": 820, "height": 560, **how})  # drawing is slow without a GPU
    page.wait(READY)
    page.value(f"{STAGE}.sun.castShadow = false")  # its light draws all once more


def look(page: Page, path: Path) -> None:
    """Open a view at its beginning; the one of another test that has called this stays."""
    if page.value("window.kept") != str(path):
        show(page, path)
        page.value(f"window.kept = {json.dumps(str(path))}")
    page.click(".pv-tab")
    page.value("document.activeElement.blur()")
    seek(page, 0.0)


def seek(page: Page, at: float) -> None:
    """Go to an instant."""
    page.value(f"{VIEWER}.go({{at: {at!r}}})")


def picture(page: Page) -> str:
    """Draw the scene and return its dots, shrunk, as text."""
    return str(
        page.value(f"""(() => {{
            const canvas = document.querySelector(".pv-stage canvas");
            {STAGE}.draw(performance.now());
            const small = document.createElement("canvas");
            [small.width, small.height] = [160, 120];
            small.getContext("2d").drawImage(canvas, 0, 0, 160, 120);
            return Array.from(small.getContext("2d").getImageData(0, 0, 160, 120).data).join();
        }})()""")
    )


def changed_dots(before: str, after: str) -> int:
    """Number of dots (of 19200) that differ visibly."""
    one, two = (np.array(text.split(","), int).reshape(-1, 4) for text in (before, after))
    return int((np.abs(one - two).max(axis=1) > 12).sum())


def poses_at(page: Page, times: Any, figure: int = 0) -> np.ndarray:
    """Positions and quaternions (len(times), nbody, 7) of a figure's bodies in the page's scene."""
    poses = page.value(f"""{json.dumps(list(map(float, times)))}.map((at) => {{
        {VIEWER}.go({{at}});
        return {STAGE}.figures[{figure}].bodies.map((body) => {{
            body.updateWorldMatrix(true, false);
            const place = body.getWorldPosition(body.position.clone());
            const turn = body.getWorldQuaternion(body.quaternion.clone());
            return [place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z];
        }});
    }})""")
    return np.array(poses)


def check_poses(page: Page, model: Any, run: Any, ticks: np.ndarray) -> None:
    """Check the page's bodies against MuJoCo's at some ticks."""
    data, qpos = mujoco.MjData(model), run["plant.qpos"]
    for tick, shown in zip(ticks, poses_at(page, run.time[ticks]), strict=True):
        data.qpos[:] = qpos[tick]
        mujoco.mj_kinematics(model, data)
        away = np.linalg.norm(shown[:, :3] - data.xpos, axis=1)
        cosine = np.abs((shown[:, 3:] * data.xquat).sum(axis=1)).clip(0, 1)
        assert away.max() < PLACE_TOLERANCE
        assert np.degrees(2 * np.arccos(cosine)).max() < TURN_TOLERANCE


def test_the_page_is_small_quick_and_alone(page, view):
    assert view.stat().st_size <= 700e3
    show(page, view)
    # On a quiet machine it is less than 3 s; here others may be at work.
    assert page.value("PandaView.firstPicture") < 20e3
    assert page.errors == []
    assert page.requests == [view.resolve().as_uri()]
    assert len(set(picture(page).split(","))) > 100


def test_bodies_are_where_mujoco_has_them_and_the_curves_are_the_recording(page, view, run):
    look(page, view)
    recording = Recording.open(run)
    ticks = np.random.default_rng(3).integers(0, recording.rows, 50)
    check_poses(page, load_scene(PlantParameters()), recording, ticks)
    for name in ("plant.qvel[4]", "plant.contact_force", "controller.dq[7]"):
        shown = page.value(f"{VIEWER}.runs[0].series('{name}').then(s => Array.from(s.values))")
        exact = recording[name]
        assert np.abs(np.array(shown) - exact).max() <= np.ptp(exact) / 2**16


def test_the_arrow_on_the_held_block_carries_its_weight(page, view, run):
    look(page, view)
    assert Recording.open(run).metadata["parameters"]["plant"]["block_mass"] == 0.18
    seek(page, 3.0)
    (tip,) = page.value(f"""{STAGE}.layers.find(({{key}}) => key === "forces").object.children.map(
        ({{children: [, head], quaternion}}) =>
            head.position.clone().setY(head.position.y + 0.025 * head.scale.y)
                .applyQuaternion(quaternion).toArray())""")
    assert np.array(tip) / 0.05 == pytest.approx([0.0, 0.0, 0.18 * 9.81], abs=0.1)  # [N]
    page.click(".pv-tab:last-child")
    assert "besides its weight" in page.value("document.querySelector('.pv-notes').innerText")


def test_verdict_and_limits_are_beside_it(page, view, run):
    look(page, view)
    page.click(".pv-tab:last-child")
    text = page.value("document.querySelector('.pv-facts').innerText")
    for words in ("tracking_rms", "≤ 0.1 mm", "≥ 100 mm", "joint torque", "reference jerk"):
        assert words in text
    criteria = json.loads((run / "summary.json").read_text())["criteria"]
    assert page.value("document.querySelectorAll('.pv-criterion.pv-good').length") == len(criteria)
    tip = page.value("document.querySelector('.pv-criterion').title")
    assert tip == DEFINITIONS[f"success.{criteria[0]['name']}"].text


def test_every_kind_of_joint_is_where_mujoco_has_it(page, folder):
    model = mujoco.MjModel.from_xml_string(MODEL)
    random = np.random.default_rng(5)
    qpos = random.uniform(-2, 2, (60, model.nq))
    for first in (3, 10):  # quaternions of the ball and of the free joint
        qpos[:, first : first + 4] /= np.linalg.norm(qpos[:, first : first + 4], axis=1)[:, None]
    made_up = FakeRecording(0.1 * np.arange(60), {"plant.qpos": qpos}, {"complete": True})
    path = write_view([Shown("foreign", made_up, describe_model(model))], folder / "foreign.html")
    show(page, path)
    check_poses(page, model, made_up, np.arange(0, 60, 3))
    before = picture(page)
    page.press("2")  # the camera on the moving arm
    assert page.value(f"{STAGE}.viewpoint.name") == "on the arm"
    assert changed_dots(before, picture(page)) > 1000
    assert page.errors == []


def test_the_keyboard_plays_and_steps(page, view):
    look(page, view)
    page.press(" ")
    page.wait(f"{VIEWER}.clock.playing && {NOW} > 0.2")
    page.press(" ")
    assert page.value(f"{VIEWER}.clock.playing") is False
    seek(page, 1.0)
    for key, expected in ((".", 1.001), (",", 1.0), ("ArrowRight", 1.065), ("End", 6.5)):
        page.press(key)
        assert page.value(NOW) == pytest.approx(expected, abs=1e-6), key
    page.press("]")
    assert page.value("document.querySelector('.pv-speed').value") == "2"
    page.press("?")
    assert page.value("document.querySelector('.pv-help').open") is True
    page.press("Escape")


def test_a_curve_is_reached_by_the_keyboard_named_and_zoomed(page, view):
    look(page, view)
    seek(page, 1.0)
    plot = "document.querySelector('.pv-chart[data-title=\"Joint velocities\"] .pv-plot')"
    page.value(f"{plot}.focus()")
    name = page.value(f"{plot}.ariaLabel")
    assert name.startswith("Joint velocities in rad/s at 1.000 s: plant.qvel[1] ")
    charts = f"{VIEWER}.curves.charts"
    page.press("+")
    spans = page.value(f"{charts}.map(c => [c.plot.scales.x.min, c.plot.scales.x.max])")
    assert len({tuple(span) for span in spans}) == 1  # of all charts
    assert spans[0] == pytest.approx([1.0 - 6.5 / 4, 1.0 + 6.5 / 4])
    page.press("0")
    assert page.value(f"{charts}[0].plot.scales.x.max") == pytest.approx(6.5)
    page.press("ArrowRight")
    assert page.value(NOW) == pytest.approx(1.065)
    assert "at 1.065 s" in page.value(f"{plot}.ariaLabel")


def test_a_run_without_a_model_has_its_curves_alone_also_as_a_ghost(page, run, folder):
    times = np.linspace(0.0, 2.0, 50)
    signals = {f"tank.level_{n}": np.sin(n * times) for n in range(8)}
    metadata = {"complete": True, "fmus": {"tank": {"model": "Tank"}}}
    alone = show_source(FakeRecording(times, signals, metadata), "tank", summary=Summary())
    page.open(write_view([alone], folder / "alone.html"))
    page.wait("document.querySelectorAll('.pv-chart .pv-legend').length === 6")
    assert page.value("document.querySelector('.pv-picture').checkVisibility()") is False
    titles = "[...document.querySelectorAll('.pv-chart')].map(c => c.dataset.title)"
    assert page.value(titles) == list(signals)[:6]
    recorded = shown_run(run, name="run")
    show(page, write_view([recorded, alone], folder / "ghost.html"))
    assert page.value(f"{STAGE}.figures.length") == 1
    assert page.errors == []


def test_a_click_in_a_curve_moves_the_time_and_the_scene(page, view):
    look(page, view)
    before = picture(page)
    box = page.value(
        "(b => [b.x, b.y, b.width, b.height])"
        "(document.querySelector('.pv-chart .u-over').getBoundingClientRect())"
    )
    page.click_at(box[0] + 0.6 * box[2], box[1] + 0.5 * box[3])
    assert page.value(NOW) == pytest.approx(0.6 * 6.5, abs=0.1)
    assert changed_dots(before, picture(page)) > 300
    found = "[...document.querySelectorAll('.pv-needle')]"
    needles = page.value(f"{found}.map(n => n.getBoundingClientRect().x)")
    assert len(needles) == 4
    assert max(needles) - min(needles) < 2  # in all charts


def test_any_signal_is_found_and_added(page, view, run):
    look(page, view)
    page.click(".pv-search")
    page.type("jac[2,")
    page.wait("document.querySelectorAll('.pv-found li').length === 7")
    page.press("ArrowDown")
    page.press("Enter")
    chart = "document.querySelector('.pv-chart[data-title=\"plant.jac[2,2]\"]')"
    page.wait(f"{chart} !== null && {chart}.querySelector('canvas') !== null")
    seek(page, 3.0)
    shown = page.value(f"{chart}.querySelector('.pv-reading').textContent")
    expected = Recording.open(run)["plant.jac[2,2]"][3000]
    assert float(shown.replace("\u2212", "-")) == pytest.approx(expected, rel=1e-3, abs=1e-4)
    page.click('.pv-chart[data-title="plant.jac[2,2]"] .pv-close')
    assert page.value(chart) is None


def test_the_ghost_is_seen_and_has_curves(page, compared):
    show(page, compared)
    seek(page, 2.0)
    hands = [poses_at(page, [2.0], figure)[0, -4, :3] for figure in (0, 1)]
    assert np.linalg.norm(hands[0] - hands[1]) == pytest.approx(0.06, abs=0.003)
    with_ghost = picture(page)
    page.press("g")
    without = picture(page)
    assert changed_dots(with_ghost, without) > 150
    page.press("g")
    assert changed_dots(with_ghost, picture(page)) == 0
    series = f"{VIEWER}.curves.charts.map(({{title, plot}}) => [title, plot.series.length - 1])"
    assert page.value(series)[:2] == [["Distance to the other run", 1], ["Tracking error", 2]]
    assert "ghost: other" in page.value("document.querySelector('.pv-header').textContent")


def test_a_link_names_an_instant_and_a_camera(page, view):
    show(page, view, place="#t=2.3&cam=front", width=720, height=400)
    assert page.value(NOW) == pytest.approx(2.3)
    assert page.value(f"{STAGE}.viewpoint.name") == "front"
    page.value("location.hash = '#t=4&cam=top'")
    page.wait(f"{NOW} === 4 && {STAGE}.viewpoint.name === 'top'")
    seek(page, 1.25)
    page.wait("location.hash === '#t=1.25&cam=top'")
    before = picture(page)
    page.drag((200, 200), (320, 180))
    assert changed_dots(before, picture(page)) > 1000
    page.wait("location.hash.split(',').length === 6")
    page.wait(f"{STAGE}.idle")  # the camera has come to rest
    time.sleep(0.5)  # and the address with it
    address = page.value("location.hash")
    eye = page.value(f"{STAGE}.camera.position.toArray()")
    page.value(f"location.hash = '#t=4&cam=top'; location.hash = {address!r}")
    page.wait(f"{NOW} === 1.25")
    assert page.value(f"{STAGE}.camera.position.toArray()") == pytest.approx(eye, abs=2e-3)


def test_on_a_phone_all_is_in_reach(page, compared):
    show(page, compared, width=390, height=844)
    for width, height in ((390, 844), (360, 640), (844, 390)):
        page.resize(width, height)
        page.value("new Promise(requestAnimationFrame)")
        check_reach(page, width, height)


def check_reach(page: Page, width: int, height: int) -> None:
    """Check that what is needed is in the window, and that nothing sticks out."""
    assert page.value("document.documentElement.scrollWidth") <= width
    assert page.value("document.documentElement.scrollHeight") <= height
    for part in (".pv-play", ".pv-scrub", ".pv-search", ".pv-camera", ".pv-layers summary"):
        box = page.value(
            f"(b => [b.left, b.right, b.top, b.bottom])"
            f"(document.querySelector('{part}').getBoundingClientRect())"
        )
        assert -1 <= box[0] < box[1] <= width + 1, part
        assert -1 <= box[2] < box[3] <= height + 1, part
    shown = page.value("document.querySelector('.pv-stage').clientHeight")
    assert shown >= 0.25 * height


def test_crafted_names_are_shown_as_text(page, folder):
    crafted = MODEL.replace('name="fixed"', f'name="{escape(CRAFTED)}"')
    model = mujoco.MjModel.from_xml_string(crafted)
    time_axis = 0.01 * np.arange(50)
    signals = {"plant.qpos": np.tile(model.qpos0, (50, 1)), ODD: time_axis,
               "controller.pos_cmd": np.ones((50, 3))}  # fmt: skip
    metadata = {"complete": True, "scenario": ODD, "purpose": HEBREW, "coupling": ODD,
                "row_times": [0.1], "row_names": [ODD]}  # fmt: skip
    texts = dict.fromkeys(signals, ODD)
    source = FakeRecording(time_axis, signals, metadata, texts, texts)
    criterion = {"name": ODD, "value": 1.0, "bound": 2.0, "unit": ODD, "ok": False}
    summary = {"criteria": [criterion], "limits": {"torque_share": [0.5]}}
    whole = Shown(ODD, source, describe_model(model), summary=Summary.read(summary))
    runs = [whole, replace(whole, name=f"{ODD} 2")]
    show(page, write_view(runs, folder / "crafted.html"), place=f"#cam={CRAFTED}")
    page.click(".pv-search")
    page.type("onerror")
    page.wait("document.querySelectorAll('.pv-found li').length > 0")
    page.press("Enter")
    page.wait("document.querySelectorAll('.pv-chart').length > 0")
    page.click(".pv-tab:last-child")
    for part in (".pv-header", ".pv-facts", ".pv-cameras", ".pv-labels", ".pv-layers", ".pv-chart"):
        text = page.value(f"document.querySelector('{part}').textContent")
        assert "onerror=window.ran=1" in text, part
    assert page.value("document.querySelectorAll('img').length") == 0
    assert page.value("window.ran") is None
    assert page.errors == []
    page.click(".pv-tab")
    check_reach(page, 820, 560)
    assert page.value(HIDDEN) is False


def test_a_page_in_a_frame_of_the_site_follows_its_colours(page, view):
    frame = "document.querySelector('iframe').contentWindow"
    shown = f"{frame}.document.querySelector('.pv')?.dataset.scheme"
    outer = view.with_name("outer.html")
    inner = f'<iframe src="{view.name}" width=800></iframe>'
    outer.write_text(f'<body data-md-color-scheme="slate">{inner}')
    handler = partial(SimpleHTTPRequestHandler, directory=view.parent)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:  # files have no common origin
        Thread(target=server.serve_forever, daemon=True).start()
        page.visit(f"http://127.0.0.1:{server.server_port}/{outer.name}", scheme="light")
        page.wait(f"{shown} === 'dark'")
        page.value("document.body.dataset.mdColorScheme = 'default'")
        page.wait(f"{shown} === 'light'")
        server.shutdown()
