"""Scenarios: tables, runs, recordings and what is made of them.

The public names are imported when first used, so that `import scenarios` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scenarios.recording import Recording
    from scenarios.run import run_scenario
    from scenarios.scenario import Scenario, load_scenario, shipped_scenarios
    from scenarios.table import TrajectoryTable
    from scenarios.trajectory import Trajectory

_MODULES = {
    "Recording": "recording",
    "Scenario": "scenario",
    "Trajectory": "trajectory",
    "TrajectoryTable": "table",
    "load_scenario": "scenario",
    # Not `run`: that is the module, and importing it would hide a function of the same name.
    "run_scenario": "run",
    "shipped_scenarios": "scenario",
}

__all__ = [
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
