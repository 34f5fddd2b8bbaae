"""Runs of other people's FMUs, for tests; each in a process of its own."""

from pathlib import Path
from typing import Any

from fmu_support import REFERENCE_FMUS
from panda_cosim import Recording, Session, replay, run_scenario

ARM = """
<mujoco model="arm">
  <option timestep="0.001" gravity="0 0 -9.81"/>
  <worldbody>
    <light pos="0 -2 2"/>
    <camera name="side" pos="0 -2.5 0.6" xyaxes="1 0 0 0 0 1"/>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="1"/>
      <body name="lower" pos="0 0 -0.4">
        <joint name="elbow" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="shoulder" ctrlrange="-20 20"/>
    <motor joint="elbow" ctrlrange="-10 10"/>
  </actuator>
</mujoco>
"""
SLAVE = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class PD(Fmi2Slave):
    "PD control of two joints to fixed angles"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.kp, self.kd = 60.0, 6.0
        for name in ("kp", "kd"):
            self.register_variable(
                Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
            )
        for joint in (1, 2):
            for name, kind in (("q", "input"), ("v", "input"), ("torque", "output")):
                setattr(self, f"{name}{joint}", 0.0)
                self.register_variable(Real(f"{name}{joint}", causality=Fmi2Causality[kind]))

    def do_step(self, current_time, step_size):
        for joint, goal in ((1, 0.6), (2, -0.4)):
            error = goal - getattr(self, f"q{joint}")
            speed = getattr(self, f"v{joint}")
            setattr(self, f"torque{joint}", self.kp * error - self.kd * speed)
        return True
"""
ARM_SCENARIO = """
purpose = "A two-link arm goes to its angles"
duration = 2.0

[fmus]
controller = "pd.py:PD"
plant = "arm.xml"

[connect]
"controller.q1" = "plant.qpos[1]"
"controller.q2" = "plant.qpos[2]"
"controller.v1" = "plant.qvel[1]"
"controller.v2" = "plant.qvel[2]"
"plant.ctrl[1]" = "controller.torque1"
"plant.ctrl[2]" = "controller.torque2"

[[success.signal]]
name = "at rest"
signal = "plant.qvel"
reduce = "peak"
from = 1.8
below = 0.02
"""


def write_arm(folder: Path) -> Path:
    """Write the scenario of the two-link arm."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(ARM)
    (folder / "pd.py").write_text(SLAVE)
    (folder / "scenario.toml").write_text(ARM_SCENARIO)
    return folder


def run_folder(folder: str, out: str, values: dict[str, Any] | None = None) -> dict[str, Any]:
    """Run a scenario; returns what the tests look at."""
    run = run_scenario(folder, out, values=values)
    recording = run.recording
    return {
        "summary": run.summary.to_dict(),
        "columns": list(recording.columns),
        "parameters": {n: dict(p) for n, p in recording.metadata["parameters"].items()},
    }


def same_bits(one: str, other: str) -> bool:
    """Whether two runs have the same recorded values."""
    first, second = Recording.open(one), Recording.open(other)
    return first.columns == second.columns and all(
        (first[name] == second[name]).all() for name in first.columns
    )


def session_of_other_parts(place: str) -> dict[str, object]:
    """A session of an arm and a user's slave, replayed from its journal and as a scenario."""
    folder = Path(place)
    arm = write_arm(folder / "arm")
    with Session(arm, folder / "first") as session:
        tunable = sorted(session.tunables)
        session.set("controller.kp", 90.0)
        session.step(300)
        session.keep(folder / "kept")
        session.set("controller.kd", 4.0)
        session.finish()
    replay(folder / "first", folder / "again")
    run_scenario(folder / "kept", folder / "run")
    rows = {n: Recording.open(folder / n)["plant.qpos"] for n in ("first", "run")}
    return {
        "tunable": tunable,
        "same": same_bits(str(folder / "first"), str(folder / "again")),
        "kept": bool((rows["run"] == rows["first"][:301]).all()),
    }


def discrete_inputs(folder: str) -> list[float]:
    """Set a discrete input of an FMU with event mode, go back, and leave it as it was before."""
    fmu = f'duration = 1.0\nstep = 0.1\n[fmus]\nit = "{REFERENCE_FMUS}/fmi3/Feedthrough.fmu"\n'
    Path(folder, "scenario.toml").write_text(fmu)
    seen = []
    with Session(folder, Path(folder, "run")) as session:
        session.set("it.Int32_input", 1)
        session.step(1)
        saved = session.save()
        session.set("it.Int32_input", 2)
        session.step(1)
        session.restore(saved)
        session.step(1)
        seen.append(session.state()["it.Int32_output"])
        session.set("it.Int32_input", 2)
        session.step(1)
        seen.append(session.state()["it.Int32_output"])
    return seen
