#!/bin/sh
# How small must the step of a system be? A mass on a spring, in two FMUs, at four steps: the order of convergence.
# Usage: sh step_size.sh NEW_FOLDER
set -eu
mkdir "$1" && cd "$1" && mkdir spring

# 1. The mass, a MuJoCo model that steps itself by 0.1 ms, and the spring, a law in Python.
cat > spring/mass.xml <<'END'
<mujoco>
  <option timestep="0.0001" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator><motor joint="x"/></actuator>
  <keyframe><key name="drawn" qpos="1"/></keyframe>
</mujoco>
END
cat > spring/law.py <<'END'
class Spring:
    """A spring of 4 N/m."""

    def update(self, time, qpos):
        return -4.0 * qpos
END

# 2. The system, and the number that counts: where the mass is after 1 s, cos(2 * 1) m in theory.
cat > spring/scenario.toml <<'END'
purpose = "A mass on a spring"
duration = 1.0
step = 0.01
[fmus]
mass = "mass.xml"
spring = "law.py:Spring"
[connect]
"mass.ctrl" = "spring.ctrl"
[parameters.mass]
keyframe = "drawn"
[[success.signal]]
name = "place"
signal = "mass.qpos"
reduce = "final"
below = 0.0
END

# 3. The study: the force is held over a step, which costs accuracy in proportion to the step.
panda-cosim sweep spring --vary step=0.04,0.02,0.01,0.005 --out study
