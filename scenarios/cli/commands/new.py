"""`panda-cosim new` and `panda-cosim list`."""

from __future__ import annotations

from pathlib import Path

from ...files import as_argument
from ...scenario.scenario import Scenario, shipped_scenarios
from ...scenario.writer import make_scenario
from ..console import show, show_json, table
from ..options import JSON, argument, option


def command(
    name: Path = argument("NAME", "Folder to make."),
    controller: bool = option(
        "--controller", "Add a control law in Python, for you to edit.", False
    ),
) -> None:
    """Make a scenario of your own, ready to run.

    A scenario is a folder with a table of waypoints, trajectory.csv, and a file of settings,
    scenario.toml.

    ```
    panda-cosim new my-scenarios/lift
    panda-cosim run my-scenarios/lift
    panda-cosim new my-law --controller
    ```
    """
    for path in make_scenario(name, controller=controller):
        show(str(path))
    folder = as_argument(name)
    show(f"Next: panda-cosim check {folder}; panda-cosim run {folder}", "dim")


def list_scenarios(json: bool = JSON) -> None:
    """List the shipped scenarios.

    ```
    panda-cosim list
    ```
    """
    scenarios = [Scenario.read(path) for path in shipped_scenarios().values()]
    if json:
        show_json(
            [
                {
                    "name": scenario.name,
                    "duration_s": scenario.duration,
                    "scene": scenario.scene,
                    "purpose": scenario.purpose,
                    "folder": scenario.folder,
                }
                for scenario in scenarios
            ]
        )
        return
    rows = [(s.name, f"{s.duration:g} s", s.scene, s.purpose) for s in scenarios]
    show(table(("scenario", "duration", "scene", "purpose*"), rows, right=("duration",)))
