"""Pictures: the motion they show, the video and the sheet, and what is said where none can be."""

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from panda_cosim.fmus.errors import CosimError, InputError
from panda_cosim.scenarios.pictures import gl, meshes, render
from panda_cosim.scenarios.pictures.motion import (
    BLOCK_QUAT,
    FloatArray,
    closed_spans,
    describe_run,
    frame_times,
    interpolate_qpos,
    key_moments,
    slerp,
)
from PIL import Image
from regress_support import record

REPOSITORY = Path(__file__).parents[1]
HOME = (0, 0, 0, -1.57079, 0, 1.57079, -0.7853, 0.04, 0.04, 0.4, -0.2, 0.05, 1, 0, 0, 0)
EXACT = 1e-12  # of rounding alone

needs_gl = pytest.mark.skipif(
    gl.describe_gl().backend is None, reason=f"no OpenGL: {gl.describe_gl().detail}"
)
needs_menagerie = pytest.mark.skipif(
    meshes.find_menagerie() is None, reason="MENAGERIE_ROOT names no folder with Menagerie's Panda"
)


@dataclass
class FakeRecording:
    """What pictures need of a recording."""

    time: FloatArray
    signals: dict[str, FloatArray]
    metadata: dict[str, Any] = field(default_factory=lambda: {"scene": "tabletop"})

    def __getitem__(self, name: str) -> FloatArray:
        return self.signals[name]


def made_up_run(duration: float = 1.0, step: float = 0.001) -> FakeRecording:
    """Return a run in which joint 1 turns and the block is lifted between 30 and 80 %."""
    ticks = round(duration / step)
    time_ = np.arange(ticks + 1) * step
    share = time_ / duration
    held = (share >= 0.3) & (share < 0.8)
    qpos = np.tile(HOME, (len(time_), 1)).astype(float)
    qpos[:, 0] = share
    qpos[:, 11] += np.where(held, 0.2 * (share - 0.3), 0.0)
    return FakeRecording(
        time_, {"plant.qpos": qpos, "controller.grip_cmd": np.where(held, 0.0, 0.08)}
    )


def about_x(angle: float) -> FloatArray:
    """Return the quaternion (w, x, y, z) of a turn about x [rad]."""
    return np.array([np.cos(angle / 2), np.sin(angle / 2), 0, 0])


def ffmpeg_says(path: Path) -> str:
    """Return ffmpeg's description of a video, decoded from end to end."""
    command = [render.find_ffmpeg(), "-i", str(path), "-f", "null", "-"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stderr


# --- motion between the rows


@given(st.floats(-6.0, 6.0), st.floats(-3.1, 3.1), st.floats(0.0, 1.0), st.booleans())
def test_slerp_turns_at_constant_speed_the_shorter_way_round(
    start: float, turn: float, share: float, negated: bool
) -> None:
    ends = about_x(start)[None], about_x(start + turn)[None]
    quat = slerp(ends[0], -ends[1] if negated else ends[1], np.array([share]))[0]
    assert np.linalg.norm(quat) == pytest.approx(1, abs=EXACT)
    assert abs(quat @ about_x(start + share * turn)) == pytest.approx(1, abs=EXACT)


def test_slerp_gives_its_ends_back() -> None:
    generator = np.random.default_rng(1)
    ends = generator.normal(size=(2, 50, 4))
    ends /= np.linalg.norm(ends, axis=2, keepdims=True)
    begin = slerp(ends[0], ends[1], np.zeros(50))
    end = slerp(ends[0], ends[1], np.ones(50))
    np.testing.assert_allclose(np.abs(np.sum(begin * ends[0], axis=1)), 1, atol=EXACT)
    np.testing.assert_allclose(np.abs(np.sum(end * ends[1], axis=1)), 1, atol=EXACT)


def test_between_rows_joints_move_linearly_and_the_block_turns() -> None:
    qpos = np.tile(HOME, (2, 1)).astype(float)
    qpos[1, 0] = 0.4
    qpos[1, 9:12] = 0.6, 0.3, 0.25
    qpos[1, BLOCK_QUAT] = -about_x(1.0)
    half = interpolate_qpos(np.array([0.0, 0.001]), qpos, np.array([0.0005]))[0]
    assert half[0] == pytest.approx(0.2)
    np.testing.assert_allclose(half[9:12], (0.5, 0.05, 0.15), atol=EXACT)
    np.testing.assert_allclose(half[BLOCK_QUAT], about_x(0.5), atol=EXACT)


def test_on_rows_and_beyond_the_ends_a_row_itself_is_shown() -> None:
    run = made_up_run(0.01)
    rows = run["plant.qpos"]
    np.testing.assert_allclose(interpolate_qpos(run.time, rows, run.time), rows, atol=EXACT)
    beyond = interpolate_qpos(run.time, rows, np.array([-1.0, 9.0]))
    np.testing.assert_allclose(beyond, rows[[0, -1]], atol=EXACT)
    alone = interpolate_qpos(run.time[:1], rows[:1], np.array([0.0, 1.0]))
    np.testing.assert_array_equal(alone, rows[[0, 0]])


def test_a_video_of_the_task_has_390_frames_a_sixtieth_apart() -> None:
    times = frame_times(np.arange(6501) * 0.001, 60)
    assert len(times) == 390
    np.testing.assert_array_equal(times, np.arange(390) / 60)


def test_the_last_frame_is_never_beyond_the_last_row() -> None:
    for ticks in range(1, 200):
        time_ = np.arange(ticks + 1) * 0.001
        assert frame_times(time_, 60)[-1] <= time_[-1]
    assert len(frame_times(np.zeros(1), 60)) == 1


# --- the story of a run


def test_the_key_moments_tell_the_story_in_order() -> None:
    run = made_up_run(6.5)
    moments = key_moments(run, 12)
    times = [moment.time for moment in moments]
    labels = [moment.label for moment in moments if moment.label]
    assert len(moments) == 12
    assert times == sorted(times)
    assert labels == [
        "start",
        "reach",
        "grasp",
        "lift",
        "carry",
        "place",
        "release",
        "leave",
        "end",
    ]


@pytest.mark.parametrize("count", [2, 3, 5, 9, 20])
def test_there_are_as_many_key_moments_as_asked_for(count: int) -> None:
    moments = key_moments(made_up_run(6.5), count)
    assert len(moments) == count
    assert (moments[0].time, moments[-1].time) == (0.0, 6.5)


def test_a_run_that_broke_off_at_once_still_has_a_moment() -> None:
    run = made_up_run()
    run.time = run.time[:1]
    run.signals = {name: values[:1] for name, values in run.signals.items()}
    assert [moment.label for moment in key_moments(run, 12)] == ["start"]


def test_the_gripper_counts_as_closed_until_it_opens_or_the_run_ends() -> None:
    time_ = np.arange(6) * 1.0
    assert closed_spans(time_, np.array([0.08, 0, 0, 0.08, 0, 0])) == [(1.0, 3.0), (4.0, 5.0)]
    assert closed_spans(time_, np.full(6, 0.08)) == []
    # A wider grip for the approach does not close it yet.
    assert closed_spans(time_, np.array([0.08, 0.07, 0.035, 0.035, 0.07, 0.08])) == [(2.0, 4.0)]


def test_the_title_says_that_a_run_is_incomplete() -> None:
    run = made_up_run()
    run.metadata = {"scenario": "pick_and_place", "complete": False, "reason": "Ctrl-C"}
    assert describe_run(run) == ("pick and place", "1.00 s · incomplete: Ctrl-C")


# --- video and contact sheet


@needs_gl
def test_the_video_can_be_decoded_and_has_the_frames_size_and_codec(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    path = render.render_video(
        made_up_run(0.2),
        tmp_path / "new" / "video.mp4",
        width=160,
        height=120,
        progress=lambda done, total: seen.append((done, total)),
    )
    said = ffmpeg_says(path)
    assert re.search(r"Video: h264 .*yuv420p.* 160x120.* 60 fps", said), said
    assert re.findall(r"frame= *(\d+)", said)[-1] == "12"
    assert seen == [(frame, 12) for frame in range(1, 13)]
    assert [file.name for file in path.parent.iterdir()] == ["video.mp4"]


@needs_gl
def test_frames_follow_the_recording(tmp_path: Path) -> None:
    run = made_up_run(0.1)
    with render.Stage("tabletop", 160, 120, "overview") as stage:
        first = stage.draw(run["plant.qpos"][0]).astype(int)
        again = stage.draw(run["plant.qpos"][0]).astype(int)
        last = stage.draw(run["plant.qpos"][-1]).astype(int)
    assert first.std() > 10, "the image is not blank"
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - last).max() > 50, "the arm has moved"


@needs_gl
def test_two_stages_can_be_open_at_once() -> None:
    qpos = np.array(HOME, dtype=float)
    with (
        render.Stage("tabletop", 64, 48, "overview") as one,
        render.Stage("tutorial", 80, 60, "overview") as other,
    ):
        before = one.draw(qpos).copy()
        assert other.draw(qpos).shape == (60, 80, 3)
        np.testing.assert_array_equal(one.draw(qpos), before)


@needs_gl
@pytest.mark.parametrize("failure", [KeyboardInterrupt, ValueError])
def test_a_video_cut_short_leaves_no_file_and_keeps_the_old_one(
    tmp_path: Path, failure: type[BaseException]
) -> None:
    path = tmp_path / "video.mp4"
    path.write_bytes(b"the old one")

    def stop(done: int, total: int) -> None:
        if done == 2:
            raise failure

    with pytest.raises(failure):
        render.render_video(made_up_run(0.2), path, width=64, height=48, progress=stop)
    assert [file.name for file in tmp_path.iterdir()] == ["video.mp4"]
    assert path.read_bytes() == b"the old one"


LONG_VIDEO = f"""
import sys
import numpy as np
from panda_cosim.scenarios.pictures.render import render_video
class Run(dict):
    time = np.array([0.0, 100.0])
    metadata = {{"scene": "tabletop"}}
run = Run({{"plant.qpos": np.array([{HOME}, {HOME}], dtype=float)}})
say = lambda done, total: print(done, flush=True)
render_video(run, sys.argv[1], width=64, height=48, progress=say)
"""


@needs_gl
@pytest.mark.skipif(sys.platform == "win32", reason="sends POSIX signals")
def test_ctrl_c_in_the_terminal_leaves_no_half_video(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    # A session of its own, so that ffmpeg gets the signal as well, as it does in a terminal.
    child = subprocess.Popen(
        [sys.executable, "-c", LONG_VIDEO, str(path)],
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert child.stdout is not None
    assert child.stdout.readline().strip() == "1"
    os.killpg(child.pid, signal.SIGINT)
    _, said = child.communicate(timeout=30)
    assert "KeyboardInterrupt" in said.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


@needs_gl
def test_a_failure_of_ffmpeg_says_what_ffmpeg_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(render, "FFMPEG_ARGS", ["-preset", "no-such-preset"])
    with pytest.raises(gl.RenderError, match=r"no video: .*preset"):
        render.render_video(made_up_run(2.0), tmp_path / "video.mp4", width=64, height=48)
    assert list(tmp_path.iterdir()) == []


@needs_gl
def test_the_contact_sheet_is_a_grid_of_four_columns(tmp_path: Path) -> None:
    path = render.contact_sheet(made_up_run(2.0), tmp_path / "sheet.png", count=6)
    with Image.open(path) as sheet:
        assert sheet.format == "PNG"
        assert sheet.size[0] > 4 * 480
        assert 2 * 360 < sheet.size[1] < 3 * 360
        pixels = np.asarray(sheet)
    assert pixels[150:400, 100:400].std() > 10, "the first image is not blank"
    assert [file.name for file in tmp_path.iterdir()] == ["sheet.png"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 63}, r"width: value 63 px; must be even"),
        ({"height": 0}, r"height: value 0 px; must be even, and 16"),
        ({"fps": 0.0}, r"fps: value 0; must be from 1 to 240"),
        ({"fps": float("nan")}, r"fps: value nan; must be"),
        ({"path": "video.avi"}, r"video.avi: a video's name must end in .mp4"),
    ],
)
def test_a_bad_option_is_refused_with_its_bounds(
    tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    path = tmp_path / options.pop("path", "video.mp4")
    with pytest.raises(InputError, match=message):
        render.render_video(made_up_run(0.1), path, **options)


@needs_gl
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"camera": "overvew"}, r"camera: value 'overvew'.*did you mean 'overview'"),
        ({"width": 10000}, r"width: value 10000 px; must be from 1 to"),
    ],
)
def test_a_bad_view_is_refused(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        render.render_video(made_up_run(0.1), tmp_path / "video.mp4", **options)


@needs_gl
def test_a_recording_of_an_unknown_scene_is_refused(tmp_path: Path) -> None:
    run = made_up_run(0.1)
    run.metadata = {"scene": "kitchen"}
    with pytest.raises(InputError, match=r"scene: value 'kitchen'; must be one of tabletop"):
        render.contact_sheet(run, tmp_path / "sheet.png")


def test_a_recording_without_rows_is_refused(tmp_path: Path) -> None:
    run = made_up_run(0.1)
    run.time = run.time[:0]
    run.signals = {name: values[:0] for name, values in run.signals.items()}
    with pytest.raises(InputError, match="has no rows"):
        render.contact_sheet(run, tmp_path / "sheet.png")
    with pytest.raises(InputError, match="has no rows"):
        render.render_video(run, tmp_path / "video.mp4")


def test_a_recording_that_lacks_a_signal_is_refused_before_the_video(tmp_path: Path) -> None:
    values = {"time": np.arange(3.0), **{f"plant.qpos[{i}]": np.zeros(3) for i in range(1, 17)}}
    record(tmp_path / "run", values)
    command = [sys.executable, "-m", "panda_cosim", "render", "run"]
    refused = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert refused.returncode == InputError.exit_code
    assert "no signal 'controller.grip_cmd'" in refused.stderr
    assert refused.stderr.count("\n") == 1
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["recording.parquet"]


# --- ffmpeg


def test_the_ffmpeg_of_imageio_stands_in_for_a_missing_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    bundled = imageio_ffmpeg.get_ffmpeg_exe()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert render.find_ffmpeg() == bundled
    useless = tmp_path / "ffmpeg"
    useless.write_text("#!/bin/sh\nexit 1\n")
    useless.chmod(0o755)
    assert render.find_ffmpeg() == bundled, "an ffmpeg without x264 is no use"


def test_where_there_is_no_ffmpeg_the_message_names_a_package(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(gl.RenderError, match="pip install imageio-ffmpeg"):
        render.find_ffmpeg()


# --- OpenGL


@pytest.fixture
def untried() -> Any:
    """Forget which backends were tried, before and after a test that changes the environment."""
    gl._try_all.cache_clear()
    yield
    gl._try_all.cache_clear()


def no_gl(test: Any) -> Any:
    """Mark a test of what is said where nothing can be drawn."""
    linux = pytest.mark.skipif(sys.platform != "linux", reason="the backends of Linux")
    return linux(pytest.mark.usefixtures("untried")(test))


@no_gl
def test_the_message_names_the_packages_that_are_missing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(gl, "PROBE", "raise OSError('no library')")
    monkeypatch.setattr(gl, "find_library", lambda name: None)
    with pytest.raises(gl.RenderError, match=r"apt-get install libegl1 libgl1$") as caught:
        render.render_video(made_up_run(0.1), tmp_path / "video.mp4")
    assert "tried egl, osmesa" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, CosimError)
    assert list(tmp_path.iterdir()) == []


@no_gl
def test_only_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(gl, "PROBE", "raise OSError('no library')")
    monkeypatch.setattr(gl, "find_library", lambda name: "lib" if name == "EGL" else None)
    report = gl.describe_gl()
    assert report.backend is None
    assert "apt-get install libgl1 (or unset MUJOCO_GL" in report.detail


@no_gl
def test_mujoco_gl_is_honoured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(gl, "PROBE", "raise OSError('no library')")
    monkeypatch.setattr(gl, "find_library", lambda name: None)
    report = gl.describe_gl()
    assert [probe.backend for probe in report.probes] == ["osmesa"]
    assert "apt-get install libosmesa6" in report.detail


@no_gl
def test_a_wrong_pyopengl_platform_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setenv("PYOPENGL_PLATFORM", "glx")
    assert "unset PYOPENGL_PLATFORM, which is 'glx'" in gl.describe_gl().detail


@no_gl
def test_glfw_without_a_screen_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert "glfw needs a screen" in gl.describe_gl().detail


@no_gl
@pytest.mark.parametrize(
    ("value", "message"),
    [("off", "switches drawing off"), ("vulkan", "must be one of egl, osmesa")],
)
def test_a_value_of_mujoco_gl_that_names_no_backend(
    monkeypatch: pytest.MonkeyPatch, value: str, message: str
) -> None:
    monkeypatch.setenv("MUJOCO_GL", value)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(gl.RenderError, match=message):
        gl.choose_backend()


@no_gl
def test_a_probe_that_crashes_or_hangs_does_no_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl, "PROBE", "import os; os.abort()")
    assert not gl._probe("egl").works
    monkeypatch.setattr(gl, "PROBE", "import time; time.sleep(60)")
    monkeypatch.setattr(gl, "PROBE_SECONDS", 0.2)
    begin = time.perf_counter()
    assert "TimeoutExpired" in gl._probe("egl").detail
    assert time.perf_counter() - begin < 10


@needs_gl
@pytest.mark.skipif(sys.platform != "linux", reason="a terminal without a screen is tried there")
def test_pictures_are_drawn_even_if_mujoco_was_imported_for_another_backend() -> None:
    code = (
        "import mujoco, numpy as np\n"
        "from panda_cosim.scenarios.pictures.stage import Stage\n"
        "with Stage('tabletop', 32, 24, 'overview') as stage:\n"
        f"    assert stage.draw(np.array({HOME}, dtype=float)).std() > 5"
    )
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, env=environment, check=True)


# --- meshes


@needs_menagerie
def test_dressed_in_meshes_the_scene_has_the_same_positions() -> None:
    mujoco = pytest.importorskip("mujoco")
    plain, dressed = meshes.load_look("tabletop"), meshes.load_look("tabletop", "always")
    assert dressed.nq == plain.nq == 16
    assert dressed.nmeshface > 100_000
    for index in range(plain.njnt):
        assert dressed.joint(index).name == plain.joint(index).name
        assert dressed.joint(index).qposadr == plain.joint(index).qposadr
    places = []
    for model in (plain, dressed):
        data = mujoco.MjData(model)
        data.qpos[:] = HOME
        mujoco.mj_kinematics(model, data)
        places.append([data.body(name).xpos.copy() for name in ("hand", "right_finger", "obj")])
    np.testing.assert_allclose(places[0], places[1], atol=EXACT)


@needs_menagerie
@needs_gl
def test_the_arm_looks_different_in_meshes() -> None:
    qpos = np.array(HOME, dtype=float)
    images = []
    for choice in ("never", "auto"):
        with render.Stage("tabletop", 160, 120, "overview", choice) as stage:
            images.append(stage.draw(qpos).astype(int))
    assert np.abs(images[0] - images[1]).max() > 30


def test_meshes_that_are_asked_for_and_missing_are_an_error_that_says_how_to_get_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    assert meshes.find_menagerie() is None
    assert meshes.load_look("tabletop", "auto").nq == 16
    with pytest.raises(InputError, match="MENAGERIE_ROOT"):
        meshes.load_look("tabletop", "always")


def test_an_unknown_choice_of_meshes_is_refused() -> None:
    with pytest.raises(InputError, match=r"meshes: value 'alwys'.*did you mean 'always'"):
        meshes.load_look("tabletop", "alwys")  # type: ignore[arg-type]
