#!/bin/sh
# A wall in the way, and out of it again: what `check` says at each step. Usage: sh wall.sh [NEW_FOLDER]
set -eu
folder=${1:-wall}
mkdir "$folder" && cd "$folder"
panda-cosim new task --plant

# 1. A wall between block and place, without a class: the finger pads would pass through it.
scene() {
    cat > task/my_scene.xml << END
<mujoco model="wall">
  <include file="tabletop.xml"/>
  <worldbody>
    <geom name="wall" $1 type="box" size="0.01 0.15 0.1" pos="$2 -0.2 0.1"/>
  </worldbody>
</mujoco>
END
}
scene '' 0.45
panda-cosim check task

# 2. With a class, the hand hits it: `check` tells when, in which row, and how hard, before anything is written.
scene 'class="surroundings"' 0.45
panda-cosim check task

# 3. Beside the path it does no harm, and the task succeeds.
scene 'class="surroundings"' 0.62
panda-cosim check task
panda-cosim run task --no-video --no-view --out run
