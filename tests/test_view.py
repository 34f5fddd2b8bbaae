"""What the view's page is made of: packed columns, thinned runs, the model, words."""

from __future__ import annotations

import base64
import json
import zlib
from typing import Any, ClassVar

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from panda_cosim.fmus.errors import InputError
from panda_cosim.result.judging.criterion import Criterion
from panda_cosim.result.judging.definitions import DEFINITIONS
from panda_cosim.result.judging.summary import Summary
from panda_cosim.show.view import columns, run
from panda_cosim.show.view.columns import Thinning, encode
from panda_cosim.show.view.model import describe as describe_model
from panda_cosim.show.view.page import Inline
from panda_cosim.show.view.run import Shown, describe
from view_support import MODEL, MadeUp, as_columns, decoded

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
    time = 0.001 * np.arange(columns.ALL_ROWS)
    kept = Thinning.of(time)
    assert kept.poses(time) is time
    assert kept.curve(time) is time
    assert kept.words() == ""


@pytest.mark.parametrize("rows", [columns.ALL_ROWS + 1, 400_000])
def test_a_long_run_keeps_its_ends_and_every_extreme(rows):
    time = 0.001 * np.arange(rows)
    values = np.sin(time)
    values[[7, rows // 3, rows - 2]] = 40.0, -50.0, 60.0  # single ticks
    kept = Thinning.of(time)
    poses, curve = kept.pose_time, kept.curve(values)
    assert poses[0] == time[0]
    assert poses[-1] == time[-1]
    assert len(poses) <= columns.POSES + 1
    assert len(curve) == len(kept.curve_time) == 2 * columns.STRETCHES
    assert (np.diff(kept.curve_time) > 0).all()
    assert {40.0, -50.0, 60.0} <= set(curve.tolist())
    assert f"Thinned from {rows} rows" in kept.words()


def test_uneven_instants_are_kept_as_they_are():
    time = np.array([0.0, 0.001, 0.5, 0.501])
    assert np.allclose(decoded(columns.describe_time(time)["block"])[0], time, atol=1e-6)
    assert columns.describe_time(0.5 + 0.001 * np.arange(9)) == {
        "start": 0.5,
        "step": pytest.approx(0.001),
        "rows": 9,
    }


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


def made_up(rows: int = 200, **metadata: Any) -> MadeUp:
    """A run of the foreign model with one more signal."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    time = 0.001 * np.arange(rows)
    qpos = np.tile(model.qpos0, (rows, 1))
    values = as_columns({"time": time, "plant.qpos": qpos, "other.y": np.sin(30 * time)})
    return MadeUp(values, {"complete": True, **metadata})


def foreign(source: MadeUp, name: str = "foreign", **summary: Any) -> Shown:
    """That run with its model."""
    model = describe_model(mujoco.MjModel.from_xml_string(MODEL))
    return Shown(name, source, model, summary=Summary.read(summary))


class Rounded(MadeUp):
    """A run whose hand is rounded, as in a reference."""

    quanta: ClassVar = {f"plant.hand_xpos[{axis}]": 1e-4 for axis in (1, 2, 3)}


def test_what_a_references_rounding_explains_is_no_difference():
    run = made_up()
    place = 0.1 * np.sin(np.outer(run.time, (1.0, 2.0, 3.0)))
    ghost = Rounded({**run.values, **as_columns({"plant.hand_xpos": np.round(place, 4)})})
    ghost.values |= as_columns({"controller.pos_cmd": place})  # type: ignore[operator]
    run.values |= as_columns({"plant.hand_xpos": place})  # type: ignore[operator]
    own, rounded = describe(foreign(run), "key", ghost), describe(foreign(ghost), "key")
    gap = next(s for s in own["signals"] if s["name"] == "distance to the other run")
    assert not decoded(gap)[0].any()
    assert "tracking error" not in [signal["name"] for signal in rounded["signals"]]


def test_a_foreign_run_with_nothing_but_positions_is_described():
    document = describe(foreign(made_up()), "key")
    assert document["masses"] is None
    assert document["curves"] == []
    assert list(document["roles"]) == ["qpos"]
    assert document["verdict"] == {"state": "plain", "words": "no success criteria"}
    assert [signal["name"] for signal in document["signals"]] == ["plant.qpos", "other.y"]
    json.dumps(document, allow_nan=False)


def test_what_cannot_be_shown_is_refused_with_the_reason():
    source = made_up()
    source.values = {"time": source.values["time"]}
    with pytest.raises(InputError, match=r"foreign: 0 columns of plant.qpos; .* has 14 positions"):
        describe(foreign(source), "key")
    with pytest.raises(InputError, match="foreign: the recording has no rows"):
        describe(foreign(made_up(0)), "key")


def test_a_run_that_diverged_is_described():
    source = made_up()
    source.values["plant.qpos[1]"][50:] = np.nan  # type: ignore[index]
    source.values["other.y"][:] = np.inf
    document = describe(foreign(source), "key")
    json.dumps(document, allow_nan=False)


def test_criteria_and_limits_say_what_they_mean():
    names = ("max_slip", "my own")
    judged = [Criterion.judge(name, 1.0, 2.0, "m", "below") for name in names]
    rows = run.criteria_of(Summary(criteria=tuple(judged)))
    assert [row["words"] for row in rows] == [DEFINITIONS["success.max_slip"].text, ""]
    (limit,) = run.limits_of(Summary(limits={"torque_share": [0.5]}))
    assert limit["words"] == DEFINITIONS["limits.torque_share"].text


def test_a_notebook_gets_a_frame_with_the_page():
    inline = Inline("<p title=\"a 'b'\">&amp;</p>", 500)
    html = inline._repr_html_()
    assert html.count("<") == 2
    assert 'srcdoc="&lt;p title=&quot;a &#x27;b&#x27;&quot;&gt;&amp;amp;&lt;/p&gt;"' in html


def test_columns_of_different_units_are_not_in_one_plot():
    units = {"plant.qvel[1]": "m/s", "plant.qvel[2]": "rad/s", "plant.qvel[3]": "rad/s"}
    plots = run.shown_curves(run.CURVES, units)
    assert [plot["columns"] for plot in plots] == [[*units][:1], [*units][1:]]
