#!/bin/sh
# A foreign arm (Pusher of Gymnasium) with a controller of your own: run, judged, compared, exported.
# Needs `pip install gymnasium pythonfmu`. Usage: sh foreign_arm.sh [NEW_FOLDER]
set -eu
folder=${1:-foreign_arm}
mkdir "$folder" && cd "$folder" && mkdir reach

# 1. The arm: its MuJoCo model, looked at as an FMU.
cp "$(python -c 'import gymnasium as g; print(g.__path__[0])')/envs/mujoco/assets/pusher_v5.xml" reach/arm.xml
panda-cosim mjcf2fmu reach/arm.xml --output "body tips_arm xpos" --out arm.fmu
panda-cosim info arm.fmu

# 2. The controller: a PythonFMU slave, with one variable for each connection.
cat > reach/servo.py <<'END'
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

GAINS = [8.0, 8.0, 3.0, 6.0, 1.0, 1.0, 1.0]  # N.m/rad
TARGET = [0.4, 0.3, 0.0, -0.8, 0.0, -0.3, 0.0]  # rad


class Servo(Fmi2Slave):
    """A spring and a damper at each joint."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for i in range(7):
            for name, causality in (("q", "input"), ("v", "input"), ("torque", "output")):
                setattr(self, f"{name}{i}", 0.0)
                self.register_variable(Real(f"{name}{i}", causality=Fmi2Causality[causality]))

    def do_step(self, time, step):
        for i, (gain, target) in enumerate(zip(GAINS, TARGET)):
            error = target - getattr(self, f"q{i}")
            torque = gain * error - 0.3 * gain * getattr(self, f"v{i}")
            setattr(self, f"torque{i}", max(-2.0, min(2.0, torque)))
        return True
END

# 3. The scenario: which part is connected to which, and what must come out.
{
    printf 'purpose = "The arm goes to its target"\nduration = 4.0\nstep = 0.01\n'
    printf '[fmus]\nplant = "arm.xml"\ncontroller = "servo.py:Servo"\n[connect]\n'
    for i in 0 1 2 3 4 5 6; do
        j=$((i + 1))
        printf '"plant.ctrl[%s]" = "controller.torque%s"\n' $j $i
        printf '"controller.q%s" = "plant.qpos[%s]"\n"controller.v%s" = "plant.qvel[%s]"\n' $i $j $i $j
    done
    printf '[[success.signal]]\nname = "elbow_arrives"\nsignal = "plant.qpos[4]"\n'
    printf 'reduce = "settle"\ntarget = -0.8\nband = 0.02\nbelow = 3.0\n'
} > reach/scenario.toml
panda-cosim check reach
panda-cosim run reach --out first --no-video

# 4. A reference, and what a change of the model does to it.
panda-cosim regress reach --update --yes
panda-cosim regress reach

# 5. The system as an .ssp for other tools; our master runs it to the same bits.
panda-cosim build --scenario reach --out given
panda-cosim run given/*.ssp --duration 4 --out second --no-video --no-view
