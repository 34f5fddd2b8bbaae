"""The robot's interface and the plant in this process, coupled as FMUs are, and a real client."""

import json
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bounded import killed_after
from panda_cosim.controller.franka.line import EndedError
from panda_cosim.controller.franka.robot import Robot
from panda_cosim.controller.franka.signals import INPUTS, OUTPUTS, Settings
from panda_cosim.controller.franka.wire import ProgramError
from panda_cosim.plant.parameters import PlantParameters
from panda_cosim.plant.plant import Plant

CLIENTS = Path(__file__).with_name("franka_clients.py")
PLANT = PlantParameters(scene="motors", robot="fr3")
CLAIM = 1336  # the port that claims an address
MOST_TICKS = 40_000
PATIENCE = 60.0  # [s] for a client to end
needs_clients = pytest.mark.skipif(
    find_spec("pylibfranka") is None or find_spec("franky") is None,
    reason="pylibfranka and franky-control have no release for this Python or platform",
)


@contextmanager
def claimed_address() -> Iterator[str]:
    """Claim an address of this machine that no other test has."""
    with socket.socket() as claim:
        for i in range(1, 255):
            address = f"127.0.2.{i}"
            try:
                claim.bind((address, CLAIM))
                socket.create_server((address, 1337)).close()
            except OSError:
                continue
            yield address
            return
    raise AssertionError("no address is free")


@contextmanager
def client(*words: str) -> Iterator[subprocess.Popen[str]]:
    """Start a program of `franka_clients.py`; it is killed at the end."""
    command = [sys.executable, str(CLIENTS), *words]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as process, killed_after(process, PATIENCE):
        try:
            yield process
        finally:
            process.kill()


@dataclass
class Coupled:
    """What has come of a program that was coupled with the plant."""

    rows: NDArray[np.float64]  # positions of the plant, then outputs, per tick
    ended: str  # why
    failed: bool
    warnings: list[str]
    told: Any  # by the program; None: it has failed
    errors: str  # of the program

    def output(self, name: str) -> NDArray[np.float64]:
        """Values of an output, per tick."""
        values = np.ascontiguousarray(self.rows[:, 16:]).view(OUTPUTS)[:, 0]
        return np.asarray(values[name])


def couple(
    *words: str,
    plant: PlantParameters = PLANT,
    act: Callable[[Any, int], None] = lambda *_: None,
    ticks: int = MOST_TICKS,
    **settings: Any,
) -> Coupled:
    """Run a program, or none, against the plant until it leaves; `act` on the plant's inputs."""
    with claimed_address() as address:
        given = Settings(address=address, **{"connection_timeout": PATIENCE, **settings})
        inputs, outputs = (np.zeros(layout.itemsize // 8) for layout in (INPUTS, OUTPUTS))
        warnings: list[str] = []
        robot = Robot(given, inputs, outputs, warnings.append)
        robot.listen()
        try:
            if not words:
                return _run(robot, Plant(plant), inputs, outputs, act, ticks, warnings)
            name, *more = words
            with client(name, address, *more) as process:
                made = _run(robot, Plant(plant), inputs, outputs, act, ticks, warnings)
                robot.close()
                text, made.errors = process.communicate(timeout=60.0)
            made.told = json.loads(text) if text else None
            return made
        finally:
            robot.close()


def _run(
    robot: Robot, plant: Any, inputs: Any, outputs: Any, act: Any, ticks: int, warnings: list[str]
) -> Coupled:
    seen, ended, failed, rows = inputs.view(INPUTS)[0], "", False, []
    for tick in range(ticks):
        for name in INPUTS.names or ():
            seen[name] = plant.outputs[name][: len(seen[name])]
        try:
            robot.tick()
        except (EndedError, ProgramError) as error:
            ended, failed = str(error), isinstance(error, ProgramError)
            break
        rows.append(np.concatenate((plant.outputs["qpos"], outputs)))
        plant.inputs["torque"], plant.inputs["ctrl"][7] = outputs[:7], outputs[7]
        act(plant.inputs, tick)
        plant.step()
    return Coupled(np.array(rows), ended, failed, warnings, None, "")
