"""The interface of PandaTrajectory: its outputs are the controller's commands."""

from __future__ import annotations

from dataclasses import replace

from fmus.controller_interface import COMMANDS, CONTROLLER
from fmus.interface import Interface, Variable


def _command(name: str) -> Variable:
    """Return an output like the controller's input of this name."""
    return replace(
        CONTROLLER.variable(name), causality="output", start=None, minimum=None, maximum=None
    )


TRAJECTORY = Interface(
    "PandaTrajectory",
    "Plays a resolved table: the commands of PandaController, sampled at 1 ms",
    (
        *(_command(name) for name in COMMANDS),
        Variable("table", (), "", "parameter", "fixed", "CSV file to play instead of the built-in "
                 "table, as `panda-cosim inputs` writes it; empty: the built-in one", "",
                 kind="String"),
    ),
)  # fmt: skip
