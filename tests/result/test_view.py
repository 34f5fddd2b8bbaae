"""What the view's page is made of: packed columns, thinned runs, the model, words."""

import base64
import hashlib
import json
import re
import shutil
import zlib
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bounded import ran
from fake_recording import FakeRecording
from forked import command
from panda_cosim import InputError, Recording, shipped_scenarios
from panda_cosim.result.judging.summary import Summary
from panda_cosim.result.thinning import ALL_ROWS, POSES, STRETCHES, Thinning
from panda_cosim.result.view import columns, run
from panda_cosim.result.view.columns import encode
from panda_cosim.result.view.model import describe as describe_model
from panda_cosim.result.view.run import Shown, describe
from regress_support import columns as one_joint
from regress_support import record
from view_support import MODEL, decoded, run_scenario_outside

NUMBERS = st.floats(-1e6, 1e6) | st.sampled_from([np.nan, np.inf, -np.inf, 0.0])
COLUMNS = hnp.arrays(np.float64, st.integers(1, 60), elements=NUMBERS)


@given(COLUMNS)
def test_columns_come_back_within_half_a_step_and_gaps_as_gaps(values):
    block = encode([values], [1e-3])
    (back,) = decoded(block)
    finite = np.isfinite(values)
    assert np.array_equal(np.isnan(back), ~finite)
    # Beside the rounding there is that of adding an offset of up to 1e6.
    assert np.abs(back - values)[finite].max(initial=0.0) <= 0.5001 * block["steps"][0] + 1e-9
    json.dumps(block, allow_nan=False)


@given(hnp.arrays(np.float64, st.integers(2, 60), elements=st.floats(allow_nan=False)))
def test_any_numbers_at_all_are_packed(values):
    block = encode([values, np.zeros(len(values))], [None, None])
    assert all(0.0 < step < np.inf for step in block["steps"])
    assert np.array_equal(decoded(block)[1], np.zeros(len(values)))


def test_a_short_run_is_kept_whole():
    time = 0.001 * np.arange(ALL_ROWS)
    kept = Thinning.of(time)
    assert kept.poses(time) is time
    assert kept.curve(time) is time
    assert kept.words() == ""


@pytest.mark.parametrize("rows", [ALL_ROWS + 1, 400_000])
def test_a_long_run_keeps_its_ends_and_every_extreme(rows):
    time = 0.001 * np.arange(rows)
    values = np.sin(time)
    values[[7, rows // 3, rows - 2]] = 40.0, -50.0, 60.0  # single ticks
    kept = Thinning.of(time)
    poses, curve = kept.poses(kept.time), kept.curve(values)
    assert poses[0] == time[0]
    assert poses[-1] == time[-1]
    assert len(poses) <= POSES + 1
    assert len(curve) == len(kept.curve_time) == 2 * STRETCHES
    assert (np.diff(kept.curve_time) > 0).all()
    assert {40.0, -50.0, 60.0} <= set(curve.tolist())
    assert f"Thinned from {rows} rows" in kept.words()


def test_uneven_instants_are_kept_as_they_are():
    time = np.array([0.0, 0.001, 0.5, 0.501])
    assert np.allclose(decoded(columns.describe_time(time)["block"])[0], time, atol=1e-6)
    even = {"start": 0.5, "step": pytest.approx(0.001), "rows": 9}
    assert columns.describe_time(0.5 + 0.001 * np.arange(9)) == even


def test_the_model_has_all_shapes_and_reduces_textures():
    described = describe_model(mujoco.MjModel.from_xml_string(MODEL))
    kinds = [shape["kind"] for body in described["bodies"] for shape in body["shapes"]]
    expected = ["plane", "mesh", "box", "capsule", "ellipsoid", "mesh", "sphere", "cylinder"]
    assert sorted(kinds) == sorted(expected)  # the sphere of group 3 is hidden; that is the site
    assert len(described["meshes"]) == 2
    (texture,) = described["textures"]  # of 300 by 200 pixels, 3 by 2 of which make one
    pixels = np.frombuffer(zlib.decompress(base64.b64decode(texture["pixels"])), np.uint8)
    image = pixels.reshape(texture["height"], texture["width"], 4)
    assert image.shape == (100, 100, 4)
    lower_left, upper_left = image[0, 0].tolist(), image[-1, 0].tolist()
    assert (upper_left, lower_left) == ([255, 0, 0, 255], [0, 0, 255, 255])
    green = described["bodies"][2]["shapes"][0]
    # Five sides of that cube are green, the sixth is grey.
    assert green["rgba"] == pytest.approx([1 / 12, 11 / 12, 1 / 12, 1.0], abs=0.01)
    joints = [joint["kind"] for body in described["bodies"] for joint in body["joints"]]
    assert joints == ["slide", "hinge", "hinge", "ball", "free"]
    assert [camera["name"] for camera in described["cameras"]] == ["fixed", "on the arm"]
    assert len(json.dumps(described)) < 20_000


def made_up(rows: int = 200, **metadata: Any) -> FakeRecording:
    """A run of the foreign model with one more signal."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    time = 0.001 * np.arange(rows)
    qpos = np.tile(model.qpos0, (rows, 1))
    signals = {"plant.qpos": qpos, "other.y": np.sin(30 * time)}
    return FakeRecording(time, signals, {"complete": True, **metadata})


def foreign(source: FakeRecording) -> Shown:
    """That run with its model."""
    model = describe_model(mujoco.MjModel.from_xml_string(MODEL))
    return Shown("foreign", source, model, summary=Summary())


class Rounded(FakeRecording):
    """A run whose hand is rounded, as in a reference."""

    quanta: ClassVar = {f"plant.hand_xpos[{axis}]": 1e-4 for axis in (1, 2, 3)}


def test_what_a_references_rounding_explains_is_no_difference():
    run = made_up()
    place = 0.1 * np.sin(np.outer(run.time, (1.0, 2.0, 3.0)))
    rounded = {"plant.hand_xpos": np.round(place, 4), "controller.pos_cmd": place}
    ghost = Rounded(run.time, run.signals | rounded, {"complete": True})
    run.signals["plant.hand_xpos"] = place
    own, again = describe(foreign(run), "key", ghost), describe(foreign(ghost), "key")
    gap = next(s for s in own["signals"] if s["name"] == "distance to the other run")
    assert not decoded(gap)[0].any()
    assert "tracking error" not in [signal["name"] for signal in again["signals"]]


def test_a_foreign_run_with_nothing_but_positions_is_described():
    document = describe(foreign(made_up()), "key")
    assert document["masses"] is None
    assert document["curves"] == []
    assert list(document["roles"]) == ["qpos"]
    assert document["verdict"] == {"state": "plain", "words": "no success criteria"}
    assert [signal["name"] for signal in document["signals"]] == ["plant.qpos", "other.y"]
    diverged = made_up()
    diverged.signals["plant.qpos"][50:, 0] = np.nan
    diverged.signals["other.y"][:] = np.inf
    json.dumps([document, describe(foreign(diverged), "key")], allow_nan=False)


def test_what_cannot_be_shown_is_refused_with_the_reason():
    source = made_up()
    source.signals.clear()
    with pytest.raises(InputError, match=r"foreign: 0 columns of plant.qpos; .* has 14 positions"):
        describe(foreign(source), "key")
    with pytest.raises(InputError, match="foreign: the recording has no rows"):
        describe(foreign(made_up(0)), "key")


def test_columns_of_different_units_are_not_in_one_plot():
    units = {"plant.qvel[1]": "m/s", "plant.qvel[2]": "rad/s", "plant.qvel[3]": "rad/s"}
    plots = run.shown_curves(run.CURVES, units)
    assert [plot["columns"] for plot in plots] == [[*units][:1], [*units][1:]]


# The built page code is what its source says: rebuilt to the same code, and tested.


VIEW = Path(__file__).parents[2] / "src" / "panda_cosim" / "result" / "view"
BUILT = ("LICENSES.txt", "code.json", "differences.css", "sweep.css", "view.css")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A copy of the source with the locked libraries in it."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("no node and npm here")
    folder = tmp_path_factory.mktemp("build") / "view" / "source"
    shutil.copytree(VIEW / "source", folder, ignore=shutil.ignore_patterns("node_modules"))
    shutil.copy(VIEW.parent / "palette.json", folder.parents[1])
    ran(["npm", "ci", "--prefer-offline"], cwd=folder)
    return folder


def content(file: Path) -> dict[str, bytes]:
    """A built file; code as it runs, since another zlib may deflate it to other bytes."""
    if file.suffix != ".json":
        return {file.name: file.read_bytes()}
    codes = {}
    for name, built in json.loads(file.read_text()).items():
        packed = base64.b64decode(built.get("deflated", ""))
        codes[name] = zlib.decompress(packed) if packed else built["text"].encode()
        digest = hashlib.sha256(codes[name]).digest()  # by which the pages' policy allows it
        assert base64.b64encode(digest).decode() == built["sha256"]
    return codes


def luminance(colour: str) -> float:
    """Relative luminance of WCAG 2."""
    parts = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


PALETTE = json.loads((VIEW.parent / "palette.json").read_text(encoding="utf-8"))
TEXTS = {  # on each paper
    "paper": "ink muted accent good bad warn", "back": "ink muted", "soft": "ink muted bad",
    "accent": "on-accent", "good-soft": "good", "bad-soft": "ink muted bad", "warn-soft": "warn",
    "bad": "paper", "ghost-soft": "accent",
}  # fmt: skip


@pytest.mark.parametrize("scheme", ["light", "dark", "print"])
def test_texts_are_read_on_their_papers(scheme):
    bright = {name: luminance(colour) for name, colour in PALETTE[scheme].items()}
    for paper, names in TEXTS.items():
        for name in names.split():
            low, high = sorted((bright[name], bright[paper]))
            assert (high + 0.05) / (low + 0.05) >= 4.5, (name, paper)


def test_pages_and_plots_have_the_colours_of_the_palette():
    style = (VIEW.parent / "pictures" / "plot.mplstyle").read_text(encoding="utf-8")
    assert {*re.findall("#[0-9a-f]{6}", style)} <= {*PALETTE["light"].values()}
    for sheet in ("view", "differences", "sweep"):
        text = (VIEW / "page" / f"{sheet}.css").read_text(encoding="utf-8")
        for scheme in PALETTE.values():
            assert ";".join(f"--{name}: {colour}" for name, colour in scheme.items()) in text


@pytest.mark.long
def test_rebuilding_gives_the_same_code(source, tmp_path):
    ran(["node", "build.mjs", str(tmp_path)], cwd=source)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(BUILT)
    for name in BUILT:
        assert content(tmp_path / name) == content(VIEW / "page" / name), name


@pytest.mark.long
def test_the_page_codes_own_tests_pass(source):
    """Its types are checked with those of Python, by `.ci/run`."""
    ran(["npm", "test"], cwd=source)


def test_the_bundle_carries_its_licences_and_asks_nobody():
    notice = (VIEW / "page" / "LICENSES.txt").read_text(encoding="utf-8")
    versions = json.loads((VIEW / "source" / "package.json").read_text())["dependencies"]
    bundles = content(VIEW / "page" / "code.json")
    for name, version in versions.items():
        assert f"{name} {version}" in notice
        assert f"{name} {version}".encode() in bundles["view"]
    assert notice.count("Permission is hereby granted") == len(versions)
    assert notice.encode() in bundles["view"]
    for word in ("fetch(", "WebSocket", "innerHTML", "eval(", "importScripts"):
        ours = [path for path in (VIEW / "source/src").rglob("*.ts") if word in path.read_text()]
        # A live run's page speaks to its server; its policy allows no other, a file's none.
        assert [path.name for path in ours] == (["link.ts"] if word == "WebSocket" else []), word


# The command `panda-cosim view`.


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return run_scenario_outside(tmp_path_factory.mktemp("runs") / "first")


view = partial(command, "view")


def shown(path: Path) -> str:
    """What a page says that it shows first."""
    text = path.read_text(encoding="utf-8")
    found = re.search(r'data-view="&quot;show&quot;">(.*?)</script>', text)
    assert found is not None
    return found[1]


def test_the_page_lies_in_the_run_or_where_it_is_wanted(recorded, tmp_path):
    done = view(recorded)
    assert done.returncode == 0, done.stderr
    assert str(recorded / "view.html") in done.stdout
    assert shown(recorded / "view.html") == '{"runs":["first"]}'
    assert view(Recording.open(recorded).path, "--out", tmp_path / "a" / "b.html").returncode == 0
    assert (tmp_path / "a" / "b.html").is_file()


def test_a_scenario_of_ones_own_has_its_reference(tmp_path):
    own = shutil.copytree(shipped_scenarios()["push"], tmp_path / "own")
    recorded = run_scenario_outside(tmp_path / "run", scenario=own)
    out = tmp_path / "view.html"
    for against in ("reference", own):
        done = view(recorded, "--against", against, "--out", out)
        assert done.returncode == 0, done.stderr
        assert shown(out) == '{"runs":["run","reference"]}'
    (own / "reference.parquet").unlink()
    done = view(recorded, "--against", "reference", "--out", out)
    assert done.returncode == 2
    assert f"regress {own} --update" in " ".join(done.stderr.split())


def test_what_cannot_be_shown_is_one_line_and_nothing_is_written(recorded, tmp_path):
    record(tmp_path / "small", one_joint())  # of a scenario that is not shipped
    out = tmp_path / "view.html"
    for arguments, words in (
        ((tmp_path / "nothing",), "must be a recording or its folder"),
        ((tmp_path / "small",), "1 columns of plant.qpos"),
        ((recorded, "--against", tmp_path / "small"), "1 columns of plant.qpos"),
        ((tmp_path / "small", "--against", "reference"), "'small' is not one of the shipped ones"),
        ((recorded, "--against", tmp_path / "reference.parquet"), "must be a recording or its"),
    ):
        done = view(*arguments, "--out", out)
        assert done.returncode == 2, arguments
        assert words in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
        assert not out.exists()
