"""The analysis of loops: compared with closed forms, a linearisation, and what a run does."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from fmu_support import in_process
from forked import command
from panda_cosim import Options, Push, analyze, load_scenario, run_scenario
from panda_cosim.fmus.master import kernel
from panda_cosim.study.analysis.margins import frequencies
from panda_cosim.study.compare.reference import REFERENCE_FILE, Reference
from panda_cosim.task.mismatch import Mismatch
from refusals import refused

AGREEMENT = 0.01  # of an open loop's response, or of a margin
PERIOD = 0.001  # s

# A mass of 1 kg on a slide, and a law that pulls it back.
SLIDE = """<mujoco><option gravity="0 0 0" timestep="0.001"/>
<worldbody><body><joint name="x" type="slide"/>
<geom size=".1" mass="1"/></body></worldbody>
<actuator><motor name="f" joint="x"/></actuator></mujoco>"""
# And one of 2 kg beside it.
TWO = SLIDE.replace(
    "</worldbody>",
    """<body pos="1 0 0"><joint name="y" type="slide"/>
<geom size=".1" mass="2"/></body></worldbody>""",
).replace("</actuator>", '<motor name="g" joint="y"/></actuator>')
# v+ = v + T f / m and x+ = x + T v+ of both, and the law of `Both`.
A = np.block([[np.eye(2), PERIOD * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
B = np.vstack((PERIOD**2 * np.diag([1.0, 0.5]), PERIOD * np.diag([1.0, 0.5])))
GAINS = np.array([[400.0, -90.0, 20.0, 0.0], [-50.0, 500.0, 0.0, 40.0]])
LAWS = """
COUNT = [0.0]

class Pull:
    spring = 400.0
    damper = 20.0
    period = 0.001
    def update(self, time, qpos, qvel):
        return -self.spring * qpos - self.damper * qvel

class Both:  # each force hears of the other mass
    def update(self, time, qpos, qvel):
        return [90.0 * qpos[1] - 400.0 * qpos[0] - 20.0 * qvel[0],
                50.0 * qpos[0] - 500.0 * qpos[1] - 40.0 * qvel[1]]

class Forgetful:  # its output depends on what its state does not hold
    def update(self, time, qpos):
        COUNT[0] += 1.0
        return COUNT[0] - 0.0 * qpos

class Deaf:
    def update(self, time, qpos):
        return 0.0 * qpos
"""
SYSTEM = 'duration = 0.1\n[fmus]\ncontroller = "laws.py:Pull"\nplant = "slide.xml"\n'


@pytest.fixture
def slide(tmp_path):
    (tmp_path / "slide.xml").write_text(SLIDE)
    (tmp_path / "laws.py").write_text(LAWS)
    (tmp_path / "scenario.toml").write_text(SYSTEM)
    return tmp_path


def measured(
    scenario: str, at: float | str, values: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Numbers of an analysis; S and L are real and imaginary parts at some frequencies."""
    one = analyze(load_scenario(scenario).changed(values or {}), at)
    omega = frequencies(one.responses)
    some = omega[[100, 300, 500]]
    z = np.exp(1j * some * one.period)

    def parts(values: Any) -> Any:
        return [np.real(values).tolist(), np.imag(values).tolist()]

    return {
        "at": one.at, "period": one.period, "omega": omega.tolist(), "some": some.tolist(),
        "s": parts(one.responses.sensitivity.at(omega)),
        "model_l": parts(one.loop(z, squeeze=False)),
        "poles": float(np.abs(one.model.poles()).max(initial=0.0)), "remarks": one.remarks,
        "names": [one.model.input_labels, one.model.output_labels], "dt": one.model.dt,
        **{n: v for n, v in vars(one.margins).items() if n not in ("loops", "period")},
        "loops": [vars(loop) for loop in one.margins.loops],
    }  # fmt: skip


def array(parts: Any) -> Any:
    return np.array(parts[0]) + 1j * np.array(parts[1])


def check_crossing(loop: dict[str, Any], omega: Any, response: Any) -> None:
    """Compare phase margin and crossover with an open loop's response at many frequencies."""
    crossing = np.flatnonzero(np.abs(response) >= 1.0)[-1]
    margin = 180.0 + math.degrees(np.unwrap(np.angle(response))[crossing])
    assert loop["phase_margin_deg"] == pytest.approx(margin, rel=AGREEMENT)
    assert loop["crossover_hz"] * 2 * math.pi == pytest.approx(omega[crossing], rel=AGREEMENT)


@pytest.mark.parametrize(
    ("spring", "law", "step"),
    [(400.0, 0.001, 0.001), (1000.0, 0.004, 0.001), (400.0, 0.001, 0.002)],
)
def test_an_own_law_and_plant_have_the_loop_of_the_closed_form(slide, spring, law, step):
    """v+ = v + T f, x+ = x + T v+, with the force held for a period."""
    (slide / "slide.xml").write_text(SLIDE.replace('step="0.001"', f'step="{step}"'))
    period = max(law, step)
    values = {"controller.spring": spring, "controller.period": law}
    one = in_process(measured, str(slide), 0.05, values)
    assert one["names"] == [["plant_ctrl"], ["plant_ctrl", "plant_qpos"]]
    assert one["period"] == one["dt"] == pytest.approx(period)

    tick, force = np.array([[1.0, step], [0.0, 1.0]]), np.array([step**2, step])
    a, b = np.eye(2), np.zeros(2)
    for _ in range(round(period / step)):
        a, b = tick @ a, tick @ b + force
    gains = np.array([spring, 20.0])

    def loop(omega: Any) -> Any:
        z = np.exp(1j * np.asarray(omega) * period)[:, None, None]
        return np.linalg.solve(z * np.eye(2) - a, b[:, None])[..., 0] @ gains

    expected = loop(one["omega"])
    actual = 1.0 / array(one["s"])[:, 0, 0] - 1.0
    assert np.abs(actual / expected - 1.0).max() < AGREEMENT
    assert np.abs(array(one["model_l"])[0, 0] / loop(one["some"]) - 1.0).max() < AGREEMENT
    assert one["poles"] == pytest.approx(np.abs(np.linalg.eigvals(a - np.outer(b, gains))).max())
    dense = np.geomspace(1.0, np.pi / period, 200_000)
    response = loop(dense)
    check_crossing(one["loops"][0], dense, response)
    gain = 20.0 * math.log10(1.0 / abs(response[-1].real))
    assert one["loops"][0]["gain_margin_db"] == pytest.approx(gain, rel=AGREEMENT)


@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi"])
def test_coupled_loops_have_the_closed_form_of_all_and_of_each(slide, coupling):
    (slide / "slide.xml").write_text(TWO)
    (slide / "scenario.toml").write_text(SYSTEM.replace("Pull", "Both"))
    one = in_process(measured, str(slide), 0.05, {"coupling": coupling})

    def loops(omega: Any) -> Any:
        z = np.exp(1j * np.asarray(omega) * PERIOD)[:, None, None]
        return GAINS @ np.linalg.solve(z * np.eye(4) - A, B) * z ** -(coupling == "jacobi")

    expected = np.linalg.inv(np.eye(2) + loops(one["omega"]))
    assert np.abs(array(one["s"]) - expected).max() < AGREEMENT
    dense = np.geomspace(1.0, np.pi / PERIOD, 100_000)
    both = loops(dense)
    for i, loop in enumerate(one["loops"]):
        j = 1 - i  # is closed
        alone = both[:, i, i] - both[:, i, j] * both[:, j, i] / (1.0 + both[:, j, j])
        check_crossing(loop, dense, alone)


def pulses(stepper: str, scenario: str) -> str:
    """In Python, there is no library for the kernel."""
    if stepper == "Python":
        kernel.load_stepper = lambda: None
    jacobi = load_scenario(scenario).changed({"coupling": "jacobi"})
    return analyze(jacobi, 0.05).responses.pulses.tobytes().hex()


def test_responses_that_are_stepped_in_c_have_the_bits_of_those_in_python(slide):
    assert in_process(pulses, "C", str(slide)) == in_process(pulses, "Python", str(slide))


def test_the_margins_at_the_default_gains_are_wide_also_in_the_grasp():
    recorded = Reference.read(load_scenario("pick_and_place").folder / REFERENCE_FILE)
    grasp = recorded.summary.events["grasp"]
    # At the first touch itself, a pulse decides whether one finger presses or both.
    for at, instant in (("start", 0.0), ("grasp + 0.1", grasp + 0.1)):
        one = in_process(measured, "pick_and_place", at)
        assert one["at"] == pytest.approx(instant)
        assert one["stable"]
        assert one["linear"]
        assert [loop["joint"] for loop in one["loops"]] == [1, 2, 3, 4, 5, 6, 7]
        assert one["disk_margin"] > 0.5
        for loop in one["loops"]:
            assert loop["gain_margin_db"] >= 6.0
            assert loop["phase_margin_deg"] >= 45.0
            assert loop["delay_margin_ms"] >= 3.0


def growth_along(scenario: str, delay: float) -> float:
    """Growth of what a small push at 0.7 s adds to the joint speeds, from 0.8 to 1.2 s on."""
    speeds = []
    for force in (0.0, 0.01):
        changed = replace(
            load_scenario(scenario),
            duration=1.4,
            push=(Push(force=(force, force, force), start=0.7, duration=0.005),),
            mismatch=Mismatch(delay=delay),
        )
        with TemporaryDirectory() as folder:
            run = run_scenario(changed, Path(folder) / "run")
            speeds.append(np.array(run.recording["plant.qvel"][:, :7]))
    apart = np.abs(speeds[1] - speeds[0])
    return float(apart[1200:1400].max() / apart[800:1000].max())


def test_at_a_moving_instant_the_delay_margin_is_what_runs_bear():
    one = in_process(measured, "pick_and_place", 0.7)
    assert one["reason"] == ""
    assert one["delay_margin_ms"] == pytest.approx(8.72, rel=AGREEMENT)
    late = [in_process(growth_along, "pick_and_place", PERIOD * n) for n in (8, 9)]
    assert late[0] < 1.0 < late[1]


def test_what_is_unstable_not_linear_or_about_to_touch_has_no_margins():
    values = {"controller.period": 0.01, "controller.kp": 4000.0}
    wild = in_process(measured, "pick_and_place", 0.0, values)
    near = in_process(measured, "pick_and_place", 1.9)  # a contact at 1.938 s; it needs some 70 ms
    for one in (wild, near):
        assert not one["stable"]
        assert one["loops"] == []
    assert not wild["linear"]  # its swings are as large as the limits let them be
    assert wild["disk_margin"] == 0.0
    assert any("a doubled pulse" in text for text in wild["remarks"])
    reason = r"NO MARGINS: \d+% of the responses is left when .* 3\d ms after 1.9 s"
    assert re.match(reason, near["reason"])


def test_a_law_with_steps_of_its_own_has_the_loop_of_one_that_updates_as_often(slide):
    at = 0.05  # s, in the middle of such a step
    rare = in_process(measured, str(slide), at, {"controller.period": 0.004})
    (slide / "scenario.toml").write_text(f"{SYSTEM}[steps]\ncontroller = 4\n")
    slow = in_process(measured, str(slide), at)
    np.testing.assert_allclose(array(slow["s"]), array(rare["s"]), rtol=1e-12)
    assert slow["disk_margin"] == pytest.approx(rare["disk_margin"], rel=1e-12)


@pytest.mark.own_process
def test_what_cannot_be_analysed_is_refused_in_one_line(slide):
    def with_law(name: str) -> str:
        (slide / "scenario.toml").write_text(SYSTEM.replace("Pull", name))
        return refused(analyze, slide)

    assert "controller: ctrl differs after its state was restored" in with_law("Forgetful")
    assert "plant.ctrl: a pulse there causes no response within" in with_law("Deaf")
    (slide / "scenario.toml").write_text(SYSTEM)
    assert "did you mean 'plant.ctrl'?" in refused(analyze, slide, loop="plant.ctr")
    assert "from 0 to 0.1 s" in refused(analyze, slide, 0.2)
    assert "at: no grasp in this run" in refused(analyze, slide, "grasp")
    assert "isolate" in refused(analyze, slide, options=Options(isolate=True))


def test_the_command_writes_what_python_control_takes(slide, tmp_path):
    import control  # noqa: PLC0415 - as above

    out = tmp_path / "out"
    both = ("--coupling", "gauss-seidel,jacobi")
    done = command("analyze", slide, "--at", "0.05", *both, "--out", out, "--json", code=0)
    result = json.loads(done.stdout)
    assert [v["coupling"] for v in result["variants"]] == ["gauss-seidel", "jacobi"]
    assert result["cases"] == [f"{slide} coupling={each}" for each in ("gauss-seidel", "jacobi")]
    assert {p.name for p in out.iterdir()} == {"analysis.json", "analysis.npz", "loops.png"}
    data = np.load(out / "analysis.npz")
    system = control.ss(*(data[n] for n in "ABCD"), float(data["period"]))
    assert data["inputs"].tolist() == ["plant.ctrl"]
    assert data["outputs"].tolist() == ["plant.ctrl", "plant.qpos"]
    for name in "ABCD":
        assert result["model"][name] == data[name].tolist()
    # A step of 1 N: the spring of 400 N/m yields by 2.5 mm, and takes the force up.
    still = system(1.0).real.ravel()
    assert still == pytest.approx([0.0, 1.0 / 400.0], abs=1e-5)
    again = command("analyze", slide, "--out", out, code=0)  # replaces its own files
    assert "period 1 ms, gauss-seidel: stable" in again.stdout


def test_laws_and_values_are_cases_whose_margins_runs_confirm(slide, tmp_path):
    cases = (slide, "controller.spring=900,controller.damper=5", f"{slide / 'laws.py'}:Pull")
    more = ("--period", "0.002", "--verify", "--out", tmp_path / "out")
    said = command("analyze", *cases, *more, code=0).stdout
    result = json.loads((tmp_path / "out" / "analysis.json").read_text())
    assert [v["period"] for v in result["variants"]] == [0.002] * 3
    first, soft, same = result["variants"]
    assert first == same
    assert soft["phase_margin_deg"] < first["phase_margin_deg"]
    for confirmed in result["confirmed"]:
        kinds = {each["margin"] for each in confirmed if not each["input"]}
        assert {"delay_margin_ms", "phase_margin_deg"} <= kinds
        assert all(each["stable_within"] and not each["stable_beyond"] for each in confirmed)
    assert "confirmed" in said
    assert "refuted" not in said
    wrong = command("analyze", slide, "laws.py:None", "--out", tmp_path / "out", code=2)
    assert "laws.py" in wrong.stderr


@pytest.mark.own_process
def test_the_plant_has_physical_states_and_the_closed_form(slide):
    """Whatever holds it; a law without states adds none."""
    (slide / "slide.xml").write_text(TWO)
    (slide / "scenario.toml").write_text(SYSTEM.replace("Pull", "Both"))
    one = analyze(slide, 0.05)
    names = [f"plant_{kind}[{i}]" for kind in ("qpos", "qvel") for i in (1, 2)]
    assert one.plant.state_labels == one.plant.output_labels == names
    assert one.plant.input_labels == ["plant_ctrl[1]", "plant_ctrl[2]"]
    scale = np.array([PERIOD, PERIOD, 1.0, 1.0])  # of positions beside speeds
    for model, expected in ((one.plant, A), (one.closed, A - B @ GAINS), (one.loop, A)):
        assert model.state_labels == names
        apart = (model.A - expected) / scale[:, None] * scale
        assert np.abs(apart).max() < 1e-4
        assert np.abs((model.B - B) / scale[:, None]).max() < 1e-4 * PERIOD
    assert np.abs(one.loop.C - GAINS).max() < AGREEMENT
    assert np.abs(one.plant.C - np.eye(4)).max() < 1e-6


def plant_of(scenario: str, at: float) -> dict[str, Any]:
    plant = analyze(scenario, at).plant
    return {"states": plant.state_labels, "outputs": plant.output_labels, "c": plant.C.tolist(),
            "still": plant.dcgain().tolist()}  # fmt: skip


def jacobian(scenario: str, folder: str) -> list[Any]:
    """Of the hand's position at the start, as the plant says (3, 7)."""
    recording = run_scenario(load_scenario(scenario).changed({"duration": 0.1}), folder).recording
    return [[recording[f"plant.jac[{i},{j}]"][0] for j in range(1, 8)] for i in (1, 2, 3)]


def test_the_arm_at_rest_has_joints_as_states_and_elastic_others_too(tmp_path):
    joints = [f"plant_{kind}[{i}]" for kind in ("qpos", "qvel") for i in range(1, 8)]
    rest = in_process(plant_of, "pick_and_place", 0.0)
    assert rest["states"] == joints
    hand = [rest["outputs"].index(f"plant_hand_xpos[{i}]") for i in (1, 2, 3)]
    expected = in_process(jacobian, "pick_and_place", str(tmp_path / "run"))
    assert np.array(rest["c"])[hand, :7] == pytest.approx(np.array(expected), abs=1e-3)
    # A servo's joint goes where it is told to, but for the arm's weight.
    assert np.array(rest["still"])[:7] == pytest.approx(np.eye(7), abs=0.02)
    states = in_process(plant_of, "elastic", 0.0)["states"]
    assert states[:14] == joints
    assert states[14:] == [f"identified[{i + 1}]" for i in range(len(states) - 14)]
    assert len(states) >= 28  # a motor behind each spring


@pytest.mark.own_process
def test_a_notebook_shows_tables_and_all_responses_also_of_what_is_unstable(slide):
    good = analyze(slide)
    bad = analyze(load_scenario(slide).changed({"controller.damper": -5.0}))
    assert "<td>" in good._repr_html_()
    assert f"{good.margins.delay_margin_ms:.2f} ms" in good.margins._repr_html_()
    assert "UNSTABLE" in bad._repr_html_()
    figure = good.plot(wild=bad)
    gain, nichols, responses, phase, singular, *_ = figure.axes
    shown = (gain, nichols, responses, phase, singular)
    drawn = {axes: [line for line in axes.lines if len(line.get_xdata()) > 2] for axes in shown}
    assert [len(lines) for lines in drawn.values()] == [1, 1, 2, 1, 1]
    hertz, decibels = drawn[gain][0].get_data()
    at = 1.0 / good.responses.sensitivity.at(2.0 * math.pi * hertz)[:, 0, 0] - 1.0
    assert decibels == pytest.approx(20.0 * np.log10(np.abs(at)))
    widths = [line.get_linewidth() for line in bad.plot().axes[2].lines]
    assert len(set(widths)) == len(widths)  # none covers another
