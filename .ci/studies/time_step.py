"""What the time step of the physics changes in `pick_and_place`: `python .ci/studies/time_step.py`.

Plant and controller run in a plain loop. The controller is updated each ms, as in the FMUs; in
between, the plant takes one step of MuJoCo, or several shorter ones.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from unittest.mock import patch

from panda_cosim import load_scenario
from panda_cosim.assets import STEP_SIZE
from panda_cosim.plant.plant import Plant
from panda_cosim.result.judging.summary import Summary
from panda_cosim.run.summary import summarize

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
import random_tasks

PARTS = (1, 2, 4)  # steps of MuJoCo in a ms


def run_in_parts(parts: int) -> Summary:
    """Run `pick_and_place` with some steps of the physics to each update of the controller."""

    class FinerPlant(Plant):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self.model.opt.timestep = STEP_SIZE / parts

        def step(self, ticks: int = 1) -> None:
            super().step(parts * ticks)

    scenario = load_scenario("pick_and_place")
    with patch.object(random_tasks, "Plant", FinerPlant):
        return summarize(random_tasks.run_plain(scenario), scenario)  # type: ignore[arg-type]


def main() -> None:
    """Print one row of a table for each step."""
    print("| time step, ms | place error, mm | slip while carried, mm | tracking RMS, mm |")
    print("| --- | --- | --- | --- |")
    for parts in PARTS:
        summary = run_in_parts(parts)
        block, tracking = summary.block, summary.tracking
        print(
            f"| {1e3 * STEP_SIZE / parts:g} | {block['place_error_mm']:.3f} "
            f"| {block['slip_mm']:.3f} | {tracking['rms_mm']:.4f} |"
        )


if __name__ == "__main__":
    main()
