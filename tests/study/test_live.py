"""`panda-cosim live`: sessions replay bit for bit; only clients with the token get in."""

import io
import json
import math
import time
import zipfile
from dataclasses import replace
from urllib.parse import urlsplit

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from browser import Page
from forked import QUIET, command
from live_support import READY, asked, live, told, viewer, wait_to_act
from panda_cosim import Recording, Session, Trajectory, TrajectoryTable, load_scenario
from panda_cosim.study.live.page import offset_of
from panda_cosim.task.mismatch import Mismatch

RUN = "PandaView.viewer.runs[0]"
SEEN = """((place) => {
    const { stage } = PandaView.viewer;
    const box = stage.element.getBoundingClientRect();
    stage.draw(performance.now());
    place.project(stage.camera);
    return [box.x + (place.x + 1) / 2 * box.width, box.y + (1 - place.y) / 2 * box.height];
})"""  # where a place in the scene is in the window
BODY = """((name, z) => {
    const body = PandaView.viewer.stage.figures[0].bodies.find((each) => each.name === name);
    return body.localToWorld(body.position.clone().set(0, 0, z));
})"""
# Software draws for a tenth of a second, in which the page does nothing else.
CALM = (
    "{const draw = requestAnimationFrame; requestAnimationFrame = (f) => setTimeout(draw, 200, f);}"
)
HAND, BLOCK = f"{SEEN}({BODY}('hand', 0.05))", f"{SEEN}({BODY}('obj', 0.03))"
WAYPOINT = 5  # row of the table, from 1: above the table, far from the block


def newest(page: Page, column: str) -> float:
    """A column's latest value in the page."""
    return float(page.value(f"{RUN}.newest('{column}')"))


def mouse(page: Page, kind: str, x: float, y: float) -> None:
    """Press, move or release the mouse."""
    pressed = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
    page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **pressed)


def pause(page: Page) -> None:
    """Pause the run, once the page knows that it runs."""
    page.wait("document.querySelector('.pv-run').textContent === 'Pause'")
    page.click(".pv-run")
    page.wait("document.querySelector('.pv-run').textContent === 'Run'")


def drag(page: Page, body: str, signal: str, by: tuple[float, float]) -> float:
    """Take a body with the mouse while the run is paused, push it while it goes on [N]."""
    page.wait("document.querySelector('.pv-run').textContent === 'Run'")
    x, y = page.value(body)
    mouse(page, "mouseMoved", x, y)
    mouse(page, "mousePressed", x, y)
    for share in (0.4, 0.7, 1.0):
        mouse(page, "mouseMoved", x + share * by[0], y + share * by[1])
        time.sleep(0.05)
    page.press(" ")
    force = f"Math.hypot(...[1, 2, 3].map((i) => {RUN}.newest(`{signal}[${{i}}]`)))"
    page.wait(f"{force} > 0.5")
    size = float(page.value(force))
    label = "document.querySelector('.pv-newtons:not([hidden])')"
    assert page.value(f"/^[0-9.]+ N$/.test({label}.textContent)")
    at = newest(page, "time")
    page.wait(f"{RUN}.newest('time') > {at} + 0.03")
    mouse(page, "mouseReleased", x + by[0], y + by[1])
    page.wait(f"{force} === 0")
    page.wait(f"{label} === null")
    return size


def drag_a_waypoint(page: Page) -> list[float]:
    """Move a waypoint with the mouse; returns how far the page has it from where it was [m]."""
    bead = f"PandaView.viewer.runs[0].about.waypoints[{WAYPOINT - 1}].place"
    before = page.value(bead)
    origin = "PandaView.viewer.stage.camera.position.clone()"
    start = page.value(f"{SEEN}({origin}.set(...{bead}))")
    page.drag(tuple(start), (start[0] + 20, start[1] - 12))
    page.wait(f"{bead}[2] > {before[2]} + 0.003")
    return [now - then for now, then in zip(page.value(bead), before, strict=True)]


def move_the_slider(page: Page, name: str) -> float:
    """Click into a parameter's slider; returns the value that the run has then."""
    slider = f"document.querySelector('input[data-name=\"{name}\"]')"
    before = float(page.value(f"{slider}.value"))
    page.value(f"{slider}.scrollIntoView({{block: 'center'}})")
    box = page.value(f"(b => [b.x, b.y, b.width, b.height])({slider}.getBoundingClientRect())")
    page.click_at(box[0] + 0.4 * box[2], box[1] + box[3] / 2)
    now = float(page.value(f"{slider}.value"))
    assert now != before
    return now


def check_names(page: Page) -> None:
    """Buttons and curves have their names, and those of one row an axis."""
    unlike = """[...document.querySelectorAll('.pv button')].filter((b) => b.textContent &&
        b.ariaLabel && !b.ariaLabel.toLowerCase().includes(b.textContent.toLowerCase()))"""
    assert page.value(f"{unlike}.map((b) => b.ariaLabel)") == []
    names = "[...document.querySelectorAll('.pv-name > span:nth-child(2)')]"
    page.wait(f"{names}.length > 10")
    legends = set(page.value(f"{names}.map((name) => name.textContent)"))
    assert {"x", "y", "z", "joint 1", "joint 7"} <= legends
    scales = "PandaView.viewer.curves.charts.map((chart) => chart.plot.scales.x)"
    axes = page.value(f"{scales}.map(({{min, max}}) => [min, max])")
    assert axes
    assert all(axis == [0, 1] for axis in axes)  # s


def test_what_is_done_in_the_page_is_run_again_to_the_same_bits(page, tmp_path):
    with live(tmp_path / "run", "--speed", "0.1", "--paused") as server:
        page.visit(server.address, 720, 400)  # software draws, and large pictures take it long
        page.wait(READY)
        check_names(page)
        page.value(CALM)
        page.wait("document.querySelector('.pv-place') !== null")  # it knows the waypoints
        way = drag_a_waypoint(page)
        place = [f"plant.qpos[{i}]" for i in (10, 11, 12)]  # the block's centre [m]
        before = [newest(page, axis) for axis in place]
        assert drag(page, BLOCK, "plant.block_force", (0, -100)) <= 60.0 * 0.18 + 1e-9  # [N]
        assert math.dist(before, [newest(page, axis) for axis in place]) > 1e-3
        pause(page)
        assert drag(page, HAND, "plant.push_force", (90, 0)) <= 80.0 + 1e-9  # [N]
        page.click(".pv-tab:last-child")
        page.value("document.querySelector('[data-name=\"controller.use_reference\"]').click()")
        gain = move_the_slider(page, "controller.kp")
        pause(page)
        at = newest(page, "time")
        page.press(".")
        page.wait(f"{RUN}.newest('time') > {at}")
        assert newest(page, "time") == pytest.approx(at + 0.001, abs=1e-9)
        page.value(
            "(s => { s.value = 'jacobi'; s.dispatchEvent(new Event('change')); })"
            "(document.querySelector('.pv-coupling'))"
        )
        page.press(" ")
        page.wait(f"{RUN}.newest('time') > {at} + 0.05")
        assert len(page.value(f"{RUN}.series('plant.qpos[1]').then(s => [...s.values])")) > 10
        assert page.errors == []
        assert {urlsplit(address).netloc for address in page.requests} <= {server.host, ""}
        server.end()
    journal = [json.loads(line) for line in (tmp_path / "run/session.jsonl").open()][1:]
    acts = {(line["action"], line.get("name")) for line in journal}
    forces = ("plant.push_force", "plant.block_force")
    assert {(what, name) for what in ("set", "release") for name in forces} < acts
    assert {("set", "controller.kp"), ("set_coupling", None), ("end", None)} < acts
    assert {"tick", "value"} < {
        key for line in journal if line.get("name") == "controller.use_reference" for key in line
    }
    row = load_scenario("pick_and_place").table.rows[WAYPOINT - 1]
    to = next(line["position"] for line in journal if line["action"] == "move_waypoint")
    np.testing.assert_allclose(np.subtract(to, row.position), way, atol=2e-6)  # m; not turned
    assert next(x["value"] for x in journal if x.get("name") == "controller.kp") == gain
    done = command("replay", tmp_path / "run", "--out", tmp_path / "again", *QUIET)
    assert done.returncode in (0, 3), done.stderr
    before, again = (Recording.open(tmp_path / name) for name in ("run", "again"))
    assert before.columns == again.columns
    for name in before.columns:
        assert np.array_equal(before[name].view("u8"), again[name].view("u8")), name


def test_a_run_ends_with_its_verdict_and_nothing_is_journalled_after_it(tmp_path):
    with live(tmp_path / "run", "--paused") as server, viewer(server) as socket:
        for _ in range(7):  # 6.5 s
            socket.send('{"do": "step", "ticks": 1000}')
        over = told(socket, "status", lambda status: status["over"])["status"]
        journal = server.folder / "session.jsonl"
        before = journal.read_text()
        socket.send('{"do": "set", "name": "plant.push_force", "value": [0, 9, 0]}')
        assert "the scenario is over" in str(told(socket, "refused"))
    criteria = json.loads((tmp_path / "run" / "summary.json").read_text())["criteria"]
    assert all(criterion["ok"] for criterion in criteria)
    assert over["message"].endswith(f"success: {len(criteria)} of {len(criteria)} criteria hold")
    assert journal.read_text() == before
    assert json.loads(before.splitlines()[-1]) == {"tick": 6500, "action": "end"}


def test_restart_begins_another_run_and_keeps_the_one_before(tmp_path):
    with live(tmp_path / "run", "--paused") as server, viewer(server) as socket:
        socket.send('{"do": "step", "ticks": 100}')
        socket.send('{"do": "restart"}')
        told(socket, "status", lambda status: status["run"] == 2)
    assert Recording.open(tmp_path / "run").time[-1] == pytest.approx(0.1, abs=1e-9)
    assert (tmp_path / "run-2" / "session.jsonl").is_file()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with live(tmp_path_factory.mktemp("live") / "run", "--speed", "0.05") as opened:
        yield opened


def test_only_the_token_gets_the_page(server):
    status, body = asked(server, f"/?token={server.token}")
    assert status == 200
    assert b"connect-src 'self'" in body
    for path in ("/", "/?token=", f"/?token={server.token[:-1]}", "/live", "/?token=%ff",
                 f"/?token=x&token={server.token}", f"/?token={server.token}x"):  # fmt: skip
        assert asked(server, path) == (403, b""), path
    assert asked(server, f"/other?token={server.token}")[0] == 404


def test_a_socket_is_the_pages_own(server):
    address = f"ws://{server.host}/live?token="
    ours = f"http://{server.host}"
    refused = [(server.token, "http://evil.example"), (server.token, None), ("wrong", ours),
               (server.token, "null"),
               (server.token, f"http://localhost.evil.example:{server.host[-5:]}")]  # fmt: skip
    for token, origin in refused:
        with pytest.raises(InvalidStatus) as error, connect(address + token, origin=origin):
            pass
        assert error.value.response.status_code == 403
    with connect(address + server.token, origin=ours) as socket:
        assert len(socket.recv(20)) % 8 == 0


def test_several_look_and_one_acts(server):
    with viewer(server) as first, viewer(server) as second:
        assert told(first, "status")["status"]["acts"] is True
        assert told(second, "status")["status"]["acts"] is False
        second.send('{"do": "set", "name": "controller.kp", "value": 3}')
        assert "another page has control" in str(told(second, "refused"))
        first.send('{"do": "set", "name": "controller.kp", "value": -3}')
        assert "controller.kp" in str(told(first, "refused"))
        first.close()
        wait_to_act(second)
    assert '"set"' not in (server.folder / "session.jsonl").read_text()


def test_a_moved_waypoint_is_kept_and_taken_home(tmp_path):
    scenario = load_scenario("pick_and_place")
    turned = ("--set", "plant.block_yaw=0.3")  # rad; offsets to the block turn with it
    with live(tmp_path / "run", "--speed", "0.05", *turned) as server:
        with viewer(server) as socket:
            place = told(socket, "plan")["plan"]["waypoints"][4]["place"]
            to = [place[0] + 0.02, place[1], place[2] + 0.01]
            socket.send('{"do": "step", "ticks": 20}')
            socket.send(json.dumps({"do": "waypoint", "row": 4, "position": to}))
            moved = told(socket, "plan")["plan"]["waypoints"][4]["place"]
            socket.send('{"do": "keep", "name": "mine"}')
            told(socket, "status", lambda status: "mine" in status["message"])
            socket.send('{"do": "keep", "name": "mine"}')
            assert "exists" in str(told(socket, "refused"))
        status, archive = asked(server, f"/session.zip?token={server.token}")
        assert asked(server, "/session.zip") == (403, b"")
    np.testing.assert_allclose(moved, to, atol=1e-6)  # m
    kept = load_scenario(tmp_path / "mine").table.rows[4].position
    way = np.subtract(kept, scenario.table.rows[4].position)
    turn = np.array([0.02 * math.cos(0.3), -0.02 * math.sin(0.3), 0.01])
    np.testing.assert_allclose(way, turn, atol=2e-6)  # m
    assert status == 200
    kept = ("session.jsonl", "scenario/scenario.toml", "scenario/trajectory.csv")
    names = zipfile.ZipFile(io.BytesIO(archive)).namelist()
    assert {*names} == {f"run/{name}" for name in kept}


def test_a_waypoint_stays_where_it_is_dropped_whatever_the_camera_sees():
    wrong = Mismatch(block_position_error=(0.01, 0.0, 0.0), block_yaw_error=0.3)
    session = Session(replace(load_scenario("pick_and_place"), mismatch=wrong))
    row = next(i for i, row in enumerate(session.table.rows) if row.frame == "target")
    place = session.trajectory.positions[row] + (0.1, 0.05, 0.0)
    position = tuple(offset_of(session, row, place))
    moved = replace(session.table.rows[row], position=position)
    dropped = Trajectory.from_table(TrajectoryTable((moved, session.table.rows[-1])),
                                    session.start_pose, align=True)  # fmt: skip
    assert dropped.positions[0] == pytest.approx(place, abs=2e-6)
