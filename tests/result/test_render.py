"""Pictures: motion, video, contact sheet, and the messages where they cannot be drawn."""

import os
import re
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from bounded import children, is_alive, line_of, ran, running, wait_until
from fake_recording import HOME, made_up_run
from fault_support import write_scenario
from forked import command
from panda_cosim import InputError, Recording
from panda_cosim.assets.fields import Array
from panda_cosim.fmus.atomic import check_replaceable
from panda_cosim.result.judging.holds import events, find_holds
from panda_cosim.result.pictures import gl
from panda_cosim.result.pictures.gl import RenderError
from panda_cosim.result.pictures.motion import BLOCK_QUAT, interpolate_qpos, key_moments, slerp
from panda_cosim.result.pictures.offscreen import OffscreenRenderer, describe_gl
from panda_cosim.result.pictures.sheet import contact_sheet
from panda_cosim.result.pictures.video import find_ffmpeg, render_video
from panda_cosim.task.criteria import HELD_FORCE
from regress_support import record

EXACT = 1e-12  # of rounding alone

needs_gl = pytest.mark.usefixtures("backend")


@pytest.fixture(scope="module")
def backend():
    """What draws here."""
    try:
        return describe_gl()
    except RenderError as error:
        return pytest.skip(f"no OpenGL: {error}")


def about_x(angle: float) -> Array:
    """Return the quaternion (w, x, y, z) of a turn about x [rad]."""
    return np.array([np.cos(angle / 2), np.sin(angle / 2), 0, 0])


def ffmpeg_says(path: Path) -> str:
    """Return ffmpeg's description of a video, decoded from end to end."""
    command = [find_ffmpeg(), "-i", str(path), "-f", "null", "-"]
    return ran(command).stderr


# --- motion between the rows


@given(st.floats(-6.0, 6.0), st.floats(-3.1, 3.1), st.floats(0.0, 1.0), st.booleans())
def test_slerp_turns_at_constant_speed_the_shorter_way_round(start, turn, share, negated):
    ends = about_x(start)[None], about_x(start + turn)[None]
    quat = slerp(ends[0], -ends[1] if negated else ends[1], np.array([share]))[0]
    assert np.linalg.norm(quat) == pytest.approx(1, abs=EXACT)
    assert abs(quat @ about_x(start + share * turn)) == pytest.approx(1, abs=EXACT)


def test_between_rows_joints_move_linearly_and_the_block_turns():
    qpos = np.tile(HOME, (2, 1)).astype(float)
    qpos[1, 0] = 0.4
    qpos[1, 9:12] = 0.6, 0.3, 0.25
    qpos[1, BLOCK_QUAT] = -about_x(1.0)
    half = interpolate_qpos(np.array([0.0, 0.001]), qpos, np.array([0.0005]))[0]
    assert half[0] == pytest.approx(0.2)
    np.testing.assert_allclose(half[9:12], (0.5, 0.05, 0.15), atol=EXACT)
    np.testing.assert_allclose(half[BLOCK_QUAT], about_x(0.5), atol=EXACT)


# --- key moments of a run


def test_the_key_moments_tell_the_story_in_order_at_the_instants_of_the_summary():
    run = made_up_run(6501)
    found = key_moments(run, 12)
    assert len(found) == 12
    assert found == sorted(found, key=lambda moment: moment.time)
    moments = {moment.label: moment.time for moment in found if moment.label}
    assert [*moments] == ["start", "reach", "grasp", "lift", "carry", "set down", "release",
                          "leave", "end"]  # fmt: skip
    happened = events(cast(Recording, run), find_holds(run))
    assert happened["grasp"] == run.time[np.argmax(run["plant.contact_force"] > HELD_FORCE)]
    for label, event in (("grasp", "grasp"), ("lift", "lift"), ("set down", "release_command"),
                         ("release", "release")):  # fmt: skip
        assert moments[label] == happened[event]


# --- video and contact sheet


@needs_gl
def test_the_video_can_be_decoded_and_has_the_frames_size_and_codec(tmp_path):
    seen: list[tuple[int, int]] = []
    path = tmp_path / "new" / "video.mp4"
    options = {"width": 160, "height": 120, "progress": lambda *each: seen.append(each)}
    render_video(made_up_run(201), path, **options)
    said = ffmpeg_says(path)
    assert re.search(r"Video: h264 .*yuv420p.* 160x120.* 30 fps", said), said
    assert re.findall(r"frame= *(\d+)", said)[-1] == "6"
    assert seen == [(frame, 6) for frame in range(1, 7)]
    assert [file.name for file in path.parent.iterdir()] == ["video.mp4"]
    check_replaceable(path)  # has the mark of what may be drawn again


@needs_gl
def test_a_run_names_each_file_once_it_is_there_and_the_video_last(tmp_path):
    write_scenario(tmp_path / "short")
    program = [sys.executable, "-m", "panda_cosim", "run", "short", "--out", "run", "--fps", "15"]
    pipes = {"capture_output": False, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    done = ran(program, code=None, cwd=tmp_path, **pipes)
    lines = ("run/recording.parquet  ", "run/summary.json  ", "run/view.html  ", "run/plot.png  ",
             "run/contact_sheet.png  ", "Drawing the video", "run/video.mp4  ")  # fmt: skip
    places = [done.stdout.index(line) for line in lines]
    assert places == sorted(places)
    assert "--no-video skips it" in done.stdout
    assert " 15 fps" in ffmpeg_says(tmp_path / "run" / "video.mp4")


@needs_gl
def test_frames_follow_the_recording(tmp_path):
    run = made_up_run(101)
    with closing(OffscreenRenderer("tabletop", 160, 120)) as renderer:
        images = renderer.frames(run["plant.qpos"][[0, 0, -1]])
        first, again, last = (image.astype(int) for image in images)
    assert first.std() > 10, "the image is not blank"
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - last).max() > 50, "the arm has moved"


@needs_gl
def test_a_video_cut_short_leaves_no_file_and_keeps_the_old_one(tmp_path):
    path = tmp_path / "video.mp4"
    path.write_bytes(b"the old one")

    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_video(made_up_run(201), path, width=64, height=48, progress=stop)
    assert [file.name for file in tmp_path.iterdir()] == ["video.mp4"]
    assert path.read_bytes() == b"the old one"


LONG_VIDEO = f"""
import sys
import numpy as np
from panda_cosim.result.pictures.video import render_video
class Run(dict):
    time, path = np.array([0.0, 100.0]), "nowhere"
    metadata = {{"scene": "tabletop"}}
    columns = property(list)
run = Run({{f"plant.qpos[{{i}}]": np.full(2, q) for i, q in enumerate({HOME}, 1)}})
say = lambda done, total: print(done, flush=True)
render_video(run, sys.argv[1], width=64, height=48, progress=say)
"""


@needs_gl
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_no_process_outlives_the_one_that_draws(tmp_path, number):
    path = tmp_path / "video.mp4"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with running([sys.executable, "-c", LONG_VIDEO, path], **pipes) as child:
        assert line_of(child).strip() == b"1"
        group = [child.pid, *children(child.pid)]
        assert len(group) >= 3, "this process, the one that draws, and ffmpeg"
        child.send_signal(number)
        child.wait(timeout=30)
    wait_until(lambda: not any(map(is_alive, group)))
    assert not path.exists()


@needs_gl
def test_the_contact_sheet_is_a_grid_of_four_columns(tmp_path):
    path = contact_sheet(made_up_run(2001), tmp_path / "sheet.png")
    check_replaceable(path)
    with Image.open(path) as sheet:
        assert sheet.format == "PNG"
        assert sheet.size[0] > 4 * 480
        assert 3 * 360 < sheet.size[1] < 4 * 360
        pixels = np.asarray(sheet)
    assert pixels[150:400, 100:400].std() > 10, "the first image is not blank"
    assert [file.name for file in tmp_path.iterdir()] == ["sheet.png"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 63}, r"width: value 63 px; must be even, from 16 to 8192 px"),
        ({"height": 0}, r"height: value 0 px; must be even, from 16"),
        ({"fps": 0.0}, r"fps: value 0.0; must be a number from 1 to 240"),
        ({"path": "video.avi"}, r"video.avi: a video's name must end in .mp4"),
    ],
)
def test_a_bad_option_is_refused_with_its_bounds(tmp_path, options, message):
    path = tmp_path / options.pop("path", "video.mp4")
    with pytest.raises(InputError, match=message):
        render_video(made_up_run(101), path, **options)


def test_a_recording_that_lacks_a_signal_is_refused_before_the_video(tmp_path):
    values = {"time": np.arange(3.0), **{f"plant.qpos[{i}]": np.zeros(3) for i in range(1, 16)}}
    record(tmp_path / "run", values)
    refused = command("render", "run", cwd=tmp_path, code=InputError.exit_code)
    assert "plant.qpos" in refused.stderr
    assert refused.stderr.count("\n") == 1
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["recording.parquet"]


# --- OpenGL


@pytest.fixture
def no_backend(monkeypatch, tmp_path):
    """Have a Python that ends before it can draw, no screen and no choice."""
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexit 7\n")
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.usefixtures("no_backend")
@pytest.mark.parametrize(("backend", "libraries", "message"), [
    ("", [], r"tried egl, osmesa\): .*apt-get install libegl1 libgl1$"),
    ("egl", ["EGL"], r"apt-get install libgl1 \(or unset MUJOCO_GL"),
    ("egl", ["EGL", "GL"], r"egl says 'its process ended with code 7'"),
    ("osmesa", [], r"tried osmesa\): .*apt-get install libosmesa6"),
    ("off", [], r"switches drawing off"),
])  # fmt: skip
def test_mujoco_gl_is_honoured_and_what_is_missing_named(monkeypatch, backend, libraries, message):
    monkeypatch.setenv("MUJOCO_GL", backend)
    monkeypatch.setattr(gl, "find_library", lambda name: name if name in libraries else None)
    with pytest.raises(RenderError, match=message):
        OffscreenRenderer("tabletop", 16, 16)


def test_what_needs_no_picture_needs_no_opengl(tmp_path):
    """MuJoCo's import would fail, or ask for a screen: the command line lets it load no backend."""
    scenario = write_scenario(tmp_path / "scenario", 0.01)
    run = [sys.executable, "-m", "panda_cosim", "run", scenario, "--no-video"]
    environment = {k: v for k, v in os.environ.items() if "DISPLAY" not in k}
    done = ran([*run, "--out", tmp_path / "run"], env=environment | {"MUJOCO_GL": "vulkan"})
    assert "Warning" not in done.stderr
