"""`panda-cosim list`."""

from __future__ import annotations

from ...scenario.scenario import Scenario, shipped_scenarios
from ..console import show, show_json, table
from ..options import Json


def command(json: Json = False) -> None:
    """List the shipped scenarios.

    ```
    panda-cosim list
    ```
    """
    scenarios = {name: Scenario.read(path) for name, path in shipped_scenarios().items()}
    if json:
        show_json([_described(name, scenario) for name, scenario in scenarios.items()])
        return
    made = table(("scenario", "duration", "scene", "purpose*"), right=("duration",))
    for name, scenario in scenarios.items():
        made.add_row(name, f"{scenario.duration:g} s", scenario.scene, scenario.purpose)
    show(made)


def _described(name: str, scenario: Scenario) -> dict[str, object]:
    return {
        "name": name,
        "duration_s": scenario.duration,
        "scene": scenario.scene,
        "purpose": scenario.purpose,
        "folder": scenario.folder,
    }
