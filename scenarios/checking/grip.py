"""Whether the grip holds the block, from the table alone: its force against mass and friction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...assets import STEP_SIZE
from ...assets.franka import BLOCK_WIDTH, GRIP_FORCE_MAX, GRIP_STIFFNESS
from ..definition.scenario import Scenario
from ..running.start import StartValues, instants, resolve

GRAVITY = np.array([0.0, 0.0, 9.81])  # [m/s^2], as an acceleration that the fingers give
AT_REST = 1e-3  # [m/s] a spline through the rows of a dwell is never quite at rest


@dataclass(frozen=True)
class Grip:
    """The weakest moment of the grip.

    Attributes:
        time: When [s].
        force: Commanded, of each finger [N].
        needed: Of each finger, so that friction carries weight and acceleration [N].
    """

    time: float
    force: float
    needed: float

    @property
    def holds(self) -> bool:
        """Whether the commanded force is enough."""
        return self.force >= self.needed

    def __str__(self) -> str:
        """Describe it in one line, with a force that would hold."""
        told = f"grip {self.force:.3g} N per finger, {self.needed:.3g} N needed"
        if self.holds:
            return told
        why = f"{told} at t = {self.time:.3f} s for the block's mass, friction and acceleration"
        if self.needed <= GRIP_FORCE_MAX:
            return f"{why}: close the fingers further (grip_force), or move more slowly"
        return (
            f"{why}; the hand gives at most {GRIP_FORCE_MAX:g} N, so the block must be lighter or "
            "have more friction"
        )


def weakest_grip(scenario: Scenario, values: StartValues) -> Grip | None:
    """Find where the commanded force is the smallest share of what is needed.

    While the fingers still close, they need not hold.

    Args:
        scenario: Not in the scene `tutorial`, whose gripper has no known force.
        values: Its parameters.

    Returns:
        That moment; None: the fingers never close on the block.
    """
    if scenario.scene == "tutorial" or scenario.has_own_parts:
        return None
    commands = resolve(scenario, values).sample(instants(scenario))
    plant, controller = values["plant"], values["controller"]
    opening, velocity = commands[:, 13], commands[:, 7:10]
    force = 0.5 * GRIP_STIFFNESS * (BLOCK_WIDTH - opening)
    if float(controller["grip_force"]) > 0.0:
        width = float(controller["grip_width"])
        force = np.where(opening < width, float(controller["grip_force"]), force)
    acceleration = np.diff(velocity, axis=0, append=velocity[-1:]) / STEP_SIZE + GRAVITY
    weight = float(plant["block_mass"]) * np.linalg.norm(acceleration, axis=1)
    needed = weight / (2.0 * float(plant["block_friction"]))
    speed = np.linalg.norm(velocity, axis=1)
    carried = (force > 0.0) & (speed > AT_REST)
    carried &= np.maximum.accumulate((force > 0.0) & (speed <= AT_REST))
    if not carried.any():
        return None
    ticks = np.flatnonzero(carried)
    at = int(ticks[(force[ticks] / needed[ticks]).argmin()])
    return Grip(at * STEP_SIZE, float(force[at]), float(needed[at]))


__all__ = ["Grip", "weakest_grip"]
