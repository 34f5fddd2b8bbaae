"""The page of curves of a run."""

from pathlib import Path
from typing import cast

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from fake_recording import FakeRecording
from fake_recording import made_up_run as task_run
from panda_cosim import Recording
from panda_cosim.assets.franka import QD_MAX, QDDD_MAX
from panda_cosim.fmus.atomic import check_replaceable
from panda_cosim.fmus.errors import InputError
from panda_cosim.fmus.interface.tables import INTERFACES
from panda_cosim.result.judging.summary import Summary
from panda_cosim.result.pictures.panels import DPI, ROWS_DRAWN, read_curves
from panda_cosim.result.pictures.plot import SIZE, VERDICTS, draw, draw_run, draw_signals, save
from panda_cosim.result.thinning import drawn_rows
from refusals import refused

PEAK = 0.0125  # [m] error of one row of the made-up run


def made_up_run(rows: int = 1001) -> FakeRecording:
    """Return a run whose hand is 12.5 mm off its command in one row, and joint 4 at half speed."""
    run = task_run(rows)
    run.metadata = {"scenario": "made_up", "row_times": [0.0, 0.5, 7.0]}
    half, signals = rows // 2, run.signals
    signals["plant.hand_xpos"][rows // 3, 1] += PEAK
    signals["plant.qvel"][:, 3] = -0.5 * QD_MAX[3]
    signals["controller.qvel_ref"][half:, 1] = 2e-6 * QDDD_MAX[1]  # a step of twice the limit
    signals["plant.actuator_force"][1:, 1] = 30.0  # N.m, what it holds
    signals["plant.actuator_force"][half:, 5] = 0.3  # N.m, in a tick
    signals["plant.contact_force"][:] = 0.0
    return run


def texts(run: FakeRecording) -> list[str]:
    """Return all that is written on the page."""
    figure = draw_run(run)
    assert all(axes.lines for axes in figure.axes)
    found = [text.get_text() for text in figure.texts]
    for axes in figure.axes:
        found += [*legend_of(axes), axes.get_title(loc="left")]
    return found


def test_each_hold_of_the_block_is_shaded_and_closed_fingers_alone_are_not():
    run = made_up_run()
    curves = read_curves(cast(Recording, run))
    assert not curves.holds  # the fingers close on nothing
    run.signals["plant.contact_force"][400:500] = 20.0
    run.signals["plant.contact_force"][600:750] = 20.0
    shaded = [patch.get_window_extent().x0 for patch in draw_run(run).axes[0].patches]
    assert len(shaded) == 2
    assert shaded[0] < shaded[1]


def test_the_page_is_a_png_of_the_size_that_is_promised(tmp_path):
    path = tmp_path / "new" / "plot.png"
    save(draw([made_up_run()]), path)
    with Image.open(path) as page:
        assert page.format == "PNG"
        assert page.size == tuple(round(side * DPI) for side in SIZE)
        assert np.asarray(page.convert("L")).std() > 10, "the page is not blank"
    assert [file.name for file in path.parent.iterdir()] == ["plot.png"]


def test_the_page_says_the_error_and_the_largest_shares_of_the_limits():
    written = texts(made_up_run())
    rms = 1000 * PEAK / np.sqrt(1001)
    assert f"RMS {rms:.3g} mm" in written
    assert "max 12.5 mm at 0.33 s" in written
    assert "Joint velocities, 50 % (joint 4) of the limit at most" in written
    assert "Jerk of the reference, 200 % (joint 2) of the limit at most" in written
    assert "Torque rates, 30 % (joint 6) of the limit at most" in written
    assert "made up" in written


def test_a_law_without_a_joint_reference_is_drawn_all_the_same():
    run = made_up_run()
    del run.signals["controller.qvel_ref"]
    assert not any(text.startswith("Jerk") for text in texts(run))


def test_the_page_has_the_purpose_and_the_verdict():
    run = made_up_run(2)
    run.metadata["purpose"] = "Draws a line"
    missed = {"name": "max_slip", "value": 0.003, "bound": 0.002, "unit": "m"}
    summary = Summary.read({"criteria": [missed | {"value": 0.001}, missed]})
    drawn = {text.get_text(): text.get_color() for text in draw_run(run, summary).texts}
    assert any(text.startswith("Draws a line · ") for text in drawn)
    (colour,) = (drawn[text] for text in drawn if text.startswith("Success criteria missed"))
    assert colour == VERDICTS["bad"]


@pytest.mark.parametrize(("rows", "name"), [(1, r"a $\frac$ b"), (2, "$x$ and $y$")])
def test_a_run_that_broke_off_at_once_is_drawn_and_a_dollar_is_no_formula(rows, name):
    run = made_up_run(rows)
    run.metadata = {"scenario": name, "complete": False, "reason": name}
    figure = draw([run])
    assert len(figure._repr_png_()) > 10_000
    written = [text.get_text() for text in figure.texts]
    assert name in written
    assert any(f"incomplete: {name}" in text for text in written)


def test_a_long_run_is_thinned_and_keeps_its_peaks():
    values = np.zeros(1_000_000)
    values[123_457], values[777_777] = 1.0, -1.0
    rows = drawn_rows([values], ROWS_DRAWN)
    assert len(rows) <= ROWS_DRAWN + 2
    assert np.all(np.diff(rows) > 0)
    assert {123_457, 777_777} <= set(rows.tolist())
    assert {0, 999_999} <= set(rows.tolist())
    assert drawn_rows([values[:100]], ROWS_DRAWN).tolist() == list(range(100))


def test_a_signal_of_another_shape_is_refused():
    run = made_up_run(3)
    run.signals["plant.qvel"] = run.signals["plant.qvel"][:, :7]
    with pytest.raises(InputError, match=r"plant.qvel: shape \(7,\) per row; must be \(15,\)"):
        draw([run])


# Figures of chosen signals.


def pendulum(name: str = "swing", scale: float = 1.0) -> FakeRecording:
    """Return a run of a model of one's own: two joints, a body, and a signal of noise."""
    time = np.arange(501) * 0.001
    qpos = np.column_stack((scale * np.sin(time), np.cos(time), time, 1e-21 * time))
    units = ["rad", "rad", "m", "m"]
    run = FakeRecording(time, {"plant.qpos": qpos, "plant.noise": 1e-21 * time}, {"scenario": name})
    run.units = dict(zip(run.columns, [*units, "N"], strict=True))
    run.addresses = {"plant.shoulder.pos": "plant.qpos[1]", "plant.elbow.pos": "plant.qpos[2]"}
    run.path = Path("runs", name, "recording.parquet")
    return run


def legend_of(axes: Axes) -> list[str]:
    """Return the names of a panel's curves."""
    legend = axes.get_legend()
    return [text.get_text() for text in legend.get_texts()] if legend else [""]


def panels(figure: Figure) -> dict[str, dict[str, np.ndarray]]:
    """Return the drawn values by the panels' titles and units, and the curves' labels."""
    return {
        f"{axes.get_title(loc='left')} {axes.get_ylabel()}": {
            name: line.get_ydata() for name, line in zip(legend_of(axes), axes.lines, strict=False)
        }
        for axes in figure.axes
        if axes.get_visible()
    }


def test_a_figure_has_the_chosen_signals_with_their_units_and_names():
    run = pendulum()
    qpos = run["plant.qpos"]
    figure = draw([run], signals="plant.qpos, plant.elbow.pos, plant.qpos[1] - plant.qpos[2]")
    drawn = panels(figure)
    assert [*drawn] == ["plant.qpos [rad]", "plant.qpos [m]", "plant.elbow.pos [rad]",
                        "plant.qpos[1] - plant.qpos[2] [rad]"]  # fmt: skip
    assert np.array_equal(drawn["plant.qpos [rad]"]["shoulder.pos"], qpos[:, 0])
    assert [*drawn["plant.qpos [m]"]] == ["qpos[3]", "qpos[4]"]
    (difference,) = drawn["plant.qpos[1] - plant.qpos[2] [rad]"].values()
    assert np.array_equal(difference, qpos[:, 0] - qpos[:, 1])
    assert figure.get_size_inches()[0] == pytest.approx(88 / 25.4)


def test_tracking_is_the_distance_of_hand_and_command_and_joints_have_their_names():
    run = made_up_run()
    run.path, run.units = Path("recording.parquet"), dict.fromkeys(run.columns, "m")
    plant = INTERFACES["plant"].variable("hand_xpos")
    run.descriptions = {f"plant.hand_xpos[{i}]": plant.description for i in (1, 2, 3)}
    drawn = panels(draw([run], signals="tracking, plant.hand_xpos", width="100mm"))
    (error,) = drawn["tracking [m]"].values()
    away = run["plant.hand_xpos"] - run["controller.pos_cmd"]
    assert error == pytest.approx(np.sqrt((away**2).sum(axis=1)))
    assert error.max() == pytest.approx(PEAK)
    assert [*drawn["plant.hand_xpos [m]"]] == ["x", "y", "z"]


def test_runs_are_overlaid_and_told_apart():
    runs = [pendulum("slow"), pendulum("fast", scale=2.0)]
    figure = draw(runs, signals="plant.shoulder.pos")
    lines = [line for line in figure.axes[0].lines if len(line.get_ydata())]
    assert [line.get_ydata().max() for line in lines] == [r["plant.qpos[1]"].max() for r in runs]
    assert len({line.get_color() for line in lines}) == 2
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["slow", "fast"]
    both = draw(runs, signals="plant.qpos").axes[0].lines  # colours are those of the joints here
    assert len({line.get_color() for line in both if len(line.get_ydata())}) == 2


def test_a_figure_is_the_same_file_each_time_with_its_font_and_may_be_replaced(tmp_path):
    figures = [draw([pendulum()], signals="plant.qpos[1]") for _ in range(2)]
    for kind in ("pdf", "svg", "png"):
        contents = []
        for number, figure in enumerate(figures):
            save(figure, path := tmp_path / f"{number}.{kind}")
            check_replaceable(path, overwrite=False)
            contents.append(path.read_bytes())
        assert contents[0] == contents[1]
        assert kind != "pdf" or b"/FontFile2" in contents[0]
        assert kind != "svg" or b"<text" not in contents[0]  # letters are outlines


@pytest.mark.parametrize(("signals", "width", "words"), [
    ("plant.qpso", None, "did you mean 'plant.qpos'"),
    ("plant.qpos - plant.noise", None, "plant.qpos has 4 and plant.noise has 1 elements"),
    ("plant.qpos", "3 km", "must be a number from 30 to 1000 mm"),
    ("", "88mm", "--signals: is missing"),
    ("plant.qpos,", None, "--signals: value ''"),
])  # fmt: skip
def test_what_cannot_be_drawn_is_refused(signals, width, words):
    assert words in refused(draw, [pendulum()], None, signals, width)


def test_the_page_of_a_model_of_ones_own_has_names_and_verdict_and_no_noise():
    criterion = {"name": "peak", "value": 1.0, "bound": 2.0, "unit": "rad"}
    figure = draw_signals(pendulum(), Summary.read({"criteria": [criterion]}))
    drawn = panels(figure)
    assert [*drawn] == ["plant.qpos [rad]", "plant.qpos [m]"]
    assert [*drawn["plant.qpos [rad]"]] == ["shoulder.pos", "elbow.pos"]
    assert any(text.get_text().startswith("Success: 1 of 1") for text in figure.texts)
    assert figure.get_suptitle().startswith("swing")
    assert figure.get_supxlabel() == "signals that stay at 0: 1"
