"""Runs for tests of the view: recorded ones, and made-up ones in memory."""

import base64
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from forked import command
from panda_cosim.task.rotations import Array

# Every kind of joint and of shape; meshes, textures, a height field, a camera on a moving body.
MODEL = """
<mujoco>
  <asset>
    <texture name="checks" type="2d" builtin="checker" rgb1="1 0 0" rgb2="0 0 1" width="300"
      height="200"/>
    <texture name="cube" type="cube" builtin="flat" rgb1="0 1 0" width="8" height="48"/>
    <material name="checked" texture="checks" texrepeat="3 3"/>
    <material name="green" texture="cube"/>
    <mesh name="wedge" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/>
    <hfield name="hills" nrow="3" ncol="4" size=".5 .4 .1 .05"
      elevation="0 1 0 0  0 0 1 0  .5 0 0 1"/>
  </asset>
  <worldbody>
    <geom type="plane" size="2 2 .1" material="checked"/>
    <geom type="hfield" hfield="hills" pos="0 2 0"/>
    <camera name="fixed" pos="3 0 1" xyaxes="0 1 0 -.3 0 1"/>
    <body name="slider" pos=".1 .2 .5" quat=".9 .1 .3 .2">
      <joint type="slide" axis="1 2 3" pos=".3 0 0" ref=".05"/>
      <geom type="box" size=".1 .2 .05" material="checked"/>
      <body name="arm" pos="0 .2 .3" euler="30 40 50">
        <joint type="hinge" axis="0 1 1" pos=".1 -.2 .05" ref=".3"/>
        <joint type="hinge" axis="1 0 0" pos="0 .1 0"/>
        <geom type="capsule" size=".04 .2" material="green"/>
        <camera name="on the arm" pos="0 0 .3"/>
        <body name="ball" pos=".1 0 .4">
          <joint type="ball" pos="0 .05 .1"/>
          <geom type="ellipsoid" size=".1 .05 .07"/>
          <geom type="mesh" mesh="wedge" pos=".1 0 0"/>
          <site name="tip" pos="0 0 .2" size=".01"/>
        </body>
      </body>
    </body>
    <body name="free" pos="1 1 1" quat="0 1 0 0">
      <freejoint/>
      <geom type="cylinder" size=".1 .2"/>
      <geom type="sphere" size=".1" pos="0 0 .3" group="3"/>
    </body>
  </worldbody>
</mujoco>
"""


def decoded(block: Mapping[str, Any]) -> list[Array]:
    """Undo what `view.columns.encode` did, as the page does."""
    rows, count = block["rows"], len(block["steps"])
    raw = np.frombuffer(zlib.decompress(base64.b64decode(block["data"])), np.uint8)
    zigzag = raw.reshape(4, rows * count).T.copy().view("<u4").ravel().astype(np.int64)
    differences = ((zigzag >> 1) ^ -(zigzag & 1)).reshape(count, rows)
    sums = np.cumsum(np.cumsum(differences, axis=1), axis=1)
    whole = (sums + 2**31) % 2**32 - 2**31  # as 32-bit numbers add up
    columns = []
    for index in range(count):
        values = block["offsets"][index] + block["steps"][index] * whole[index]
        for first, end in block["gaps"].get(index, ()):
            values[first:end] = np.nan
        columns.append(values)
    return columns


def run_scenario_outside(out: Path, *options: str, scenario: str | Path = "pick_and_place") -> Path:
    """Run a scenario in a process of its own, without pictures."""
    quiet = ("--no-video", "--no-view")
    done = command("run", scenario, *quiet, "--out", out, *options)
    assert done.returncode in (0, 3), done.stderr
    return out
