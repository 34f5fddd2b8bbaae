"""`panda-cosim list`."""

from __future__ import annotations

from ...definition.scenario import Scenario, shipped_scenarios
from ..console import show, table


def command() -> None:
    """List the shipped scenarios.

    ```
    panda-cosim list
    ```
    """
    made = table(("scenario", "duration", "scene", "purpose*"), right=("duration",))
    for name, folder in shipped_scenarios().items():
        scenario = Scenario.read(folder)
        made.add_row(name, f"{scenario.duration:g} s", scenario.scene, scenario.purpose)
    show(made)
