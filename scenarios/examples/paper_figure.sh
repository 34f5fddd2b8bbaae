#!/bin/sh
# A figure for a paper: how a hand that is pushed comes back, with three gains. Usage: sh paper_figure.sh [NEW_FOLDER]
set -eu
folder=${1:-paper_figure}
mkdir "$folder" && cd "$folder"
for gain in 4 8 16; do panda-cosim run push --set controller.kp=$gain --no-video --no-view --out kp_$gain; done

# The figure in one line: as wide as a column, fonts embedded, a panel for each signal.
panda-cosim plot kp_4 kp_8 kp_16 --signals 'plant.hand_xpos[2], tracking' --width 88mm --out fig.pdf

# The numbers behind it, for MATLAB.
panda-cosim export kp_8 kp_8.mat
