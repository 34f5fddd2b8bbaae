"""The control interface of a real robot as an FMI slave."""

from __future__ import annotations

from dataclasses import fields
from typing import Final, NoReturn

from ...controller.franka.line import EndedError
from ...controller.franka.robot import Robot
from ...controller.franka.signals import Settings
from ..interface.franka import FRANKA
from .base import WARNING, SharedSlave

DISCARD: Final = 2  # FMI's status: of a step that ends the simulation
NO_STATE: Final = "a program that is connected cannot go back: there are no states to save"


class FrankaSlave(SharedSlave):
    """Translates between FMI and `controller.franka.robot.Robot`; waits for its program."""

    interface = FRANKA
    _robot: Robot

    def rebuild(self, start_time: float) -> None:
        """Make the robot; it listens once initialization has ended."""
        self.terminate()
        given = self.parameters(f.name for f in fields(Settings))
        self._robot = Robot(Settings(**given), self._inputs, self._outputs, self._warn)

    def _warn(self, text: str) -> None:
        self.messages.append((WARNING, text))

    def initialized(self) -> None:
        """Let programs connect."""
        self._robot.listen()

    def advance(self, count: int) -> None:
        """Take steps; the simulation ends with the program."""
        try:
            for _ in range(count):
                self._robot.tick()
        except (EndedError, KeyboardInterrupt) as ended:
            self.messages.append((DISCARD, str(ended) or type(ended).__name__))
        except ValueError:
            self.terminate()
            raise

    def terminate(self) -> None:
        """Close all connections."""
        if hasattr(self, "_robot"):
            self._robot.close()

    def get_state(self) -> NoReturn:
        """Refuse."""
        raise ValueError(NO_STATE)

    def set_state(self, state: bytes) -> NoReturn:
        """Refuse."""
        raise ValueError(NO_STATE)
