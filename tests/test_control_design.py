"""The linear analysis: margins, and that it predicts what the simulation does."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from control_support import started
from fmu_support import in_process
from numpy.typing import NDArray
from panda_cosim import run_scenario
from panda_cosim.controller.design import Analysis, analyze, disk_margin
from panda_cosim.controller.gains import preset
from panda_cosim.controller.linear import LinearLoop, linear_loop
from random_tasks import connect

Array = NDArray[np.float64]

STEP = 1e-4  # rad, added to a servo target
TICKS = 300
SHAPE_TOLERANCE = 0.02  # of the response's peak


@cache
def analysis() -> Analysis:
    return analyze()


@cache
def loops(period: float) -> LinearLoop:
    return linear_loop(preset("default"), period)


def simulated(joint: int, period: float) -> Array:
    """Return how a joint moves when its servo target gets a small step (m,) [1]."""
    plant, controller = started(period=period)
    offset, ticks = np.zeros(8), round(period / 0.001)
    start = plant.outputs["qpos"][joint]
    path = []
    for tick in range(700 + TICKS):
        connect(plant, controller)
        if tick == 700:  # gravity has been met
            offset[joint], start = STEP, plant.outputs["qpos"][joint]
        if tick % ticks == 0:
            controller.update()
            if tick >= 700:
                path.append((plant.outputs["qpos"][joint] - start) / STEP)
        plant.inputs["ctrl"] = controller.outputs["ctrl"] + offset
        plant.step()
    return np.array(path)


@pytest.mark.parametrize(("joint", "period"), [(0, 0.001), (3, 0.001), (6, 0.001), (1, 0.005)])
def test_the_step_response_is_the_predicted_one(joint: int, period: float) -> None:
    actual = simulated(joint, period)
    expected = loops(period).step(joint, len(actual))
    assert np.abs(actual - expected).max() <= SHAPE_TOLERANCE * np.abs(expected).max()


def test_the_margins_at_the_default_gains_are_wide() -> None:
    default = analysis().variants[0]
    assert (default.period, default.coupling, default.stable) == (0.001, "gauss-seidel", True)
    assert [loop.joint for loop in default.loops] == [1, 2, 3, 4, 5, 6, 7]
    for loop in default.loops:
        assert loop.gain_margin_db >= 6.0
        assert loop.phase_margin_deg >= 45.0
        assert loop.delay_margin_ms >= 3.0
        assert 5.0 <= loop.bandwidth_hz <= 100.0


def test_all_variants_are_stable_and_a_delay_costs_phase() -> None:
    by_name = {(v.period, v.coupling): v for v in analysis().variants}
    assert set(by_name) == {
        *((p, "gauss-seidel") for p in (0.001, 0.002, 0.005, 0.010)),
        (0.001, "jacobi"),
    }
    assert all(v.stable for v in by_name.values())
    for direct, late in zip(
        by_name[0.001, "gauss-seidel"].loops, by_name[0.001, "jacobi"].loops, strict=True
    ):
        lost = direct.phase_margin_deg - late.phase_margin_deg
        assert lost == pytest.approx(360 * direct.crossover_hz * 0.001, rel=0.25)
        # What was the margin before is less by the one tick of delay.
        assert direct.delay_margin_ms - late.delay_margin_ms == pytest.approx(1.0, abs=0.2)


def test_a_delay_beyond_the_margin_makes_it_unstable() -> None:
    """The margin is true: less delay is stable, more is not."""
    period = 0.001
    margin = analysis().variants[0].loops[1].delay_margin_ms
    system = loops(period)

    def largest(delay_ticks: int) -> float:
        n = len(system.transition)
        chain = np.zeros((n + delay_ticks, n + delay_ticks))
        chain[:n, :n] = system.closed - np.outer(system.entry[:, 1], system.feedback[1])
        chain[:n, n] = system.entry[:, 1]
        chain[n:-1, n + 1 :] = np.eye(delay_ticks - 1)
        chain[-1, :n] = system.feedback[1]
        return float(np.abs(np.linalg.eigvals(chain)).max())

    assert largest(math.floor(margin)) < 1.0
    assert largest(math.floor(margin) + 2) > 1.0


def swing(folder: str) -> tuple[float, float]:
    """Largest change of a joint speed per tick, before and after the middle of a pushed hold."""
    speed = run_scenario(folder, Path(folder) / "run").recording["plant.qvel"][:, :7]
    change = np.abs(np.diff(speed, axis=0))
    return float(change[300:550].max()), float(change[750:].max())


@pytest.mark.fmu
@pytest.mark.parametrize(
    ("coupling", "delay", "known"),
    [
        *(("gauss-seidel", 0.008, 0.0), ("gauss-seidel", 0.009, 0.0)),
        *(("jacobi", 0.006, 0.0), ("jacobi", 0.007, 0.0)),
        *(("gauss-seidel", 0.015, 0.015), ("gauss-seidel", 0.018, 0.018)),
    ],
)
def test_late_readings_are_called_unstable_where_a_simulation_swings_up(
    tmp_path: Path, coupling: str, delay: float, known: float
) -> None:
    """Delays beyond the margin and within; Jacobi adds two ticks. Known ones are borne longer."""
    (tmp_path / "trajectory.csv").write_text(
        "time,frame,x,y,z,grip\n0,home,0,0,0,0.08\n1,home,0,0,0,0.08\n"
    )
    (tmp_path / "scenario.toml").write_text(
        f'duration = 1.0\ncoupling = "{coupling}"\n[mismatch]\ndelay = {delay}\n'
        f"[controller]\nreading_delay = {known}\n"
        "[[push]]\nforce = [10, 10, 10]\nstart = 0.1\nduration = 0.05\n"
    )
    before, after = in_process(swing, str(tmp_path))
    gains = preset("default", reading_delay=known)
    poles = np.linalg.eigvals(linear_loop(gains, 0.001, coupling, delay=delay).closed)
    assert (np.abs(poles).max() <= 1.0) == (after < before)


def test_integral_and_derivative_gains_are_seen() -> None:
    gains = preset("default", ki=(20.0,) * 7, kd=(0.02,) * 7)
    system = linear_loop(gains, 0.001)
    assert len(system.transition) > len(loops(0.001).transition)
    omega = np.array([1000.0])  # rad/s, where the derivative acts
    assert abs(system.response(1, omega)[0]) > abs(loops(0.001).response(1, omega)[0])


def test_what_is_unstable_is_called_so_without_margins() -> None:
    """Gains or delays are too high: there are no margins, which would mean nothing."""
    wild = analyze(replace(preset("default"), kp=(4000.0,) * 7), periods=(0.010,))
    late = analyze(periods=(0.001,), delay=0.012)
    for variant in (wild.variants[0], late.variants[0]):
        assert not variant.stable
        assert variant.pole_modulus > 1.0
        assert variant.loops == ()
        assert variant.disk_margin == 0.0


def test_the_disk_margin_of_one_loop_is_the_known_one() -> None:
    """L = 25 / (s^3 + 10 s^2 + 10 s + 10): 0.46 (Seiler, Packard and Gahinet 2020, example)."""
    s = 1j * np.geomspace(0.01, 100.0, 4000)
    loop = 25.0 / (s**3 + 10.0 * s**2 + 10.0 * s + 10.0)
    single = disk_margin(loop[:, None, None])
    assert single == pytest.approx(0.46, abs=0.005)
    # Two such loops in other units that do not see each other have the same margin.
    assert disk_margin(loop[:, None, None] * np.eye(2)) == pytest.approx(single)


def test_late_readings_and_softer_servos_cost_margin() -> None:
    late, both = (
        analyze(periods=(0.001,), delay=0.003, servo_scale=(scale,) * 7).variants[0].disk_margin
        for scale in (1.0, 0.8)
    )
    assert both + 0.05 < late < analysis().variants[0].disk_margin - 0.2
