"""`sweep --fit LOG`: the values that bring a run closest to a log, with intervals."""

import json

import numpy as np
import pytest

from forked import command
from panda_cosim.run.execution import run_scenario
from panda_cosim.study.sweep.definition import Sweep, sweep_of
from panda_cosim.study.sweep.fit import fit
from panda_cosim.task.scenario import Scenario
from refusals import refused

ARM = """<mujoco>
  <option timestep="0.002"/>
  <worldbody><body pos="0 0 1">
    <joint name="hinge" type="hinge" axis="0 1 0" damping="0.1" armature="0.01"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.2"/>
  </body></worldbody>
  <actuator><position name="servo" joint="hinge" kp="5"/></actuator>
</mujoco>"""
TRUE = {"arm.gravity[1]": 2.0, "arm.gravity[3]": -9.0}
RANGES = {"arm.gravity[1]": (0.0, 5.0), "arm.gravity[3]": (-12.0, -5.0)}
NOISE = {"arm.qpos": 0.002, "arm.qvel": 0.05, "arm.actuator_force": 0.01}  # rad, rad/s, N.m


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The folder of a scenario of a pendulum with a servo."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.xml").write_text(ARM)
    (folder / "scenario.toml").write_text(
        'purpose = "swings"\nduration = 0.4\nstep = 0.002\n[fmus]\narm = "arm.xml"\n'
    )
    return folder


@pytest.fixture(scope="module")
def swung(arm, tmp_path_factory):
    """What it records with the true values."""
    scenario = Scenario.read(arm).changed(TRUE)
    return run_scenario(scenario, tmp_path_factory.mktemp("runs") / "true").recording


def write_log(recording, path, seed=None, every=2):
    """Write signals of a recording, with noise if there is a seed."""
    rng = np.random.default_rng(seed)
    columns = [recording["time"][::every]]
    for name, sigma in NOISE.items():
        exact = recording[name][::every]
        drawn = 0.0 if seed is None else sigma * rng.standard_normal(len(exact))
        columns.append(exact + drawn)
    head = ",".join(("time", *NOISE))
    np.savetxt(path, np.transpose(columns), delimiter=",", header=head, comments="", fmt="%.17g")
    return path


def definition(arm, **ranges):
    return sweep_of(str(arm), [f"{key}={low}:{high}:2" for key, (low, high) in ranges.items()])


@pytest.mark.parametrize("low", [0.0, -1.0])  # of the second, the truth is in the middle
def test_a_log_without_noise_gives_the_values_exactly(arm, swung, tmp_path, low):
    ranges = {**RANGES, "arm.gravity[1]": (low, 5.0)}
    found = fit(definition(arm, **ranges), write_log(swung, tmp_path / "log.csv"))
    for key, each in found.estimates.items():
        assert each.value == pytest.approx(TRUE[key], rel=1e-6)
        assert each.low <= each.value <= each.high
        assert each.high - each.low < 1e-4
    assert not found.alike
    assert max(found.noise.values()) < 1e-6


@pytest.mark.parametrize(
    ("fits", "least"),
    [(2, 2), pytest.param(100, 90, marks=pytest.mark.long)],  # 95 +- 2.3 standard deviations
)
def test_intervals_hold_the_values_of_noisy_runs_as_often_as_they_say(
    arm, swung, tmp_path, fits, least
):
    counts = dict.fromkeys(TRUE, 0)
    for seed in range(fits):
        found = fit(definition(arm, **RANGES), write_log(swung, tmp_path / "log.csv", seed))
        for key, each in found.estimates.items():
            counts[key] += each.low <= TRUE[key] <= each.high
            low, high = RANGES[key]
            assert each.high - each.low < 0.7 * (high - low)
        for name, sigma in NOISE.items():
            assert found.noise[name] == pytest.approx(sigma, rel=0.35)  # of 101 values
    assert min(counts.values()) >= least


def test_what_moves_the_signals_alike_is_said_and_what_does_nothing(arm, swung, tmp_path):
    log = write_log(swung, tmp_path / "log.csv", 1)
    ranges = {"arm.gravity[2]": (-1.0, 1.0), "arm.gravity[3]": (-12.0, -5.0)}
    found = fit(definition(arm, **ranges), log)
    assert found.alike == ("arm.gravity[2] changes no signal of the log",)
    free = found.estimates["arm.gravity[2]"]
    assert (free.low, free.high) == (-1.0, 1.0)  # nothing is known of it
    (tmp_path / "one.csv").write_text(f"time,arm.qpos\n0.2,{swung['arm.qpos'][100]:.17g}\n")
    found = fit(definition(arm, **RANGES), tmp_path / "one.csv")
    (said,) = found.alike
    assert said.startswith("arm.gravity[1] and arm.gravity[3] cannot be told apart")


def test_what_cannot_be_fitted_is_refused(arm, tmp_path):
    log = tmp_path / "log.csv"
    for text in ("time,x\n0,1\n0.1,2\n", "time,arm.qpos\n5,1\n6,2\n"):
        log.write_text(text)
        told = refused(fit, definition(arm, **RANGES), log)
        assert "no signal or instant in common with the run" in told
    two = Sweep(scenario=(str(arm), "push"), vary={"duration": {"uniform": [1, 2]}}, samples=2)
    assert "scenario: 2 of them; a fit has one" in refused(fit, two, log)
    words = sweep_of(str(arm), ["coupling=jacobi,gauss-seidel"])
    assert "must be ranges of numbers" in refused(fit, words, log)


def test_the_command_writes_the_fitted_scenario(arm, swung, tmp_path):
    log = write_log(swung, tmp_path / "log.csv", 3)
    vary = [f"--vary={key}={low}:{high}:2" for key, (low, high) in RANGES.items()]
    words = ("sweep", arm, *vary, "--fit", log, "--out", "fitted")
    said = json.loads(command(*words, "--json", cwd=tmp_path, code=0).stdout)
    fitted = Scenario.read(tmp_path / "fitted")
    for key, each in said["estimates"].items():
        instance, _, name = key.partition(".")
        assert fitted.parameters[instance][name] == each["value"]
    assert "already exists" in command(*words, cwd=tmp_path, code=2).stderr
