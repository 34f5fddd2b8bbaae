"""Scenarios: tables, runs, recordings and what is made of them.

The public names are imported when first used, so that `import scenarios` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scenarios.definition.scenario import Scenario, load_scenario, shipped_scenarios
    from scenarios.definition.table import TrajectoryTable
    from scenarios.definition.trajectory import Trajectory
    from scenarios.recording import Recording
    from scenarios.running.run import Options, run_scenario

_MODULES = {
    "Options": "running.run",
    "Recording": "recording",
    "Scenario": "definition.scenario",
    "Trajectory": "definition.trajectory",
    "TrajectoryTable": "definition.table",
    "load_scenario": "definition.scenario",
    "run_scenario": "running.run",
    "shipped_scenarios": "definition.scenario",
}

__all__ = [
    "Options",
    "Recording",
    "Scenario",
    "Trajectory",
    "TrajectoryTable",
    "load_scenario",
    "run_scenario",
    "shipped_scenarios",
]


def __getattr__(name: str) -> object:
    """Import a public name's module when the name is first used."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    """Return the public names, for completion."""
    return sorted(__all__)
